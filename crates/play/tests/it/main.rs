//! Commands of an episode in their three forms, and refused ones.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;

use fiatlux_play::{Command, Play, PlayError};
use fiatlux_proto::BodyCommand;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_sensing::{Sensor, SensorSuite, Sensors, Setup};
use fiatlux_world::{Episode, EpisodeError, EpisodeRanges, EpisodeSpec, Scene, SceneConfig};

fn play(delay: usize) -> Play {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = EpisodeSpec::new(Task::S05, 2, 0);
    let gains = robot.gains(GainSet::default());
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap());
    let suite = SensorSuite::new(Sensors::of_body(Task::S05), Setup::new(&scene, Task::S05));
    Play::start(Episode::start(scene, &spec).unwrap(), suite, delay).unwrap()
}

fn bent(play: &Play, by: f64) -> Vec<f64> {
    play.episode().scene().robot.q0().iter().map(|q0| q0 + by).collect()
}

#[test]
fn a_refused_command_is_not_delayed_either() {
    let (mut bothered, mut calm) = (play(2), play(2));
    let numbers = calm.episode().row().action.len();
    for step in 0..5 {
        let command = Command::Action(vec![0.01 * f64::from(step); numbers]);
        for wrong in [vec![f64::NAN; numbers], vec![0.0; numbers - 1], vec![1e9; numbers]] {
            let refused = bothered.step(&Command::Action(wrong)).unwrap_err();
            assert!(matches!(refused, PlayError::Episode(EpisodeError::World(_))), "{refused}");
        }
        assert_eq!(bothered.step(&command).unwrap(), calm.step(&command).unwrap());
        assert_eq!(bothered.episode().digest().hex(), calm.episode().digest().hex(), "step {step}");
    }
}

#[test]
fn joint_targets_are_the_action_that_leads_to_them() {
    let (mut by_target, mut by_action) = (play(0), play(0));
    let target = bent(&by_target, 0.03);
    let action = by_action.episode().action_for(&target);
    assert!(!by_target.step(&Command::JointTarget(target)).unwrap().outside_box);
    by_action.step(&Command::Action(action)).unwrap();
    assert_eq!(by_target.episode().digest().hex(), by_action.episode().digest().hex());
}

/// The targets that a whole-body command led to give the same rows when they are sent; another command ends the controller's rhythm.
#[test]
fn what_follows_a_whole_body_command_can_be_played_again() {
    let walk = Command::WholeBody(BodyCommand { velocity: [0.3, 0.0, 0.0], ..BodyCommand::default() }, Vec::new());
    let (mut followed, mut again) = (play(1), play(1));
    for step in 0..12 {
        let targets = followed.step(&walk).unwrap().followed.unwrap();
        again.step(&Command::JointTarget(targets)).unwrap();
        assert_eq!(followed.episode().digest().hex(), again.episode().digest().hex(), "step {step}");
    }
    let mut interrupted = followed.clone();
    let held = Command::Action(followed.episode().row().action.clone());
    assert_eq!(interrupted.step(&held).unwrap().followed, None);
    followed.step(&walk).unwrap();
    let [goes_on, anew] = [followed.step(&walk), interrupted.step(&walk)].map(|step| step.unwrap().followed);
    assert!(goes_on.is_some() && anew.is_some() && goes_on != anew);
}

/// Pictures vary as the episode draws, the same each time, and rows and digest do not.
#[test]
fn pictures_vary_and_rows_do_not() {
    let start = |ranges: &[(&str, [f64; 2])]| {
        let ranges = EpisodeRanges::new(ranges.iter().map(|(name, range)| ((*name).to_owned(), *range))).unwrap();
        let robot = Arc::new(Robot::benchmark().unwrap());
        let spec = EpisodeSpec { ranges, ..EpisodeSpec::new(Task::S05, 2, 0) };
        let scene = spec.scene(robot.gains(GainSet::default()));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, scene).unwrap());
        let setup = Setup { image_size: [32, 24], ..Setup::new(&scene, Task::S05) };
        let suite = SensorSuite::new(Sensors::of(&[Sensor::Camera]), setup);
        Play::start(Episode::start(scene, &spec).unwrap(), suite, 0).unwrap()
    };
    let seen = |play: &mut Play| {
        let command = Command::Action(vec![0.3; play.episode().row().action.len()]);
        let pictures: Vec<_> = (0..4)
            .map(|_| {
                let picture = play.observe(Sensors::of(&[Sensor::Camera])).unwrap().camera.unwrap().rgb;
                play.step(&command).unwrap();
                picture
            })
            .collect();
        (pictures, play.episode().digest().hex())
    };
    let (plain, digest) = seen(&mut start(&[]));
    let all = [("camera.yaw", [0.1, 0.2]), ("camera.noise", [3.0, 6.0]), ("camera.pattern", [1.0, 8.0])];
    let varied = seen(&mut start(&all));
    assert_eq!(seen(&mut start(&all)), varied);
    assert_eq!(varied.1, digest);
    assert!(varied.0.iter().zip(&plain).all(|(varied, plain)| varied != plain));
    let late = seen(&mut start(&[("camera.delay", [20.0, 20.0])])).0;
    assert_eq!((&late[0], &late[1..]), (&plain[0], &plain[..3]));
}
