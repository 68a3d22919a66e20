//! Motion that has a closed form: what the engine must reproduce whatever its method.

use fiatlux_dynamics::*;
use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};

use crate::mass_matrix;

const DT: f64 = 0.005;

fn body(name: &str, mass: f64, inertia: [f64; 3]) -> BodySpec {
    BodySpec {
        name: name.into(),
        parent: BodyId::WORLD,
        parent_from_body: Isometry3::identity(),
        joint: Joint::Free,
        mass,
        com: Vector3::zeros(),
        inertia: Matrix3::from_diagonal(&Vector3::from(inertia)),
    }
}

fn shape(name: &str, body: BodyId, geometry: Geometry, friction: f64) -> ShapeSpec {
    ShapeSpec {
        name: name.into(),
        body,
        body_from_shape: Isometry3::identity(),
        geometry,
        material: Material::new(friction, 0),
        cull_group: body.0 as u16,
        label: 0,
    }
}

/// A cube of 0.2 m and 2 kg on a half-space tilted by `slope` rad about y.
fn cube_on_slope(slope: f64, friction: f64) -> (Model, State) {
    let mut builder = ModelBuilder::new();
    let moment = 2.0 * 0.2 * 0.2 / 6.0;
    let cube = builder.add_body(body("cube", 2.0, [moment; 3])).unwrap();
    let half_extents = Vector3::repeat(0.1);
    builder.add_shape(shape("cube", cube, Geometry::Cuboid { half_extents }, friction)).unwrap();
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), slope);
    let mut ground = shape("ground", BodyId::WORLD, Geometry::HalfSpace, friction);
    ground.body_from_shape.rotation = tilt;
    builder.add_shape(ground).unwrap();
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    state.set_pose(&model, cube, &Isometry3::from_parts((tilt * Vector3::new(0.0, 0.0, 0.1)).into(), tilt));
    (model, state)
}

fn run(model: &Model, state: &mut State, seconds: f64, dt: f64) -> Dynamics {
    let mut dynamics = Dynamics::new(model);
    let targets = vec![0.0; model.drives().len()];
    for _ in 0..(seconds / dt).round() as usize {
        let report = dynamics.step(model, state, &Input { targets: &targets, ..Input::default() }, dt);
        assert!(report.converged, "no convergence after {} iterations", report.iterations);
    }
    dynamics.update(model, state);
    dynamics
}

#[test]
fn a_cube_sticks_below_the_friction_angle_and_slides_above_it() {
    let friction: f64 = 0.5;
    let (model, mut state) = cube_on_slope(0.9 * friction.atan(), friction);
    let start = state.clone();
    let dynamics = run(&model, &mut state, 5.0, DT);
    let moved = (0..3).map(|k| (state.qpos[k] - start.qpos[k]).powi(2)).sum::<f64>().sqrt();
    assert!(moved < 1.5e-3, "crept {moved} m in 5 s");
    let carried: f64 = dynamics.contacts().iter().map(|c| c.force.z).sum();
    assert!((carried.abs() - 2.0 * 9.81).abs() < 1e-3, "carries {carried} N");

    let slope = 2.0 * friction.atan();
    let (model, mut state) = cube_on_slope(slope, friction);
    run(&model, &mut state, 0.5, DT);
    let speed = state.qvel[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
    let expected = 9.81 * (slope.sin() - friction * slope.cos()) * 0.5;
    assert!((speed / expected - 1.0).abs() < 0.03, "slides at {speed}, closed form {expected}");
}

#[test]
fn a_saturated_drive_accelerates_at_its_limit_over_inertia() {
    let mut builder = ModelBuilder::new();
    builder.set_gravity(Vector3::zeros());
    let mut arm = body("arm", 1.0, [0.02, 0.03, 0.04]);
    let drive = Drive { stiffness: 1000.0, damping: 1.0, effort_limit: 0.5, speed_limit: f64::INFINITY };
    arm.joint = Joint::Hinge(Hinge {
        axis: Vector3::z_axis(),
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        armature: 0.01,
        drive: Some(drive),
    });
    builder.add_body(arm).unwrap();
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    let mut dynamics = Dynamics::new(&model);
    for step in 1..=100 {
        let report = dynamics.step(&model, &mut state, &Input { targets: &[10.0], ..Input::default() }, DT);
        assert!(report.converged);
        let expected = 0.5 / 0.05 * DT * f64::from(step);
        assert!((state.qvel[0] - expected).abs() < 1e-9, "step {step}: {} against {expected}", state.qvel[0]);
        assert_eq!(dynamics.efforts(), [0.5]);
    }
}

#[test]
fn a_torque_free_body_keeps_its_angular_momentum() {
    let mut builder = ModelBuilder::new();
    builder.set_gravity(Vector3::zeros());
    let mut spec = body("top", 1.0, [0.01, 0.02, 0.025]);
    spec.com = Vector3::new(0.05, -0.02, 0.03);
    let top = builder.add_body(spec).unwrap();
    let model = builder.build().unwrap();
    let drift = |dt: f64| {
        let mut state = model.reference_state();
        state.qvel[3..].copy_from_slice(&[1.0, 2.0, 3.0]);
        let momentum = |state: &State| {
            let mut dynamics = Dynamics::new(&model);
            let matrix = mass_matrix(&model, state);
            let p: Vec<f64> = (0..6).map(|r| (0..6).map(|c| matrix[r * 6 + c] * state.qvel[c]).sum()).collect();
            let linear = Vector3::new(p[0], p[1], p[2]);
            let about_origin = Vector3::new(p[3], p[4], p[5]);
            dynamics.update(&model, state);
            about_origin + dynamics.world_from_body(top).translation.vector.cross(&linear)
        };
        let before = momentum(&state);
        run(&model, &mut state, 1.0, dt);
        (momentum(&state) - before).norm() / before.norm()
    };
    let (coarse, fine) = (drift(2e-3), drift(1e-3));
    assert!(fine < 5e-3, "drift {fine}");
    assert!((coarse / fine - 2.0).abs() < 0.2, "first order: {coarse} and {fine}");
}

#[test]
fn a_fast_ball_stops_at_the_surface_it_meets() {
    let mut builder = ModelBuilder::new();
    let ball = builder.add_body(body("ball", 0.5, [2e-4; 3])).unwrap();
    builder.add_shape(shape("ball", ball, Geometry::Sphere { radius: 0.03 }, 0.5)).unwrap();
    builder.add_shape(shape("ground", BodyId::WORLD, Geometry::HalfSpace, 0.5)).unwrap();
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    state.set_pose(&model, ball, &Isometry3::translation(0.0, 0.0, 0.1));
    state.qvel[2] = -10.0;
    let mut dynamics = Dynamics::new(&model);
    let mut lowest = f64::INFINITY;
    for _ in 0..100 {
        dynamics.step(&model, &mut state, &Input::default(), DT);
        lowest = lowest.min(state.qpos[2] - 0.03);
    }
    assert!(lowest > -1e-3, "went {lowest} m deep");
}

#[test]
fn a_wrench_acts_at_the_centre_of_mass_in_world_axes() {
    let mut builder = ModelBuilder::new();
    builder.set_gravity(Vector3::zeros());
    let mut spec = body("rod", 2.0, [0.02, 0.03, 0.04]);
    spec.com = Vector3::new(0.3, -0.1, 0.2);
    let rod = builder.add_body(spec).unwrap();
    let model = builder.build().unwrap();
    let mut state = model.reference_state();
    let turn = UnitQuaternion::from_euler_angles(0.4, -0.7, 1.1);
    state.set_pose(&model, rod, &Isometry3::from_parts(Vector3::zeros().into(), turn));
    let start = state.clone();
    let mut dynamics = Dynamics::new(&model);
    let mut step = |force, torque| {
        let mut state = start.clone();
        let wrenches = [(rod, Wrench { force, torque })];
        dynamics.step(&model, &mut state, &Input { wrenches: &wrenches, ..Input::default() }, DT);
        (Vector3::from_column_slice(&state.qvel[..3]), Vector3::from_column_slice(&state.qvel[3..]))
    };
    let force = Vector3::new(1.0, 2.0, -3.0);
    let (linear, angular) = step(force, Vector3::zeros());
    assert!((linear - force * (DT / 2.0)).norm() < 1e-12 && angular.norm() < 1e-12, "{linear} {angular}");

    let torque = Vector3::new(0.1, 0.2, 0.3);
    let (linear, angular) = step(Vector3::zeros(), torque);
    let in_body = turn.inverse() * torque;
    let expected = turn * Vector3::new(in_body.x / 0.02, in_body.y / 0.03, in_body.z / 0.04) * DT;
    let com_velocity = linear + angular.cross(&(turn * Vector3::new(0.3, -0.1, 0.2)));
    assert!((angular - expected).norm() < 1e-12 && com_velocity.norm() < 1e-12, "{angular} {com_velocity}");
}

/// A motor that is asked for all it has reaches its rated speed and no more; faster than that it only brakes, with all it
/// has.
#[test]
fn a_motor_drives_no_joint_beyond_its_rated_speed() {
    let (limit, rated, inertia) = (0.5, 20.0, 0.05);
    let mut builder = ModelBuilder::new();
    builder.set_gravity(Vector3::zeros());
    let mut arm = body("arm", 1.0, [0.02, 0.03, 0.04]);
    arm.joint = Joint::Hinge(Hinge {
        axis: Vector3::z_axis(),
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        armature: 0.01,
        drive: Some(Drive { stiffness: 1000.0, damping: 1.0, effort_limit: limit, speed_limit: rated }),
    });
    builder.add_body(arm).unwrap();
    let model = builder.build().unwrap();
    let (mut dynamics, mut state) = (Dynamics::new(&model), model.reference_state());
    let mut step = |state: &mut State, target: f64| {
        dynamics.step(&model, state, &Input { targets: &[target], ..Input::default() }, DT);
        dynamics.efforts()[0]
    };
    // 2 s to the speed, from where the effort fades.
    for _ in 0..1000 {
        let (before, effort) = (state.qvel[0], step(&mut state, 1e6));
        assert!(state.qvel[0] <= rated && effort >= 0.0);
        assert!(
            before > Drive::CORNER * rated || (effort - limit).abs() < 1e-9 || state.qvel[0] > Drive::CORNER * rated
        );
    }
    assert!(state.qvel[0] > 0.999 * rated, "{}", state.qvel[0]);

    for (sign, target) in [(1.0, 1e6), (-1.0, -1e6)] {
        state.qvel[0] = sign * 2.0 * rated;
        assert_eq!(step(&mut state, target), 0.0, "it pushes a joint on that is too fast");
        assert_eq!(state.qvel[0], sign * 2.0 * rated);
        let effort = step(&mut state, -target);
        assert!((effort + sign * limit).abs() < 1e-9, "it brakes with {effort} N m");
        assert!((state.qvel[0] - sign * (2.0 * rated - limit / inertia * DT)).abs() < 1e-9);
    }
}

/// A chain that whirls in empty space, at speeds that take several substeps.
#[test]
fn a_whirling_chain_keeps_its_energy() {
    let mut builder = ModelBuilder::new();
    builder.set_gravity(Vector3::zeros());
    let mut parent = builder.add_body(body("base", 3.0, [0.02, 0.03, 0.04])).unwrap();
    for (index, axis) in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis(), Vector3::x_axis()].iter().enumerate()
    {
        let mut link = body(&format!("link {index}"), 0.8, [0.004, 0.003, 0.001]);
        link.parent = parent;
        link.parent_from_body = Isometry3::translation(0.05, 0.02, -0.2);
        link.com = Vector3::new(0.0, 0.01, -0.1);
        link.joint = Joint::Hinge(Hinge {
            axis: *axis,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            armature: 0.002,
            drive: None,
        });
        parent = builder.add_body(link).unwrap();
    }
    let model = builder.build().unwrap();
    let energy = |state: &State| {
        let matrix = mass_matrix(&model, state);
        let nv = model.nv();
        (0..nv * nv).map(|k| 0.5 * state.qvel[k / nv] * matrix[k] * state.qvel[k % nv]).sum::<f64>()
    };
    for speed in [15.0, 30.0, 60.0] {
        let mut state = model.reference_state();
        for (index, velocity) in state.qvel[6..].iter_mut().enumerate() {
            *velocity = if index % 2 == 0 { speed } else { -speed };
        }
        let before = energy(&state);
        let mut dynamics = Dynamics::new(&model);
        for _ in 0..100 {
            let report = dynamics.step(&model, &mut state, &Input::default(), DT);
            assert!(report.converged);
            let change = energy(&state) / before - 1.0;
            assert!(change.abs() < 0.01, "{speed} rad/s: {change:+.4}");
        }
    }
}
