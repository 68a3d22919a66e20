//! Looks for stunts: open-loop motions that pass a task's gate without doing the task.
//!
//! ```text
//! cargo run --release -p fiatlux-world --example stunts -- search S02 --out s02.toml
//! cargo run --release -p fiatlux-world --example stunts -- replay s02.toml
//! ```
//!
//! `docs/stunts.md` says what was found.
#![expect(clippy::disallowed_methods, reason = "it measures time")]

mod search;
mod trace;

use std::collections::BTreeSet;
use std::error::Error;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use fiatlux_rules::{CONTROL_DT, Cause, Protocol, SeedOwner, Task, errand, measure};
use fiatlux_world::{Episode, ShapeOwner};

use self::search::Search;
use self::trace::{Runs, Stage, TAIL_STEPS, Trace, is_clean_success};

/// Looks for open-loop motions that pass a gate without doing the task, and plays them again.
#[derive(Debug, Parser)]
enum Args {
    /// Searches; a progress line goes to stderr for each better trace.
    Search {
        /// Task whose gate to pass.
        task: Task,
        /// Whose gate to pass.
        #[arg(long, default_value = "published")]
        protocol: Protocol,
        /// Seed of the search; another one finds another trace.
        #[arg(long, default_value_t = 0)]
        seed: u64,
        /// Room; 1000 and above are for searches.
        #[arg(long, default_value_t = 1000)]
        room: u64,
        /// Index of the episode.
        #[arg(long, default_value_t = 0)]
        episode: u64,
        /// Most tries before the search ends.
        #[arg(long, default_value_t = 20_000)]
        tries: u64,
        /// Threads; the result does not depend on them.
        #[arg(long, default_value_t = 1)]
        threads: usize,
        /// Stops at the first trace that passes, robust or not.
        #[arg(long)]
        first: bool,
        /// Where to write the best trace.
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Plays traces and says what both judges make of them.
    Replay {
        /// Files of traces to play.
        #[arg(required = true)]
        traces: Vec<PathBuf>,
        /// Prints what the robot does, ten rows a second.
        #[arg(long)]
        rows: bool,
    },
}

fn main() -> Result<(), Box<dyn Error>> {
    match Args::parse() {
        Args::Search { task, protocol, seed, room, episode, tries, threads, first, out } => {
            let stage = Stage::new(task, SeedOwner::check_training(room)?, episode)?;
            let search = Search { protocol, seed, tries, threads, first };
            let begin = Instant::now();
            let mut first_seconds = None;
            let outcome = search.run(&stage, |found| {
                let seconds = begin.elapsed().as_secs_f64();
                if found.passes {
                    first_seconds.get_or_insert(seconds);
                }
                eprintln!("try {} {seconds:.0} s: score {:.3} robust {:?}", found.number, found.score, found.robust);
            })?;
            let seconds = begin.elapsed().as_secs_f64();
            let first = outcome.first.map_or("none passed".into(), |number| {
                format!("first pass at try {} after {:.0} s", number + 1, first_seconds.unwrap_or(seconds))
            });
            println!(
                "{task} {protocol} room {room} seed {seed}: {first}; best is try {}, robust {:?}, of {} in {seconds:.0} s; \
                 most progress {:.2}",
                outcome.best.number + 1,
                outcome.best.robust,
                outcome.tries,
                outcome.progress
            );
            replay(&outcome.best.trace, false)?;
            if let Some(path) = out {
                std::fs::write(path, outcome.best.trace.to_toml())?;
            }
            Ok(())
        }
        Args::Replay { traces, rows } => {
            for path in traces {
                replay(&Trace::read(&path)?, rows)?;
            }
            Ok(())
        }
    }
}

/// Plays a trace and prints both verdicts.
fn replay(trace: &Trace, rows: bool) -> Result<(), Box<dyn Error>> {
    let stage = Stage::of(trace)?;
    let task = stage.task();
    let mut runs = Runs::new(task, Protocol::Strict);
    let episode = stage.play(trace, TAIL_STEPS, |episode| {
        runs.follow(episode);
        if rows && episode.row().step % 5 == 0 {
            print_row(episode);
        }
        ControlFlow::Continue(())
    })?;
    println!("{task} room {} episode {}", trace.room, trace.episode);
    for protocol in Protocol::ALL {
        let judge = episode.judges().of(protocol);
        let verdict = judge.verdict();
        let result = match (verdict.success, is_clean_success(judge)) {
            (_, true) => "clean success",
            (true, false) => "success, but a bulb suffered",
            (false, false) => "no success",
        };
        let met = Cause::ALL.into_iter().filter_map(|cause| judge.first_met(cause).map(|row| format!("{cause} {row}")));
        println!(
            "  {protocol}: {result} up to row {}, progress {:.2}; broken {}, dropped {}, leapt {}, conditions first met in rows: {}",
            verdict.step,
            verdict.progress,
            verdict.broken,
            verdict.dropped,
            verdict.leapt,
            met.collect::<Vec<_>>().join(", ")
        );
    }
    let window = task.spec().gate.window(Protocol::Strict);
    let short = runs.too_short(task).into_iter().map(|(name, rows)| format!("{name} {rows}"));
    let scene = episode.scene();
    let things = episode.world().dynamics().contacts().iter().flat_map(|contact| {
        let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| scene.owner(shape));
        [(a, b), (b, a)]
    });
    let on = things.filter(|(a, b)| matches!(a, ShapeOwner::Robot(_)) && !matches!(b, ShapeOwner::Robot(_)));
    let on: BTreeSet<String> = on.map(|(_, thing)| format!("{thing:?}")).collect();
    println!("  at the end the robot touches: {}", on.into_iter().collect::<Vec<_>>().join(", "));
    println!("  strict, held for fewer than {window} rows: {}", short.collect::<Vec<_>>().join(", "));
    Ok(())
}

fn print_row(episode: &Episode) {
    let row = episode.row();
    let pelvis = row.robot.pose.translation.vector;
    println!(
        "  {:5.2} s  pelvis {:.2} {:.2} {:.2}  tilt {:.2}  {:.2} m/s  N on soles and arms: floor {:.0?}, treads {:.0?}  all but {}",
        row.step as f64 * CONTROL_DT,
        pelvis.x,
        pelvis.y,
        pelvis.z,
        measure::tilt(&row.robot.pose),
        row.robot.linear_velocity.norm(),
        row.load(errand::FLOOR_LOAD),
        row.load(errand::TREAD_LOAD),
        missed(episode).join(" ")
    );
}

/// Criteria of the strict gate that the last row misses.
fn missed(episode: &Episode) -> Vec<&'static str> {
    let judge = episode.judges().of(Protocol::Strict);
    let criteria = judge.task().spec().gate.criteria_of(Protocol::Strict);
    let held = judge.verdict().criteria;
    criteria.zip(held.as_slice()).filter(|(_, held)| !**held).map(|(criterion, _)| criterion.name).collect()
}
