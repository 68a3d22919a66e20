//! States that leave the range of numbers, and the peaks that a world notes in every control step.

use std::sync::Arc;

use fiatlux_dynamics::Wrench;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Cause, Judge, JudgeOptions, Protocol, Row, Task, Thresholds};
use fiatlux_world::{AppliedWrench, ControlInput, Push, Scene, SceneConfig, SceneKind, SceneSpec, Target, World};
use nalgebra::Vector3;

fn world() -> World {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec::new(SceneKind::FreeLadder, 0, robot.gains(GainSet::Fiatlux));
    World::new(Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap()))
}

fn step(world: &mut World, wrenches: &[AppliedWrench], push: Option<Push>) -> Row {
    let q0 = world.scene().robot.q0().to_vec();
    let action = vec![0.0; q0.len()];
    let input = ControlInput { wrenches, push, ..ControlInput::new(&action, &q0) };
    world.step_with(&input).unwrap().clone()
}

fn force(newtons: f64) -> AppliedWrench {
    let wrench = Wrench { force: Vector3::new(newtons, 0.0, newtons), torque: Vector3::repeat(newtons) };
    AppliedWrench { target: Target::Link(0), point: None, wrench }
}

fn numbers(row: &Row) -> Vec<f64> {
    let mut numbers = vec![row.penetration];
    for body in [&row.robot].into_iter().chain(&row.things) {
        numbers.extend(body.pose.translation.vector.iter().chain(body.pose.rotation.coords.iter()));
        numbers.extend(body.linear_velocity.iter().chain(body.angular_velocity.iter()));
    }
    for list in [&row.joint_position, &row.joint_velocity, &row.joint_effort, &row.joint_target, &row.action] {
        numbers.extend(list);
    }
    numbers.extend(row.forces.iter().flat_map(|force| force.iter()));
    numbers.extend(&row.loads);
    numbers.extend(
        row.com_velocity.iter().chain(row.world_from_palm.iter().flat_map(|palm| palm.translation.vector.iter())),
    );
    numbers
}

/// Everything that throws the robot out of the numbers leaves the last finite state, says so, and ends an episode.
#[test]
fn a_state_that_is_not_finite_is_undone() {
    let huge = |size| Some(Push { linear: Vector3::repeat(size), angular: Vector3::repeat(size) });
    let mut shoves: Vec<(Vec<AppliedWrench>, Option<Push>)> = Vec::new();
    for size in [1e15, 1e200, 1e300, f64::MAX] {
        shoves.push((vec![force(size)], None));
        shoves.push((vec![], huge(size)));
    }
    let mut unsolved = 0;
    for (wrenches, push) in shoves {
        let mut world = world();
        let before = step(&mut world, &[], None);
        let row = step(&mut world, &wrenches, push);
        let what = format!("{wrenches:?} {push:?}");
        assert_eq!(row.step, 2, "{what}");
        assert!(numbers(&row).iter().all(|number| number.is_finite()), "{what}");
        if row.joint_speed_peak.is_finite() {
            // The squares of such a force are infinite, and the engine's solve goes nowhere: the state stays plausible.
            assert!(push.is_none() && row.joint_speed_peak < 200.0, "{what}");
            unsolved += 1;
            continue;
        }
        // The first physics step failed, so that the state is the one before, and the push with it is gone.
        assert_eq!((&row.robot, &row.joint_position), (&before.robot, &before.joint_position), "{what}");
        for task in Task::ALL {
            let options = JudgeOptions { end_on: Some(fiatlux_rules::Causes::NONE), ..JudgeOptions::default() };
            let mut judge =
                Judge::new(Protocol::Strict, task, Thresholds::default(), world.scene().geometry(), options);
            judge.start(&before);
            assert_eq!(judge.advance(&row).end.map(|end| end.cause()), Some(Cause::Diverged), "{task} {what}");
        }
        // The world is whole: it goes on as one that starts from that row.
        let mut other = World::new(Arc::clone(world.scene()));
        other.reset_to(&row).unwrap();
        let next = step(&mut world, &[], None);
        assert_eq!(next, step(&mut other, &[], None), "{what}");
        assert!(next.joint_speed_peak < 200.0, "{what}");
    }
    assert!(unsolved < 4, "no force led out of the numbers");
}

/// A speed that is finite but absurd is a row like any other; the rules end it.
#[test]
fn absurd_speeds_that_are_finite_diverge_by_the_rules() {
    let mut world = world();
    let first = world.row().clone();
    let row = step(&mut world, &[], Some(Push { linear: Vector3::new(30.0, 0.0, 0.0), angular: Vector3::zeros() }));
    assert!(row.joint_speed_peak.is_finite() && row.robot.linear_velocity.norm() > 20.0);
    let mut judge = Judge::new(
        Protocol::Strict,
        Task::S01,
        Thresholds::default(),
        world.scene().geometry(),
        JudgeOptions::default(),
    );
    judge.start(&first);
    assert_eq!(judge.advance(&row).end.map(|end| end.cause()), Some(Cause::Diverged));
}

/// The peak covers the body's joints, not the fingers, and all physics steps; the feet press into the floor a little.
#[test]
fn rows_note_peaks_of_their_physics_steps() {
    let mut world = world();
    assert_eq!((world.row().joint_speed_peak, world.row().penetration), (0.0, 0.0));
    let joints = world.scene().robot.joints();
    let index = |name: &str| joints.iter().position(|joint| joint.name == name).unwrap();
    let elbow = index("left_elbow_joint");
    let finger = joints.iter().position(|joint| joint.gains.speed_limit.is_infinite()).unwrap();
    let mut target = world.scene().robot.q0().to_vec();
    let action = vec![0.0; target.len()];
    (target[elbow], target[finger]) = (target[elbow] - 1.0, 1.0);
    let mut fastest = 0.0_f64;
    for _ in 0..10 {
        let row = world.step(&action, &target).unwrap();
        assert!(row.joint_speed_peak >= row.joint_velocity[elbow].abs());
        assert!(row.penetration > 0.0 && row.penetration < 0.005, "{}", row.penetration);
        assert!(row.unconverged <= row.retried && row.retried <= 4);
        fastest = fastest.max(row.joint_speed_peak);
    }
    assert!(fastest > 2.0 && fastest < 37.0, "{fastest}");

    let mut row = world.row().clone();
    row.joint_velocity.fill(0.0);
    row.joint_velocity[finger] = 60.0;
    world.reset_to(&row).unwrap();
    let quick = world.step(&action, &target).unwrap();
    assert!(quick.joint_speed_peak < 37.0, "{}", quick.joint_speed_peak);
}
