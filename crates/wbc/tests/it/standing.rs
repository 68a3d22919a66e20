//! Standing: still while the arms move, and back to the network when something asks for steps.

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wbc::{BodyCommand, Controller, MOVED, Network};
use fiatlux_world::{ControlInput, Push, Scene, SceneConfig, SceneSpec, World};
use nalgebra::{UnitQuaternion, Vector3};

const SECOND: usize = 50;

/// A robot on a floor with the benchmark's noise.
struct OnFloor {
    world: World,
    observer: Observer,
    controller: Controller,
    targets: Vec<f64>,
}

impl OnFloor {
    fn new() -> Self {
        let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
        let spec = SceneSpec::floor(robot.gains(GainSet::default()));
        let mut world = World::new(Arc::new(Scene::build(&SceneConfig::default(), robot.clone(), spec).unwrap()));
        let mut row = world.row().clone();
        row.joint_position.copy_from_slice(robot.q0());
        row.robot.pose.translation.z = robot.height_on_soles(robot.q0(), &UnitQuaternion::identity()).unwrap();
        world.reset_to(&row).unwrap();
        Self {
            world,
            observer: Observer::new(robot.q0().to_vec(), Some(NoiseSeed { seed: 0, episode: 0 })),
            controller: Controller::new(Arc::new(Network::shipped().unwrap())),
            targets: robot.q0().to_vec(),
        }
    }

    /// Where the pelvis is after a control step, m.
    fn step(&mut self, command: &BodyCommand, push: Option<Push>) -> Vector3<f64> {
        let mut seen = Proprioception::zeros(0);
        self.observer.observe(self.world.row(), &mut seen);
        self.controller.step(&seen.view(), command, &mut self.targets[..MOVED]).unwrap();
        let action = vec![0.0; self.targets.len()];
        let input = ControlInput { push, ..ControlInput::new(&action, &self.targets) };
        self.world.step_with(&input).unwrap().robot.pose.translation.vector
    }
}

#[test]
fn it_stands_still_and_where_it_is_while_the_arms_move() {
    let (mut robot, command) = (OnFloor::new(), BodyCommand::default());
    for _ in 0..3 * SECOND {
        robot.step(&command, None);
    }
    assert!(robot.controller.is_standing());
    let start = robot.world.row().robot.pose.translation.vector;
    let feet =
        [0, 1].map(|side| robot.world.world_from_link(robot.world.scene().robot.feet()[side]).translation.vector);
    let mut places = Vec::new();
    for step in 0..20 * SECOND {
        // Both shoulders' pitch swings by half a radian in three seconds, then rests.
        let phase = std::f64::consts::TAU * (step.min(15 * SECOND) as f64) / (3 * SECOND) as f64;
        for shoulder in [MOVED, MOVED + 7] {
            robot.targets[shoulder] = robot.world.scene().robot.q0()[shoulder] - 0.5 * phase.sin().abs();
        }
        let place = robot.step(&command, None);
        assert!(robot.controller.is_standing(), "step {step}");
        if step >= 18 * SECOND {
            places.push(place);
        }
    }
    let mean = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
    let rms = (places.iter().map(|place| (place - mean).norm_squared()).sum::<f64>() / places.len() as f64).sqrt();
    assert!(rms < 0.006, "{rms} m");
    assert!((mean - start).xy().norm() < 0.02, "{mean} after {start}");
    for (side, foot) in feet.iter().enumerate() {
        let now = robot.world.world_from_link(robot.world.scene().robot.feet()[side]).translation.vector;
        assert!((now - foot).norm() < 0.01, "foot {side} went {} m", (now - foot).norm());
    }
}

#[test]
fn it_comes_to_a_height_and_a_lean() {
    let mut robot = OnFloor::new();
    let command = BodyCommand { height: 0.62, torso: [0.1, 0.4, -0.2], ..BodyCommand::default() };
    let mut height = 0.0;
    for step in 0..10 * SECOND {
        let place = robot.step(&command, None);
        if step >= 8 * SECOND {
            height += place.z / (2 * SECOND) as f64;
        }
    }
    assert!(robot.controller.is_standing());
    assert!((height - command.height).abs() < 0.015, "{height} m");
    let torso = robot.world.scene().robot.link_index("torso_link").unwrap();
    let rotation = robot.world.world_from_link(torso).rotation;
    let ahead = robot.world.row().robot.pose.rotation * Vector3::x();
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ahead.y.atan2(ahead.x));
    let (roll, pitch, yaw) = (heading.inverse() * rotation).euler_angles();
    for (found, wanted) in [roll, pitch, yaw].into_iter().zip(command.torso) {
        assert!((found - wanted).abs() < 0.06, "{found} rad, wanted {wanted}");
    }
}

#[test]
fn a_push_and_a_command_to_walk_give_the_robot_back() {
    let (mut robot, command) = (OnFloor::new(), BodyCommand::default());
    for _ in 0..3 * SECOND {
        robot.step(&command, None);
    }
    assert!(robot.controller.is_standing());
    let push = Push { linear: Vector3::new(0.6, 0.3, 0.0), angular: Vector3::zeros() };
    robot.step(&command, Some(push));
    let mut stood = Vec::new();
    for _ in 0..15 * SECOND {
        let place = robot.step(&command, None);
        assert!(place.z > 0.6);
        stood.push(robot.controller.is_standing());
    }
    let gave_back = stood.iter().position(|stands| !stands).expect("the push is too much for feet that stay");
    assert!(stood[gave_back..].contains(&true), "it stands again");
    robot.step(&BodyCommand { velocity: [0.3, 0.0, 0.0], ..command }, None);
    robot.step(&BodyCommand { velocity: [0.3, 0.0, 0.0], ..command }, None);
    assert!(!robot.controller.is_standing());
}
