#![allow(clippy::unwrap_used)]

use fiatlux_robot::{GainSet, Robot};

use super::*;
use crate::{Random, SceneConfig, Stream};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

fn scene(spec: &EpisodeSpec) -> Arc<Scene> {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = spec.scene(robot.gains(GainSet::default()));
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

fn action(step: u64) -> [f64; JOINTS] {
    let mut random = Random::new(Stream::Noise, 1, step);
    std::array::from_fn(|_| random.uniform(-1.2, 1.2))
}

/// Runs until the end or for some steps; returns every digest on the way.
fn run(episode: &mut Episode, steps: u64) -> Vec<String> {
    let mut digests = vec![episode.digest().hex()];
    for step in 0..steps {
        if episode.step(&action(step)).is_err() {
            break;
        }
        digests.push(episode.digest().hex());
    }
    digests
}

#[test]
fn equal_inputs_give_equal_digests() {
    let mut spec = EpisodeSpec::new(Task::S05, 2, 3);
    // So that another episode plays in the same scene.
    spec.randomize.hand_friction = false;
    let scene = scene(&spec);
    let [first, second] = [(), ()].map(|()| run(&mut Episode::start(Arc::clone(&scene), &spec).unwrap(), 60));
    assert_eq!(first, second);
    let other = EpisodeSpec { episode: 4, ..spec.clone() };
    assert_ne!(first[0], run(&mut Episode::start(Arc::clone(&scene), &other).unwrap(), 0)[0]);
    // A threshold that no row depends on is still in the chain.
    let other = EpisodeSpec { thresholds: Thresholds { facing_rad: 0.4, ..Thresholds::default() }, ..spec };
    assert_ne!(first[0], run(&mut Episode::start(scene, &other).unwrap(), 0)[0]);
}

#[test]
fn joint_targets_are_the_same_as_the_action_they_stand_for() {
    let spec = EpisodeSpec::new(Task::S07, 0, 0);
    let scene = scene(&spec);
    let [mut by_target, mut by_action] = [(), ()].map(|()| Episode::start(Arc::clone(&scene), &spec).unwrap());
    for step in 0..30 {
        let target: [f64; JOINTS] = std::array::from_fn(|joint| scene.robot.q0()[joint] + 0.5 * action(step)[joint]);
        by_target.step(&by_target.action_for(&target)).unwrap();
        let recorded = by_target.row().action.clone();
        by_action.step(&recorded).unwrap();
        for joint in 0..JOINTS {
            assert!((recorded[joint] - action(step)[joint]).abs() < 1e-15, "{joint}");
        }
    }
    assert_eq!(by_target.digest().hex(), by_action.digest().hex());
    assert_eq!(by_target.row(), by_action.row());
}

#[test]
fn a_refused_command_changes_nothing() {
    let spec = EpisodeSpec::new(Task::S07, 0, 0);
    let mut episode = Episode::start(scene(&spec), &spec).unwrap();
    let before = episode.digest().hex();
    let mut bad = [0.0; JOINTS];
    bad[7] = f64::NAN;
    assert!(matches!(episode.step(&bad), Err(EpisodeError::World(WorldError::Joint { .. }))));
    // Finite as a target, but not as an action.
    bad[7] = f64::MAX;
    assert!(matches!(episode.step(&episode.action_for(&bad)), Err(EpisodeError::World(WorldError::Joint { .. }))));
    for value in [1e155, -1000.1] {
        let mut bad = [0.0; JOINTS];
        bad[3] = value;
        let error = episode.step(&bad).unwrap_err();
        let expected = WorldError::Action { joint: "left_knee_joint".into(), value };
        assert_eq!(error, EpisodeError::World(expected));
    }
    assert_eq!((episode.row().step, episode.digest().hex()), (0, before));
    assert_eq!(episode.row().joint_position.len(), JOINTS);
}

/// Zero action falls within seconds; the fall is the end, and nothing follows it.
#[test]
fn an_episode_ends_once() {
    let spec = EpisodeSpec::new(Task::S07, 1, 0);
    let mut episode = Episode::start(scene(&spec), &spec).unwrap();
    let mut steps = 0;
    while episode.end().is_none() {
        let step = episode.step(&[0.0; JOINTS]).unwrap();
        assert!(!step.outside_box);
        steps += 1;
        assert!(steps < 600, "zero action must fall");
    }
    assert_eq!(episode.end().unwrap().cause(), Cause::Fall);
    assert_eq!(episode.newly_met().collect::<Vec<_>>(), [Cause::Fall]);
    assert_eq!(episode.summary().steps, steps);
    let error = episode.step(&[0.0; JOINTS]).unwrap_err();
    assert_eq!(error, EpisodeError::Ended { step: steps });
}

/// The largest action that is taken leaves every sum finite.
#[test]
fn the_largest_action_can_be_recorded() {
    let spec = EpisodeSpec { variant: Variant::Training, ..EpisodeSpec::new(Task::S07, 0, 0) };
    let mut episode = Episode::start(scene(&spec), &spec).unwrap();
    for step in 0..20 {
        let size = if step % 2 == 0 { crate::ACTION_LIMIT } else { -crate::ACTION_LIMIT };
        if episode.step(&[size; JOINTS]).is_err() {
            break;
        }
        assert!(episode.reward().is_finite());
    }
    assert_eq!(episode.summary().control_effort, JOINTS as f64 * 1e6);
}

#[test]
fn episodes_can_be_sent_to_other_threads() {
    fn is_send<T: Send>() {}
    is_send::<Episode>();
}
