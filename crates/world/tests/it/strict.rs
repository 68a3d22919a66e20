//! Readings of protocol `strict` against worlds in motion.

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{GRAVITY, LIMBS, Protocol, Support, Task, errand, strict};
use fiatlux_world::{Episode, EpisodeSpec, PropScale, Scene, SceneConfig};

fn episode(spec: &EpisodeSpec) -> Episode {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let scene = Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap();
    Episode::start(Arc::new(scene), spec).unwrap()
}

/// A bulb that starts in the hand is in its grip in row 0, and stays there while the robot keeps its posture.
#[test]
fn bulbs_in_hand_are_in_its_grip() {
    let mut tasks = 0;
    for task in Task::ALL {
        let Some(bulb) = task.spec().start.in_hand() else { continue };
        tasks += 1;
        for seed in 4..10 {
            let mut episode = episode(&EpisodeSpec::new(task, seed, 0));
            let hold = episode.row().action.clone();
            for step in 0..=10 {
                let in_grip = strict::in_grip(episode.row(), &episode.judges().of(Protocol::Strict).context(), bulb);
                assert!(
                    in_grip,
                    "{task}, seed {seed}, row {step}: {:?}",
                    episode.row().force(errand::HAND_FORCE[bulb as usize])
                );
                episode.step(&hold).unwrap();
            }
        }
    }
    assert_eq!(tasks, 6, "S04, S05, S06, S09, S10, S11");
}

/// A robot that keeps its posture for a moment weighs on what it stands on: the floor, or a platform, of ladders of any size.
#[test]
fn loads_are_the_robots_weight() {
    let taller = PropScale { ladder: [1.0, 1.0, 1.08], ..PropScale::default() };
    let cases =
        [(Task::S07, PropScale::default(), false), (Task::S03, PropScale::default(), true), (Task::S03, taller, true)];
    for (task, scale, on_platform) in cases {
        let mut episode = episode(&EpisodeSpec { scale, ..EpisodeSpec::new(task, 4, 0) });
        for load in [errand::FLOOR_LOAD, errand::TREAD_LOAD] {
            assert_eq!(episode.row().load(load), [0.0; LIMBS]);
        }
        let hold = episode.row().action.clone();
        let mut sums = [0.0; 2];
        for _ in 0..25 {
            let row = episode.step(&hold).unwrap().row;
            for (sum, loads) in sums.iter_mut().zip([row.load(errand::FLOOR_LOAD), row.load(errand::TREAD_LOAD)]) {
                *sum += loads.iter().sum::<f64>() / 25.0;
                assert_eq!([loads[Support::LeftArm as usize], loads[Support::RightArm as usize]], [0.0; 2]);
            }
        }
        let weight = episode.scene().robot.total_mass() * GRAVITY;
        let expected = if on_platform { [0.0, weight] } else { [weight, 0.0] };
        for (sum, expected) in sums.iter().zip(expected) {
            assert!((sum - expected).abs() < 0.15 * weight, "{task}: {sums:?} N of {weight} N");
        }
        let cx = episode.judges().of(Protocol::Strict).context();
        assert_eq!(strict::carried_by_treads(episode.row(), &cx), on_platform, "{task}");
        assert_eq!(strict::carried_by_floor(episode.row(), &cx), !on_platform, "{task}");
    }
}
