//! Plays a policy in rooms, the last included, and prints how long its answers take, in ms of processor time of its thread:
//! `cargo run -p fiatlux-policies --example answers -- expert S01,S03,S11 1000..1003`. A task `all` stands for each of them. The
//! first answer is counted with the reset before it. With `--strict` it fails where the 99.9th percentile of a task is above a control
//! step: such a policy does not keep up in real time. The times are read from Linux's `/proc`, and are good to a tenth of a
//! millisecond.
#![allow(missing_docs)]

use std::error::Error;

use fiatlux_policies::Policies;
use fiatlux_rules::{SeedOwner, Task};

#[path = "../game/mod.rs"]
mod game;

use game::{Game, Start};

/// Longest answer with which a policy keeps up with the control steps in real time, ms.
const CONTROL_STEP_MS: f64 = 20.0;
/// Control steps after which an episode is left.
const MAX_STEPS: u64 = 50_000;

fn main() -> Result<(), Box<dyn Error>> {
    let (strict, arguments): (Vec<String>, _) = std::env::args().skip(1).partition(|argument| argument == "--strict");
    let arguments: Vec<String> = arguments;
    let [policy, tasks, rooms] = arguments.as_slice() else {
        return Err("POLICY TASK,TASK FIRST..LAST [--strict]".into());
    };
    let tasks: Vec<Task> = match tasks.as_str() {
        "all" => Task::ALL.into(),
        named => named.split(',').map(str::parse).collect::<Result<_, _>>()?,
    };
    let rooms = SeedOwner::training_rooms(rooms)?;
    println!("task     episodes  answers  median   99 %  99.9 %    most  above {CONTROL_STEP_MS} ms");
    let mut slow = Vec::new();
    for task in tasks {
        let mut times = Vec::new();
        for room in rooms.clone() {
            play(policy, task, room, &mut times)?;
        }
        times.sort_by(f64::total_cmp);
        let at = |share: f64| times[((times.len() as f64 * share) as usize).min(times.len() - 1)];
        let above = times.iter().filter(|time| **time > CONTROL_STEP_MS).count();
        println!(
            "{task:8} {:8} {:8} {:7.2} {:6.2} {:7.2} {:7.2}  {above}",
            rooms.clone().count(),
            times.len(),
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0),
        );
        if at(0.999) > CONTROL_STEP_MS {
            slow.push(task.to_string());
        }
    }
    match slow.is_empty() || strict.is_empty() {
        true => Ok(()),
        false => Err(format!("answers are too slow for real time in {}", slow.join(", ")).into()),
    }
}

/// Plays an episode to its end, and notes the time of each answer, ms.
fn play(policy: &str, task: Task, room: u64, times: &mut Vec<f64>) -> Result<(), Box<dyn Error>> {
    let mut policy = Policies::default().make(policy)?;
    let mut game = Game::start(Start::of(task, room)?)?;
    let mut seen = game.observe()?;
    let mut began = processor_time()?;
    policy.reset(&game.info, &seen)?;
    for _ in 0..MAX_STEPS {
        if game.verdict().end.is_some() {
            break;
        }
        let command = policy.act(&seen)?;
        times.push((processor_time()? - began) * 1e3);
        seen = game.go_on(&command, None)?;
        began = processor_time()?;
    }
    Ok(())
}

/// Processor time of this thread so far, s.
fn processor_time() -> Result<f64, Box<dyn Error>> {
    // The kernel brings its count up to date where it looks for another thread to run.
    std::thread::yield_now();
    let counted = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: u64 = counted.split(' ').next().ok_or("an empty schedstat")?.parse()?;
    Ok(nanoseconds as f64 * 1e-9)
}
