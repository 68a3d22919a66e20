//! The policy `hands` in training rooms.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/hands/play.rs"]
mod play;

use fiatlux_client::Policy;
use fiatlux_policies::Hands;
use fiatlux_proto::v3::{Observation, SessionInfo, TaskInfo};
use fiatlux_rules::{Cause, Task};

/// It lifts the bulb, by a grip that strict accepts, and presses it with less than 25 N: 50 N break it.
#[test]
fn it_takes_the_bulb_from_the_bench_gently() {
    for seed in [1000, 1005] {
        let ended = play::play(Task::S08, seed, Hands::new().unwrap(), |_, _, _| ()).unwrap();
        let play::Played { cause, seconds, phase, peak } = ended;
        assert_eq!(cause, Cause::Success, "room {seed}, {phase}");
        assert!(peak < 25.0 && seconds < 30.0, "room {seed}: {peak} N, {seconds} s");
    }
}

#[test]
fn other_tasks_are_refused() {
    let task = Some(TaskInfo { task: "S03".into(), ..TaskInfo::default() });
    let mut hands = Hands::new().unwrap();
    let refused = hands.reset(&SessionInfo { task, ..SessionInfo::default() }, &Observation::default()).unwrap_err();
    assert!(refused.to_string().contains("plays S08, but this is S03"), "{refused}");
    assert_eq!(hands.tasks(), [Task::S08]);
}
