//! The commands that policies record for legs and waist are those in force.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/game/mod.rs"]
mod game;

use std::sync::Arc;

use fiatlux_client::Command;
use fiatlux_policies::{Policies, WholeBody};
use fiatlux_proto::v3::{Chunk, Observation, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_wbc::{BodyCommand, MOVED, Network};
use game::{Game, Start};

/// Largest difference of a target that comes from the record's f32, rad.
const ROUNDED: f64 = 1e-4;

/// The whole-body controller in the form in which the policies that move hands use it.
fn controller(policy: &str, task: Task, info: &SessionInfo, first: &Observation) -> WholeBody {
    let body = WholeBody::own("test", Arc::new(Network::shipped().unwrap()), info, first).unwrap();
    match (policy, task) {
        (_, Task::S03 | Task::S11) => body.without_steps(),
        ("hands" | "expert", Task::S06 | Task::S08) => body.bending_low(),
        _ => body,
    }
}

fn command(chunk: &Chunk) -> BodyCommand {
    assert_eq!(chunk.keys, BodyCommand::CHUNK_KEYS);
    let numbers: Vec<f64> = chunk.values.iter().map(|number| f64::from(*number)).collect();
    <[f64; 7]>::try_from(numbers).unwrap().into()
}

/// For each control step, whether a command was recorded. Those that were give the targets of legs and waist that the policy answered
/// with.
fn recorded(policy: &str, task: Task, room: u64, steps: usize) -> Vec<bool> {
    let mut game = Game::start(Start::of(task, room).unwrap()).unwrap();
    let mut policy_of = Policies::default().make(policy).unwrap();
    let mut seen = game.observe().unwrap();
    policy_of.reset(&game.info, &seen).unwrap();
    let mut body = controller(policy, task, &game.info, &seen);
    let mut all = Vec::new();
    for step in 0..steps {
        let answer = policy_of.act(&seen).unwrap();
        let Command::JointTarget(targets) = &answer else { panic!("no targets") };
        let source = policy_of.source();
        if policy == "expert" {
            let source = source.as_ref().expect("it says what it does");
            assert!(!source.phase.is_empty() && source.is_over.is_some(), "{task:?}, step {step}: {source:?}");
        }
        let chunk = source.filter(|chunk| chunk.width > 0);
        if let Some(chunk) = &chunk {
            assert_eq!(chunk.index, step as u64, "{policy}, {task:?}: one for each control step from the start on");
            body.targets[MOVED..].copy_from_slice(&targets[MOVED..]);
            let Command::JointTarget(again) = body.step(&seen, &command(chunk)).unwrap() else { panic!("no targets") };
            let off = again.iter().zip(targets).take(MOVED).map(|(again, target)| (again - target).abs());
            let off = off.fold(0.0, f64::max);
            assert!(off < ROUNDED, "{policy}, {task:?}, step {step}: {off} rad");
        }
        all.push(chunk.is_some());
        seen = game.go_on(&answer, None).unwrap();
    }
    all
}

#[test]
fn a_recorded_command_gives_the_recorded_targets() {
    for (policy, task, steps) in [
        ("wbc:vx=0.25,wz=-0.5", Task::S05, 50),
        ("walk", Task::S05, 150),
        ("walk", Task::S09, 150),
        ("hands", Task::S03, 150),
        ("hands", Task::S06, 150),
        ("hands", Task::S08, 250),
        ("hands", Task::S11, 150),
        ("ladder", Task::S01, 300),
        ("expert", Task::S07, 100),
        ("expert", Task::S08, 100),
    ] {
        let recorded = recorded(policy, task, 1000, steps);
        assert!(recorded.iter().all(|is| *is), "{policy}, {task:?}");
    }
}

/// While a plan is played, no command is in force, and none is recorded.
#[test]
fn a_climb_records_commands_while_it_walks() {
    for (policy, task) in [("climb", Task::S02), ("expert", Task::S10)] {
        let all = recorded(policy, task, 1000, 1200);
        let walked = all.iter().take_while(|is| **is).count();
        assert!((100..1100).contains(&walked), "{policy}, {task:?}: {walked} steps");
        assert!(all[walked..].iter().all(|is| !is), "{policy}, {task:?}");
    }
    for policy in ["climb", "expert"] {
        assert!(recorded(policy, Task::S12, 1000, 100).iter().all(|is| !is), "{policy} does not walk down");
    }
}

/// Policies that command joints record no command.
#[test]
fn policies_without_the_controller_record_none() {
    for policy in ["zero", "hold", "random", "stand"] {
        let mut game = Game::start(Start::of(Task::S07, 1000).unwrap()).unwrap();
        let seen = game.observe().unwrap();
        let mut policy_of = Policies::default().make(policy).unwrap();
        policy_of.reset(&game.info, &seen).unwrap();
        policy_of.act(&seen).unwrap();
        assert_eq!(policy_of.source(), None, "{policy}");
    }
}
