//! The errand in one piece: each skill takes over from the state that the one before left.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/errand/play.rs"]
mod play;

use fiatlux_rules::{Task, errand};
use fiatlux_world::{ShapeOwner, World};

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

/// The bulb comes to the ladder at its steps: from behind, the way around it led between wall and ladder.
#[test]
fn the_bulb_comes_to_the_steps() {
    let mut y = f64::NAN;
    let played = play::play(Task::S09, 8193, |world, stage| {
        y = by_the_ladder(world).y;
        !stage.starts_with("S10")
    });
    assert_eq!(played.unwrap().end, "left");
    assert!(y < 0.0, "{y} m");
}

/// Where a wall is too near to the steps, it comes to the other rail: between steps and wall it met the ladder.
#[test]
fn the_bulb_comes_to_where_it_has_room() {
    let mut y = f64::NAN;
    let played = play::play(Task::S09, 20145, |world, stage| {
        y = by_the_ladder(world).y;
        !stage.starts_with("S10")
    });
    assert_eq!(played.unwrap().end, "left");
    assert!(y > 0.0, "{y} m");
}

/// A thumb that meets the glass askew presses less: the hand opens and closes again before it lifts.
#[test]
fn a_loose_grip_is_tried_again() {
    let mut phases = Vec::new();
    let played = play::play(Task::S08, 8522, |_, stage| {
        if phases.last().is_none_or(|last| last != stage) {
            phases.push(stage.to_owned());
        }
        !stage.starts_with("S09")
    });
    assert_eq!(played.unwrap().end, "left");
    let times = |phase: &str| phases.iter().filter(|known| *known == phase).count();
    assert_eq!(["S08 Close", "S08 Open", "S08 Lift"].map(times), [2, 1, 1], "{phases:?}");
}

/// The arm that comes back from the socket with the bulb passes over the guard rail. In this room, where the robot placed the ladder itself,
/// its elbow hooked under it.
#[test]
fn the_elbow_stays_clear_of_the_guard_rail() {
    let mut touched = Vec::new();
    let played = play::play(Task::S01, 8604, |world, stage| {
        let scene = world.scene();
        let is_elbow =
            |owner| matches!(owner, ShapeOwner::Robot(link) if scene.robot.links()[link].name == "right_elbow_link");
        let owners = world
            .dynamics()
            .contacts()
            .iter()
            .map(|contact| [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape)));
        if stage.starts_with("S03 Leave") && owners.into_iter().flatten().any(is_elbow) {
            touched.push(stage.to_owned());
        }
        !stage.starts_with("S04")
    });
    assert_eq!(played.unwrap().end, "left");
    assert!(touched.is_empty(), "{touched:?}");
}

/// Place of the pelvis in the ladder's frame.
fn by_the_ladder(world: &World) -> nalgebra::Vector3<f64> {
    let row = world.row();
    (row.things[errand::LADDER].pose.inverse() * row.robot.pose).translation.vector
}
