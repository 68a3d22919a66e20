//! The errand in one piece: each skill takes over from the state that the one before left.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/errand/play.rs"]
mod play;

use fiatlux_rules::Task;

/// From the crate to the bench and back to the ladder, each once, without a start state in between.
#[test]
fn skills_take_over_from_each_other() {
    let played = play::play(Task::S06, 1003, |_, _| true).unwrap();
    let stages: Vec<Task> = played.stages.iter().map(|(task, _)| *task).collect();
    assert!(stages.starts_with(&[Task::S06, Task::S07, Task::S08, Task::S09]), "{stages:?}, {}", played.end);
}

/// With the old bulb in the crate, the errand ends where the robot is down again and the fresh bulb seated, by the strict rules of the
/// whole errand. In this room the hand once caught on the bench's edge, and the robot walked into the ladder on its way to the steps.
#[test]
fn the_errand_ends_on_the_floor() {
    let played = play::play(Task::S07, 1008, |_, _| true).unwrap();
    let stages: Vec<Task> = played.stages.iter().map(|(task, _)| *task).collect();
    assert_eq!(stages, [Task::S07, Task::S08, Task::S09, Task::S10, Task::S11, Task::S12]);
    assert_eq!(played.end, "success");
}

/// With the old bulb in its hand the robot stands up before it climbs down: it brought its arm in as it leaned, across rail and fixture.
#[test]
fn it_stands_up_with_the_bulb() {
    let mut height = 0.0;
    let played = play::play(Task::S03, 1015, |world, stage| {
        height = world.row().robot.pose.translation.z;
        !stage.starts_with("S04")
    });
    assert_eq!(played.unwrap().end, "left");
    assert!(height > fiatlux_room::ladder::PLATFORM_HEIGHT + 0.7, "{height} m");
}
