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
    let barrier = Barrier::new(THREADS + 1);
    let start = thread::scope(|scope| {
        for mine in rows.chunks_mut(share) {
            let mut stage = world.clone();
            let barrier = &barrier;
            scope.spawn(move || {
                barrier.wait();
                for _ in 0..control_steps {
                    if let [_] = mine {
                        stage.step(&[0.0; JOINTS], targets).expect("the targets are finite");
                        continue;
                    }
                    for row in mine.iter_mut() {
                        stage.step_row(row, &[0.0; JOINTS], targets).expect("the targets are finite");
                    }
                }
            });
        }
        barrier.wait();
        Instant::now()
    });
    steps as f64 / start.elapsed().as_secs_f64()
}

/// Bytes on the heap now; 0 where the process has not installed the counting allocator.
fn heap() -> usize {
    let stats = INSTRUMENTED_SYSTEM.stats();
    stats.bytes_allocated.saturating_sub(stats.bytes_deallocated)
}
