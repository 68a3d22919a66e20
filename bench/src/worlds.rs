//! Many worlds in one process: the memory of each, and whether they slow each other down.

use std::sync::Barrier;
use std::thread;
use std::time::Instant;

use fiatlux_world::{ControlInput, SUBSTEPS, World};
use stats_alloc::INSTRUMENTED_SYSTEM;

use super::case::standing_world;
use super::{BenchError, WorldsReport};

const WORLDS: usize = 256;
const THREADS: usize = 2;
/// Control steps of each world in one measurement; the worlds take turns after each control step, as in a batch.
const CONTROL_STEPS: usize = 50;
/// Measurements of each kind, which alternate; the best of each counts.
const ROUNDS: usize = 5;

/// Measures copies of one world in which the robot stands.
pub(crate) fn run() -> Result<WorldsReport, BenchError> {
    let (world, targets) = standing_world()?;

    let before = heap();
    let copy = (**world.scene()).clone();
    let shared = heap().saturating_sub(before);
    drop(copy);

    let before = heap();
    let rows = vec![world.row().clone(); WORLDS];
    let each = heap().saturating_sub(before) / WORLDS;
    drop(rows);

    let (mut rate_many, mut rate_single) = (0.0_f64, 0.0_f64);
    for round in 1..=ROUNDS {
        fiatlux_cli::report(format!("bench: {WORLDS} worlds on {THREADS} threads, round {round} of {ROUNDS}"));
        rate_single = rate_single.max(rate(&world, &|stage: &mut World| one_after_another(stage, &world, &targets)));
        rate_many = rate_many.max(rate(&world, &|stage: &mut World| in_turns(stage, &world, &targets)));
    }
    Ok(WorldsReport {
        worlds: WORLDS,
        threads: THREADS,
        bytes_per_world: (each > 0).then_some(each),
        bytes_shared: (shared > 0).then_some(shared),
        steps_per_s: rate_many.round(),
        steps_per_s_single: rate_single.round(),
        ratio: (rate_many / rate_single * 1e3).round() / 1e3,
    })
}

/// Physics steps per second of all threads together; each plays its share of the worlds on one `World`.
fn rate(world: &World, play: &(impl Fn(&mut World) + Sync)) -> f64 {
    let barrier = Barrier::new(THREADS);
    let slowest = thread::scope(|scope| {
        let start = || {
            let (mut stage, barrier) = (world.clone(), &barrier);
            scope.spawn(move || {
                barrier.wait();
                let start = Instant::now();
                play(&mut stage);
                start.elapsed().as_secs_f64()
            })
        };
        let threads: Vec<_> = (0..THREADS).map(|_| start()).collect();
        threads.into_iter().map(|thread| thread.join().expect("a thread that steps")).fold(0.0, f64::max)
    });
    (WORLDS * CONTROL_STEPS * SUBSTEPS) as f64 / slowest
}

/// Plays a thread's share of the worlds at once: rows take turns after each control step.
fn in_turns(stage: &mut World, start: &World, targets: &[f64]) {
    let action = vec![0.0; targets.len()];
    let mut rows = vec![start.row().clone(); WORLDS / THREADS];
    for _ in 0..CONTROL_STEPS {
        for row in &mut rows {
            stage.step_row(row, &ControlInput::new(&action, targets)).expect("a row of this scene");
        }
    }
}

/// Plays the same worlds for as many steps, each to its end before the next.
fn one_after_another(stage: &mut World, start: &World, targets: &[f64]) {
    let action = vec![0.0; targets.len()];
    for _ in 0..WORLDS / THREADS {
        stage.reset_to(start.row()).expect("a row of this scene");
        for _ in 0..CONTROL_STEPS {
            stage.step(&action, targets).expect("the targets are finite");
        }
    }
}

/// Bytes on the heap now; 0 if the process has not installed the counting allocator.
pub(super) fn heap() -> usize {
    let stats = INSTRUMENTED_SYSTEM.stats();
    stats.bytes_allocated.saturating_sub(stats.bytes_deallocated)
}
