//! The robot dropped from 1 m in any posture onto floor and ladder, its joints chasing random targets.

use fiatlux_rules::errand;
use std::f64::consts::TAU;

use fiatlux_dynamics::{BodyId, Contact, ShapeId};
use fiatlux_robot::GainSet;
use fiatlux_tests::{Rig, repeats, robot, scene};
use fiatlux_world::{ACTION_SCALE, PHYSICS_DT, Random, SUBSTEPS, SceneKind, ShapeOwner, Stream};
use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};

/// Targets change every control step this long, s, and are then held.
const RANDOM_SECONDS: f64 = 6.0;
const HELD_SECONDS: f64 = 2.0;
/// Last part of the held time that counts as rest, s.
const REST_SECONDS: f64 = 1.0;
/// Lowest point at the start, above the floor or the ladder's top, m.
const HEIGHT: f64 = 1.0;
/// Deepest overlap while limbs strike at 4 to 8 m/s, m. Reached: 15 mm, for one step.
const DEEPEST: f64 = 0.020;
/// Deepest overlap that a start posture may have, m.
const START_OVERLAP: f64 = 2e-3;

/// Uniform over all orientations (Shoemake 1992).
fn random_rotation(random: &mut Random) -> UnitQuaternion<f64> {
    let (u, a, b) = (random.unit(), random.uniform(0.0, TAU), random.uniform(0.0, TAU));
    let (p, q) = (libm::sqrt(1.0 - u), libm::sqrt(u));
    UnitQuaternion::new_normalize(Quaternion::new(
        p * libm::sin(a),
        p * libm::cos(a),
        q * libm::sin(b),
        q * libm::cos(b),
    ))
}

/// Puts the robot in a random posture, its lowest point `HEIGHT` above the floor or above the ladder; returns the number
/// of postures drawn until one touched neither itself nor the room.
fn hang(rig: &mut Rig, random: &mut Random, above_ladder: bool) -> u32 {
    let scene = rig.scene.clone();
    let (center, floor) = if above_ladder {
        (scene.world_from(errand::LADDER).translation.vector, scene.config.ladder.size[2])
    } else {
        (scene.layout.robot.world_from_place(0.0).translation.vector, 0.0)
    };
    for draw in 1..=100_000 {
        let joints: Vec<f64> = scene.robot.joints().iter().map(|j| random.uniform(j.lower, j.upper)).collect();
        rig.set_joints(&joints);
        let offset = Vector3::new(random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3), 0.0);
        let mut pose = Isometry3::from_parts((center + offset).into(), random_rotation(random));
        rig.place_robot(&pose);
        pose.translation.z += floor + HEIGHT - rig.lowest_of(|_| true);
        rig.place_robot(&pose);
        let touching = scene.model.contacts_at(&rig.state.qpos, 0.0).unwrap();
        let on_robot = |shape| matches!(scene.owner(shape), ShapeOwner::Robot(_));
        let allowed = |c: &Contact| match (on_robot(c.shape_a), on_robot(c.shape_b)) {
            (true, true) => c.distance > -START_OVERLAP,
            (false, false) => true,
            _ => false,
        };
        if touching.iter().all(allowed) {
            return draw;
        }
    }
    panic!("no posture without overlap");
}

/// Targets of a uniformly random action, as a policy would send them.
fn draw_targets(rig: &mut Rig, random: &mut Random) {
    let scene = rig.scene.clone();
    for ((ids, joint), q0) in scene.robot_ids.joints.iter().zip(scene.robot.joints()).zip(scene.robot.q0()) {
        rig.targets[ids.drive] = (q0 + ACTION_SCALE * random.uniform(-1.0, 1.0)).clamp(joint.lower, joint.upper);
    }
}

#[derive(Default)]
struct Drop {
    /// Physics steps that did not converge, and the most iterations that one took.
    unconverged: u32,
    iterations: u32,
    /// Deepest overlap at any time and at rest, m, and between what.
    deepest: (f64, String),
    at_rest: (f64, String),
    /// Fastest speed of a link at rest, m/s.
    speed: f64,
}

fn note(deepest: &mut (f64, String), rig: &Rig) {
    for contact in rig.dynamics.contacts() {
        if -contact.distance > deepest.0 {
            let name = |shape: ShapeId| &rig.scene.model.shapes()[shape.0].name;
            *deepest = (-contact.distance, format!("{} in {}", name(contact.shape_a), name(contact.shape_b)));
        }
    }
}

fn assert_in_room(rig: &mut Rig, what: &str) {
    assert!(rig.state.qpos.iter().chain(&rig.state.qvel).all(|x| x.is_finite()), "{what}: a number is not finite");
    rig.update();
    let room = &rig.scene.config.room;
    let model = &rig.scene.model;
    for index in 1..model.bodies().len() {
        let p = rig.pose(BodyId(index)) * Point3::from(model.bodies()[index].spec.com);
        let inside = (room.outer_x[0]..room.outer_x[1]).contains(&p.x)
            && (room.outer_y[0]..room.outer_y[1]).contains(&p.y)
            && (0.0..room.ceiling_height).contains(&p.z);
        assert!(inside, "{what}: {} is at {p:?}", model.bodies()[index].spec.name);
    }
}

fn drop(seed: u64) -> Drop {
    let above_ladder = seed.is_multiple_of(2);
    let mut rig = Rig::new(&scene(SceneKind::FreeLadder, seed, robot().gains(GainSet::Fiatlux)));
    let mut random = Random::new(Stream::Noise, seed, 0);
    let draws = hang(&mut rig, &mut random, above_ladder);
    let mut drop = Drop::default();
    let steps = ((RANDOM_SECONDS + HELD_SECONDS) / PHYSICS_DT).round() as usize;
    let held_from = (RANDOM_SECONDS / PHYSICS_DT).round() as usize;
    let rest_from = steps - (REST_SECONDS / PHYSICS_DT).round() as usize;
    for step in 0..steps {
        if step % SUBSTEPS == 0 && step < held_from {
            draw_targets(&mut rig, &mut random);
        }
        let report = rig.step();
        drop.unconverged += u32::from(!report.converged);
        drop.iterations = drop.iterations.max(report.iterations);
        note(&mut drop.deepest, &rig);
        if step % 20 == 0 {
            assert_in_room(&mut rig, &format!("drop {seed}, step {step}"));
        }
        if step >= rest_from {
            note(&mut drop.at_rest, &rig);
            rig.update();
            let links = &rig.scene.robot_ids.links;
            let fastest = links.iter().map(|l| rig.dynamics.velocity(l.body).linear.norm()).fold(0.0, f64::max);
            drop.speed = drop.speed.max(fastest);
        }
    }
    println!(
        "drop {seed:2} on {}: {draws} draws, {} unconverged, {} iterations, deepest {:.1} mm ({}), at rest {:.1} mm ({}), {:.3} m/s",
        if above_ladder { "ladder" } else { "floor" },
        drop.unconverged,
        drop.iterations,
        1e3 * drop.deepest.0,
        drop.deepest.1,
        1e3 * drop.at_rest.0,
        drop.at_rest.1,
        drop.speed,
    );
    drop
}

#[test]
fn drops_onto_ladder_and_floor() {
    let drops: Vec<Drop> = (0..repeats(40, 12, 12)).map(drop).collect();
    let worst = |figure: fn(&Drop) -> f64| drops.iter().map(figure).fold(0.0, f64::max);
    let (deepest, at_rest) = (worst(|d| d.deepest.0), worst(|d| d.at_rest.0));
    let unconverged: u32 = drops.iter().map(|d| d.unconverged).sum();
    println!(
        "in all: {unconverged} unconverged, at most {} iterations, {:.1} mm in motion, {:.1} mm at rest",
        worst(|d| f64::from(d.iterations)),
        1e3 * deepest,
        1e3 * at_rest
    );
    assert!(at_rest < 0.010, "{at_rest} m at rest");
    assert!(deepest < DEEPEST, "{deepest} m in motion");
    assert_eq!(unconverged, 0, "steps that did not converge");
}
