//! Bodies that lie still: they get a velocity of exactly zero only where they would stay, and move again as soon as they would.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

const DT: f64 = 0.005;
/// Most that a body called at rest may move in the time below if stepped as if it moved, after a nudge, m and rad.
const SLACK: f64 = 1e-3;
const NUDGE: f64 = 2e-4;
const AFTER: usize = 400;

/// Numbers without a source of chance (a linear congruential generator), so that a failure can be repeated.
struct Numbers(u64);

impl Numbers {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }

    fn turn(&mut self) -> UnitQuaternion<f64> {
        let [x, y, z] = [0; 3].map(|_| self.within(-1.0, 1.0));
        UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z) * 3.0)
    }
}

fn add(
    builder: &mut ModelBuilder,
    name: &str,
    body: BodyId,
    at: Isometry3<f64>,
    geometry: Geometry,
    material: Material,
) {
    let (name, body_from_shape, cull_group) = (name.to_owned(), at, body.0 as u16);
    builder.add_shape(ShapeSpec { name, body, body_from_shape, geometry, material, cull_group, label: 0 }).unwrap();
}

/// A body of a drawn kind: ball, rod, box, or a rod with a ball at its end, as a bulb is.
fn add_thing(builder: &mut ModelBuilder, name: &str, numbers: &mut Numbers) -> BodyId {
    let size = numbers.within(0.02, 0.2);
    let (kind, slim) = (numbers.below(5), numbers.within(0.1, 1.0));
    let mass = numbers.within(0.02, 5.0);
    let com = if kind == 3 {
        Vector3::new(0.0, 0.0, 0.3 * size)
    } else {
        Vector3::new(0.3 * size * numbers.unit(), 0.0, 0.0)
    };
    let body = builder
        .add_body(BodySpec {
            name: name.into(),
            parent: BodyId::WORLD,
            parent_from_body: Isometry3::identity(),
            joint: Joint::Free,
            mass,
            com: if kind == 0 { Vector3::zeros() } else { com },
            inertia: Matrix3::from_diagonal(&Vector3::new(1.0, 0.9, 0.6)) * (0.4 * mass * size * size),
        })
        .unwrap();
    let round = if numbers.unit() < 0.5 { [0.0, 0.0] } else { [1e-4, 5e-4] };
    let material = Material { friction: numbers.within(0.0, 1.2), torsion: round[0], rolling: round[1], priority: 0 };
    let capsule = Geometry::Capsule { radius: 0.3 * size * slim, half_length: size };
    let here = Isometry3::identity();
    match kind {
        0 => add(builder, name, body, here, Geometry::Sphere { radius: size }, material),
        1 => add(builder, name, body, here, capsule, material),
        2 | 4 => {
            let half_extents = Vector3::new(size, size * slim, size * numbers.within(0.1, 1.0));
            add(builder, name, body, here, Geometry::Cuboid { half_extents }, material);
        }
        _ => {
            add(builder, name, body, here, capsule, material);
            let end = Isometry3::translation(0.0, 0.0, size);
            add(builder, &format!("{name}_end"), body, end, Geometry::Sphere { radius: 0.4 * size }, material);
        }
    }
    body
}

/// A slab of a drawn slope, a kerb on it, and one or two bodies that are set down, dropped, tossed or rolled there.
fn scene(numbers: &mut Numbers) -> (Model, State) {
    let mut builder = ModelBuilder::new();
    let first = add_thing(&mut builder, "first", numbers);
    let second = (numbers.unit() < 0.3).then(|| add_thing(&mut builder, "second", numbers));
    let slope = [0.0, 0.0, 0.004, 0.012, 0.1, numbers.within(0.0, 0.6)][numbers.below(6)];
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slope);
    let ground = Material::new(numbers.within(0.0, 1.2), 0);
    // Things lean on it.
    let kerb = [0.05, 0.02, numbers.within(0.05, 0.4)][numbers.below(3)];
    let at = |x: f64, z: f64| Isometry3::from_parts((tilt * Vector3::new(x, 0.0, z)).into(), tilt);
    add(
        &mut builder,
        "slab",
        BodyId::WORLD,
        at(0.0, -0.1),
        Geometry::Cuboid { half_extents: Vector3::new(2.0, 2.0, 0.1) },
        ground,
    );
    add(
        &mut builder,
        "kerb",
        BodyId::WORLD,
        at(0.2, 0.0),
        Geometry::Cuboid { half_extents: Vector3::new(0.05, 2.0, kerb) },
        ground,
    );
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    for (index, body) in [Some(first), second].into_iter().flatten().enumerate() {
        let turn = match numbers.below(4) {
            0 => UnitQuaternion::identity(),
            1 => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2),
            2 => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), numbers.within(-0.02, 0.02)),
            _ => numbers.turn(),
        };
        // Lowered until it touches, or left in the air.
        let across =
            Vector3::new(numbers.within(-0.1, 0.3), 0.3 * index as f64 * numbers.unit(), 0.6 + 0.5 * index as f64);
        let mut pose = Isometry3::from_parts((tilt * across).into(), tilt * turn);
        state.set_pose(&model, body, &pose);
        if numbers.unit() < 0.7 {
            while model.contacts_at(&state.qpos, 1e-3).unwrap().is_empty() && pose.translation.z > -1.0 {
                pose.translation.z -= 1e-3;
                state.set_pose(&model, body, &pose);
            }
        }
        let dof = model.bodies()[body.0].dof_start;
        match numbers.below(5) {
            0 => {}
            // Thrown up so that its speed is next to zero after a whole number of steps.
            1 => state.qvel[dof + 2] = 9.81 * DT * numbers.below(40) as f64,
            2 => (0..6).for_each(|k| state.qvel[dof + k] = numbers.within(-1.0, 1.0)),
            3 => (0..6).for_each(|k| state.qvel[dof + k] = numbers.within(-1e-4, 1e-4)),
            _ => (0..2).for_each(|k| state.qvel[dof + k] = numbers.within(-0.3, 0.3)),
        }
    }
    (model, state)
}

fn is_still(model: &Model, state: &State, body: BodyId) -> bool {
    let dof = model.bodies()[body.0].dof_start;
    state.qvel[dof..dof + 6].iter().all(|&v| v == 0.0)
}

/// Farthest that a body has moved or turned.
fn moved(model: &Model, a: &State, b: &State, body: BodyId) -> f64 {
    let q = model.bodies()[body.0].qpos_start;
    let way = (0..3).map(|k| (a.qpos[q + k] - b.qpos[q + k]).powi(2)).sum::<f64>().sqrt();
    let turn: f64 = (3..7).map(|k| a.qpos[q + k] * b.qpos[q + k]).sum();
    way.max(2.0 * turn.abs().min(1.0).acos())
}

/// Counts of scenes in which something came to rest, and in which it should not have.
fn search(scenes: usize, seed: u64) -> (usize, Vec<u64>) {
    let (mut rested, mut mistaken) = (0, Vec::new());
    for index in 0..scenes as u64 {
        let number = seed + index;
        let mut numbers = Numbers(number.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let (model, mut state) = scene(&mut numbers);
        let mut dynamics = Dynamics::new(&model);
        let mut seen = vec![false; model.bodies().len()];
        for _ in 0..300 {
            let before = state.clone();
            dynamics.step(&model, &mut state, &Input::default(), DT);
            for body in (1..model.bodies().len()).map(BodyId) {
                let rests = is_still(&model, &state, body)
                    && (0..7).all(|k| {
                        let q = model.bodies()[body.0].qpos_start + k;
                        before.qpos[q] == state.qpos[q]
                    });
                if !rests || std::mem::replace(&mut seen[body.0], true) {
                    continue;
                }
                rested += 1;
                // With flags, everything is stepped as if it moved; the other body is held where it is, since what it does
                // later is not this moment's.
                let (mut after, mut free) = (state.clone(), Dynamics::new(&model));
                let dof = model.bodies()[body.0].dof_start;
                (0..2).for_each(|k| after.qvel[dof + k] += numbers.within(-NUDGE, NUDGE));
                let held: Vec<bool> = (0..model.nv()).map(|v| !(dof..dof + 6).contains(&v)).collect();
                for _ in 0..AFTER {
                    free.step(&model, &mut after, &Input { locked: &held, ..Input::default() }, DT);
                }
                if moved(&model, &state, &after, body) > SLACK {
                    mistaken.push(number);
                }
            }
        }
    }
    (rested, mistaken)
}

/// 10,000 scenes where `FIATLUX_ALL_ROOMS` asks for them, which takes minutes.
#[test]
fn nothing_is_called_at_rest_that_would_move() {
    let (rested, mistaken) =
        if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { search(10_000, 1_000_000) } else { search(400, 0) };
    assert!(rested > 100, "{rested} came to rest");
    assert!(mistaken.is_empty(), "{mistaken:?}");
}

/// Earlier steps decide nothing: another scratch memory goes on from any state to the same bits.
#[test]
fn a_state_alone_decides_what_rests() {
    for seed in 0..60 {
        let (model, mut state) = scene(&mut Numbers(seed * 7 + 3));
        let mut dynamics = Dynamics::new(&model);
        for step in 0..200 {
            let mut other = state.clone();
            let report = dynamics.step(&model, &mut state, &Input::default(), DT);
            if step % 10 == 0 {
                let mut fresh = Dynamics::new(&model);
                assert_eq!(fresh.step(&model, &mut other, &Input::default(), DT), report);
                assert_eq!(other, state, "seed {seed}, step {step}");
                assert_eq!(fresh.contacts(), dynamics.contacts());
            }
        }
    }
}

/// A box on a floor, its weight on the floor while it rests, and the floor's forces.
fn box_on_floor() -> (Model, State, BodyId) {
    let mut builder = ModelBuilder::new();
    let body = builder
        .add_body(BodySpec {
            name: "box".into(),
            parent: BodyId::WORLD,
            parent_from_body: Isometry3::translation(0.0, 0.0, 0.1),
            joint: Joint::Free,
            mass: 2.0,
            com: Vector3::zeros(),
            inertia: Matrix3::identity() * 0.0133,
        })
        .unwrap();
    let here = Isometry3::identity();
    add(
        &mut builder,
        "box",
        body,
        here,
        Geometry::Cuboid { half_extents: Vector3::repeat(0.1) },
        Material::new(0.5, 0),
    );
    add(&mut builder, "floor", BodyId::WORLD, here, Geometry::HalfSpace, Material::new(0.5, 0));
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    let mut dynamics = Dynamics::new(&model);
    for _ in 0..200 {
        dynamics.step(&model, &mut state, &Input::default(), DT);
    }
    assert!(is_still(&model, &state, body), "{:?}", state.qvel);
    (model, state, body)
}

#[test]
fn a_body_at_rest_still_presses_on_the_floor() {
    let (model, mut state, _) = box_on_floor();
    let mut dynamics = Dynamics::new(&model);
    let report = dynamics.step(&model, &mut state, &Input::default(), DT);
    let carried: f64 = dynamics.contacts().iter().map(|contact| contact.force.z.abs()).sum();
    assert_eq!((report.iterations, report.contacts), (0, 4));
    assert!((carried - 2.0 * 9.81).abs() < 1e-2, "{carried} N");
}

/// Flags that lock nothing are as good as none.
#[test]
fn flags_that_lock_nothing_change_no_bit() {
    let (model, rested, body) = box_on_floor();
    let mut start = rested.clone();
    start.qvel[0] = 0.01;
    let free = vec![false; model.nv()];
    let run = |locked: &[bool]| {
        let (mut dynamics, mut state) = (Dynamics::new(&model), start.clone());
        (0..100).for_each(|_| _ = dynamics.step(&model, &mut state, &Input { locked, ..Input::default() }, DT));
        state
    };
    assert_eq!(run(&[]), run(&free));
    assert!(is_still(&model, &run(&free), body));
}

/// A push beyond friction, a lift, other gravity and less friction each move it in the step in which they come.
#[test]
fn wrenches_and_variations_wake_it() {
    let (model, rested, body) = box_on_floor();
    let wrench = |force: Vector3<f64>| Wrench { force, torque: Vector3::zeros() };
    for (force, moves) in [
        (Vector3::new(5.0, 0.0, 0.0), false),
        (Vector3::new(11.0, 0.0, 0.0), true),
        (Vector3::new(0.0, 0.0, 21.0), true),
    ] {
        let (mut dynamics, mut state) = (Dynamics::new(&model), rested.clone());
        let input = Input { wrenches: &[(body, wrench(force))], ..Input::default() };
        (0..10).for_each(|_| _ = dynamics.step(&model, &mut state, &input, DT));
        let far = moved(&model, &rested, &state, body);
        assert_eq!(far > 5e-4, moves, "{force:?}: {far} m");
    }
    let (mut dynamics, mut state) = (Dynamics::new(&model), rested.clone());
    dynamics.step(&model, &mut state, &Input::default(), DT);
    assert_eq!(state, rested);
    let gravity = Some(Vector3::new(6.0, 0.0, -8.0));
    dynamics.set_variation(&model, &Variation { gravity, ..Variation::default() }).unwrap();
    dynamics.step(&model, &mut state, &Input::default(), DT);
    assert!(state.qvel[0] > 5e-3, "{:?}", state.qvel);
}

/// Set in the air or on an edge, a thousandth of a degree from balance, a body of velocity zero falls.
#[test]
fn velocity_zero_alone_is_no_rest() {
    let (model, rested, body) = box_on_floor();
    let on_edge = |beyond: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_4 + beyond);
        Isometry3::from_parts(Vector3::new(0.0, 0.0, 0.1 * 2.0_f64.sqrt() - 1e-5).into(), turn)
    };
    for pose in [Isometry3::translation(0.0, 0.0, 0.5), on_edge(2e-5), on_edge(-2e-5)] {
        let (mut dynamics, mut state) = (Dynamics::new(&model), rested.clone());
        state.set_pose(&model, body, &pose);
        let start = state.clone();
        for _ in 0..600 {
            dynamics.step(&model, &mut state, &Input::default(), DT);
        }
        let far = moved(&model, &start, &state, body);
        assert!(far > 0.1, "{pose:?}: {far}");
    }
}
