//! The policy `ladder` in training rooms.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/ladder/play.rs"]
mod play;

use fiatlux_client::Policy;
use fiatlux_policies::Ladder;
use fiatlux_proto::v3::{Observation, SessionInfo, TaskInfo};
use fiatlux_rules::{Cause, Causes, Task, errand};
use fiatlux_skills::phases::Skill;

/// Strict, below a ceiling (3) and at a wall (5): the ladder hangs on the head on its way, and stands at its end.
#[test]
fn it_carries_the_ladder_under_the_lamp() {
    let is_set = |name: &str| std::env::var_os(name).is_some();
    let rooms: &[u64] = match (is_set("FIATLUX_ALL_ROOMS"), is_set("FIATLUX_SLOW_TESTS")) {
        (true, _) => &[3, 5, 10, 25],
        (_, true) => &[3, 5],
        _ => &[3],
    };
    for &room in rooms {
        let mut highest = f64::INFINITY;
        let ended = play::play(Ladder::new("").unwrap(), room, &play::Changes::default(), |world, phase| {
            let feet = world.scene().geometry().ladder_feet(world.row());
            if phase == "Carry" && world.row().step.is_multiple_of(50) {
                highest = highest.min(feet.into_iter().fold(f64::NEG_INFINITY, f64::max));
            }
        });
        let play::Played { cause, seconds, phase, distance, tilt, feet, touched, .. } = ended.unwrap();
        assert_eq!(cause, Cause::Success, "room {room} after {seconds} s in {phase}");
        assert!(distance[0] > 1.5 && distance[1] < 0.67, "room {room}: {distance:?} m");
        assert!(
            tilt < 0.3 && feet < 0.02 && highest > 0.05,
            "room {room}: {tilt} rad, feet {feet} m and {highest} m up"
        );
        assert!(touched.0 < 20.0, "room {room}: {touched:?}");
    }
}

/// At a wall: it comes out sideways, leaves the ladder where it stands, and stands where S02 begins.
#[test]
fn it_comes_out_to_the_steps() {
    let mut game = play::start(
        5,
        &play::Changes { end_on: Some(Causes::of(&[Cause::Fall, Cause::Tip])), ..play::Changes::default() },
    )
    .unwrap();
    let (mut ladder, mut seen) = (Ladder::new("").unwrap(), game.observe().unwrap());
    ladder.reset(&game.info, &seen).unwrap();
    let mut put_down = None;
    while !ladder.is_over() {
        let phase = ladder.phase();
        assert!(game.verdict().end.is_none() && game.world().row().step < 6000, "{:?} in {phase}", game.verdict().end);
        if phase == "Done" {
            put_down = Some(game.world().row().things[errand::LADDER].pose);
        }
        seen = game.step(&mut ladder, &seen, None).unwrap();
    }
    let row = game.world().row();
    let (now, put_down) = (row.things[errand::LADDER].pose, put_down.unwrap());
    assert!((now.translation.vector - put_down.translation.vector).norm() < 0.005);
    let here = now.inverse() * row.robot.pose;
    assert!(here.translation.y < -0.8 && here.translation.x.abs() < 0.1, "{here}");
    assert!(play::distance(game.world()) < 0.67);
}

#[test]
fn other_tasks_are_refused() {
    let task = Some(TaskInfo { task: "S02".into(), ..TaskInfo::default() });
    let mut ladder = Ladder::new("").unwrap();
    let refused = ladder.reset(&SessionInfo { task, ..SessionInfo::default() }, &Observation::default()).unwrap_err();
    assert!(refused.to_string().contains("plays S01, but this is S02"), "{refused}");
    assert_eq!(ladder.tasks(), [Task::S01]);
    assert!(Ladder::new("missing.safetensors").is_err());
}
