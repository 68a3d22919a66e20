//! The policy `climb` in training rooms.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/climb/play.rs"]
mod play;

use fiatlux_client::Policy;
use fiatlux_policies::Climb;
use fiatlux_proto::v3::{Observation, SessionInfo, TaskInfo};
use fiatlux_rules::{Bulb, Cause, Task};
use play::Changes;

/// Strict, with both feet on treads from 0.47 m on; the ladder stays where it is.
#[test]
fn it_climbs_the_ladder() {
    let tasks: &[Task] =
        if std::env::var_os("FIATLUX_SLOW_TESTS").is_some() { &[Task::S02, Task::Climb] } else { &[Task::S02] };
    for &task in tasks {
        let mut highest = 0.0_f64;
        let ended = play::play(Climb::new().unwrap(), task, 1000, &Changes::default(), |moment| {
            highest = highest.max(play::ladder_from_pelvis(moment.row).translation.z);
        });
        let play::Played { cause, seconds, progress, height, ladder, effort, .. } = ended.unwrap();
        assert_eq!(cause, Cause::Success, "{task:?} after {seconds} s, {progress:?}");
        assert!(height > if task == Task::Climb { 1.82 } else { 1.03 } && height <= highest + 1e-9, "{height} m");
        assert!(ladder.0 < 1e-3 && ladder.1 < 1e-3 && effort < 1.0, "{ladder:?} {effort}");
    }
}

/// The privileged observation tells how high the ladder is; by the plan for the published one, the robot falls.
#[test]
fn it_climbs_a_higher_ladder() {
    let mut changes = Changes::default();
    changes.scale.ladder[2] = 1.05;
    let play::Played { cause, seconds, progress, height, .. } =
        play::play(Climb::new().unwrap(), Task::S02, 1000, &changes, |_| ()).unwrap();
    assert_eq!(cause, Cause::Success, "after {seconds} s, {progress:?}");
    assert!(height > 1.22, "{height} m");
}

/// From arms that hang beside the body, as `ladder` leaves them: a finger met the ladder in this room as the pelvis turned, and the
/// robot fell.
#[test]
fn it_climbs_from_hanging_arms() {
    let changes = Changes { arms: Some([0.12, 1.2]), ..Changes::default() };
    let play::Played { cause, seconds, progress, ladder, .. } =
        play::play(Climb::new().unwrap(), Task::S02, 1009, &changes, |_| ()).unwrap();
    assert_eq!(cause, Cause::Success, "after {seconds} s, {progress:?}");
    assert!(ladder.0 < 1e-3 && ladder.1 < 1e-3, "{ladder:?}");
}

/// A wall stands 0.38 m behind the robot as it begins: a hand that was held ahead met it as the robot turned round, and the robot fell.
#[test]
fn it_turns_round_before_a_wall() {
    let play::Played { cause, seconds, progress, loads, .. } =
        play::play(Climb::new().unwrap(), Task::S02, 20036, &Changes::default(), |_| ()).unwrap();
    assert_eq!(cause, Cause::Success, "after {seconds} s, {progress:?}");
    assert!(loads.first_touch.as_ref().is_none_or(|(_, names)| !names.contains("wall")), "{:?}", loads.first_touch);
}

/// Between steps and wall nobody has room to climb: it pushes the ladder away, from beside it and from before it.
#[test]
fn it_pushes_the_ladder_away_from_a_wall() {
    for (task, room) in [(Task::S02, 20226), (Task::S10, 20376)] {
        let ended = play::play(Climb::new().unwrap(), task, room, &Changes::default(), |_| ());
        let play::Played { cause, seconds, progress, ladder, .. } = ended.unwrap();
        assert_eq!(cause, Cause::Success, "{task:?} after {seconds} s, {progress:?}");
        assert!(ladder.0 > 0.2, "{ladder:?}");
    }
}

/// A wall behind the steps, nearer at the left; and a corner at the right of the platform, with a bulb in the right hand.
#[test]
fn it_climbs_down_beside_a_wall() {
    for (task, room) in [(Task::S12, 20019), (Task::S04, 20296)] {
        let ended = play::play(Climb::new().unwrap(), task, room, &Changes::default(), |_| ());
        let play::Played { cause, seconds, progress, .. } = ended.unwrap();
        assert_eq!(cause, Cause::Success, "{task:?} after {seconds} s, {progress:?}");
    }
}

/// Strict, up and down: the bulb is in the grip of the hand at the end, and was never let go.
#[test]
fn it_climbs_with_a_bulb() {
    for (task, bulb) in [(Task::S10, Bulb::Fresh), (Task::S04, Bulb::Old)] {
        let mut most = 0.0_f64;
        let ended = play::play(Climb::new().unwrap(), task, 1000, &Changes::default(), |moment| {
            let hands = moment.row.hands(bulb).concat();
            most = hands.iter().map(|force| force.norm()).fold(most, f64::max);
        });
        let play::Played { cause, seconds, progress, height, ladder, loads, .. } = ended.unwrap();
        assert_eq!(cause, Cause::Success, "{task:?} after {seconds} s, {progress:?}");
        assert_eq!(loads.loose, (0, 0), "{task:?}: something else touches the bulb, or it slips");
        assert!((height > 1.03) == (task == Task::S10) && ladder.0 < 1e-3 && ladder.1 < 1e-3, "{height} m, {ladder:?}");
        assert!((1.0..35.0).contains(&most), "{task:?}: {most} N");
    }
}

/// Strict, from the platform to both feet on the floor.
#[test]
fn it_climbs_down() {
    let ended = play::play(Climb::new().unwrap(), Task::S12, 1000, &Changes::default(), |_| ()).unwrap();
    let play::Played { cause, seconds, progress, height, ladder, effort, .. } = ended;
    assert_eq!(cause, Cause::Success, "after {seconds} s, {progress:?}");
    assert!(height < 0.85 && ladder.0 < 1e-3 && ladder.1 < 1e-3 && effort < 1.0, "{height} {ladder:?} {effort}");
}

/// The trained network gets through S02 in a training room.
#[test]
fn the_network_follows_the_plan() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../climb/weights/climb.safetensors");
    let climb = Climb::with_network(file).unwrap();
    assert!(climb.name().starts_with("climb:climb.safetensors@"), "{}", climb.name());
    let play::Played { cause, seconds, progress, height, ladder, .. } =
        play::play(climb, Task::S02, 1000, &Changes::default(), |_| {}).unwrap();
    assert_eq!(cause, Cause::Success, "after {seconds} s, {progress:?}");
    assert!(height > 1.03 && ladder.0 < 1e-3 && ladder.1 < 1e-3, "{height} m, {ladder:?}");
    let task = Some(TaskInfo { task: "S12".into(), ..TaskInfo::default() });
    let refused = Climb::with_network(file)
        .unwrap()
        .reset(&SessionInfo { task, ..SessionInfo::default() }, &Observation::default());
    assert!(refused.unwrap_err().to_string().contains("with free hands alone"));
    assert!(Climb::with_network("missing.safetensors").is_err());
}

#[test]
fn other_tasks_are_refused() {
    let task = Some(TaskInfo { task: "S05".into(), ..TaskInfo::default() });
    let mut climb = Climb::new().unwrap();
    let refused = climb.reset(&SessionInfo { task, ..SessionInfo::default() }, &Observation::default()).unwrap_err();
    assert!(refused.to_string().contains("plays S02, S04, S10, S12 and climb, but this is S05"), "{refused}");
    assert_eq!(climb.tasks(), [Task::S02, Task::S04, Task::S10, Task::S12, Task::Climb]);
}
