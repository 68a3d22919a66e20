//! Many worlds in one process: the memory that each takes, and whether they get in each other's way.

use std::sync::Barrier;
use std::thread;
use std::time::Instant;

use fiatlux_rules::{JOINTS, Row};
use fiatlux_world::{SUBSTEPS, World};
use stats_alloc::INSTRUMENTED_SYSTEM;

use super::case::standing_world;
use super::{BenchError, WorldsReport};

const WORLDS: usize = 256;
const THREADS: usize = 2;
/// Control steps that each of the many worlds does in one measurement; they take turns by control steps, as in a batch.
const CONTROL_STEPS: usize = 50;
/// Measurements of each kind, taken in turns; the best of each counts.
const ROUNDS: usize = 5;

/// Measures copies of one world, in which the robot stands.
pub(crate) fn run() -> Result<WorldsReport, BenchError> {
    let (world, targets) = standing_world()?;

    let before = heap();
    let copy = (**world.scene()).clone();
    let shared = heap().saturating_sub(before);
    drop(copy);

    let before = heap();
    let mut many = vec![world.row().clone(); WORLDS];
    let each = heap().saturating_sub(before) / WORLDS;
    let mut few = vec![world.row().clone(); THREADS];

    let (mut rate_many, mut rate_single) = (0.0_f64, 0.0_f64);
    for round in 1..=ROUNDS {
        eprintln!("bench: {WORLDS} worlds on {THREADS} threads, round {round} of {ROUNDS}");
        rate_single = rate_single.max(rate(&world, &mut few, &targets, CONTROL_STEPS * WORLDS / THREADS));
        rate_many = rate_many.max(rate(&world, &mut many, &targets, CONTROL_STEPS));
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

/// Physics steps per second of all rows together, shared out evenly among the threads. Each thread plays its rows in turns
/// on one `World`; a single row is played without the detour.
fn rate(world: &World, rows: &mut [Row], targets: &[f64; JOINTS], control_steps: usize) -> f64 {
    let steps = rows.len() * control_steps * SUBSTEPS;
    let share = rows.len().div_ceil(THREADS);
    let barrier = Barrier::new(rows.len().div_ceil(share));
    let slowest = thread::scope(|scope| {
        let mut threads = Vec::new();
        for mine in rows.chunks_mut(share) {
            let (mut stage, barrier) = (world.clone(), &barrier);
            threads.push(scope.spawn(move || {
                barrier.wait();
                let start = Instant::now();
                for _ in 0..control_steps {
                    play_once(&mut stage, mine, targets);
                }
                start.elapsed().as_secs_f64()
            }));
        }
        threads.into_iter().map(|thread| thread.join().expect("a thread that steps")).fold(0.0, f64::max)
    });
    steps as f64 / slowest
}

/// One control step of each row.
fn play_once(stage: &mut World, rows: &mut [Row], targets: &[f64; JOINTS]) {
    let action = [0.0; JOINTS];
    if let [_] = rows {
        stage.step(&action, targets).expect("the targets are finite");
        return;
    }
    for row in rows {
        stage.step_row(row, &action, targets).expect("the targets are finite");
    }
}

/// Bytes on the heap now; 0 where the process has not installed the counting allocator.
fn heap() -> usize {
    let stats = INSTRUMENTED_SYSTEM.stats();
    stats.bytes_allocated.saturating_sub(stats.bytes_deallocated)
}
