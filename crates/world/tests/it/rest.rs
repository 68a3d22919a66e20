//! Things that lie still in the room: which do, which never do by mistake, and that a row alone decides it.

use std::sync::Arc;

use fiatlux_dynamics::Wrench;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{BodyRow, Row, RowDigest, Task, errand};
use fiatlux_world::{
    AppliedWrench, ControlInput, Random, Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, Stream, Target, World,
    start,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

fn world(task: Task, seed: u64) -> World {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    start(scene, task, 0, &StartOptions::default()).unwrap()
}

/// Holds the targets at hand, moved by an action that shakes the joints.
fn step(world: &mut World, shake: f64, wrenches: &[AppliedWrench]) {
    let mut random = Random::new(Stream::Noise, 1, world.row().step);
    let action: Vec<f64> = world.row().joint_target.iter().map(|_| shake * random.uniform(-1.0, 1.0)).collect();
    let q0 = world.scene().robot.q0().to_vec();
    let targets: Vec<f64> = match shake > 0.0 {
        true => q0.iter().zip(&action).map(|(q, a)| q + 0.5 * a).collect(),
        false => world.row().joint_target.clone(),
    };
    world.step_with(&ControlInput { wrenches, ..ControlInput::new(&action, &targets) }).unwrap();
}

fn rests(row: &Row, thing: usize) -> bool {
    let BodyRow { linear_velocity, angular_velocity, .. } = &row.things[thing];
    *linear_velocity == Vector3::zeros() && *angular_velocity == Vector3::zeros()
}

/// 1,000 rows of robots that stand, climb, hold bulbs and fall: from each a world of another past goes on to the same bits.
#[test]
fn a_step_from_any_row_gives_the_same_bits() {
    for (task, shake) in [(Task::S01, 0.0), (Task::S04, 1.0), (Task::S06, 0.3), (Task::S10, 0.6), (Task::S07, 2.0)] {
        let mut original = world(task, 5);
        let mut other = World::new(Arc::clone(original.scene()));
        let mut resting = 0;
        for _ in 0..200 {
            other.reset_to(original.row()).unwrap();
            step(&mut original, shake, &[]);
            step(&mut other, shake, &[]);
            let digest = |row: &Row| {
                let mut digest = RowDigest::new(b"rest");
                digest.push(row);
                digest.hex()
            };
            assert_eq!(digest(other.row()), digest(original.row()), "{task:?}, step {}", original.row().step);
            resting += (0..original.row().things.len()).filter(|&thing| rests(original.row(), thing)).count();
        }
        assert!(resting > 0, "{task:?}: something lies still");
    }
}

/// Ladder and fresh bulb lie still within a second of the start, while the robot falls on the floor beside them; what the
/// robot holds or stands on does not.
#[test]
fn what_lies_still_rests_and_what_is_held_does_not() {
    let mut away = world(Task::S07, 5);
    (0..100).for_each(|_| step(&mut away, 0.0, &[]));
    assert!(rests(away.row(), errand::LADDER) && rests(away.row(), errand::FRESH_BULB), "{:?}", away.row().things);
    for (task, held) in [(Task::S06, errand::OLD_BULB), (Task::S09, errand::FRESH_BULB), (Task::S04, errand::LADDER)] {
        let mut world = world(task, 5);
        for _ in 0..100 {
            step(&mut world, 0.0, &[]);
            assert!(!rests(world.row(), held), "{task:?}, step {}", world.row().step);
        }
    }
}

/// A push below what tips the ladder leaves it at rest; one beyond it tips it, and so do they after an hour's rest.
#[test]
fn a_pushed_ladder_wakes() {
    let mut world = world(Task::S07, 5);
    (0..100).for_each(|_| step(&mut world, 0.0, &[]));
    let ladder = world.scene().body(errand::LADDER).unwrap();
    let start = world.row().things[errand::LADDER].pose;
    for (force, tips) in [(20.0, false), (90.0, true)] {
        let side = start.rotation * Vector3::new(force, 0.0, 0.0);
        let wrench = Wrench { force: side, torque: Vector3::zeros() };
        let push = AppliedWrench { target: Target::Body(ladder), point: Some(Vector3::new(0.0, 0.0, 1.18)), wrench };
        let mut pushed = world.clone();
        (0..75).for_each(|_| step(&mut pushed, 0.0, &[push]));
        let turned = pushed.row().things[errand::LADDER].pose.rotation.angle_to(&start.rotation);
        assert_eq!(turned > 0.05, tips, "{force} N: {turned} rad");
    }
}

/// Rolled on the floor and thrown into the crate, a bulb comes to rest; put on a slope, in the air or against the ladder, it
/// does not where it is put.
#[test]
fn bulbs_come_to_rest_where_they_lie() {
    let mut world = world(Task::S01, 5);
    let put = |world: &mut World, pose: Isometry3<f64>, velocity: Vector3<f64>, turn: Vector3<f64>| {
        let mut row = world.row().clone();
        row.things[errand::FRESH_BULB] = BodyRow { pose, linear_velocity: velocity, angular_velocity: turn };
        world.reset_to(&row).unwrap();
    };
    let side = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
    let world_from_crate = world.scene().world_from(errand::CRATE);
    let crate_center = world_from_crate * Isometry3::from_parts(Vector3::new(-0.12, 0.02, 0.12).into(), side);
    put(&mut world, crate_center, Vector3::new(0.3, 0.2, 0.0), Vector3::new(3.0, 4.0, 1.0));
    (0..400).for_each(|_| step(&mut world, 0.0, &[]));
    assert!(rests(world.row(), errand::FRESH_BULB), "8 s in the crate: {:?}", world.row().things[errand::FRESH_BULB]);
    let at = world.row().things[errand::FRESH_BULB].pose;
    put(&mut world, Isometry3::translation(0.0, 0.0, 1e-3) * at, Vector3::zeros(), Vector3::zeros());
    step(&mut world, 0.0, &[]);
    assert!(!rests(world.row(), errand::FRESH_BULB), "a millimetre above where it lay");
}
