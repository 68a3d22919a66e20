//! `bench batch`: many worlds in step, compared with a single world and with separate processes, and the cost of
//! sensing.

mod cases;
mod processes;

use std::fmt;
use std::time::Duration;

use fiatlux_world::{Random, Stream, World};
use serde::Serialize;

use super::BenchError;
use super::case::standing_world;
use super::machine::machine;
use super::stats::median;
use super::worlds::heap;
pub use cases::BatchOptions;
use cases::{Running, failed, rate, standing_batch, walking_batch};
use processes::Processes;
pub use processes::serve_share;

/// Rounds of the cases other than threads and processes.
const ROUNDS: usize = 5;

/// Result of `bench batch`. Rates are control steps of 20 ms per second, over all worlds, each the median of its rounds.
#[derive(Debug, Clone, Serialize)]
pub struct BatchReport {
    pub machine: String,
    pub worlds: usize,
    /// Threads of the cases with several.
    pub threads: usize,
    /// One world in a loop of `World::step`, whole room, robot standing.
    pub single_steps_per_s: f64,
    /// A batch of such worlds on one thread.
    pub batch_steps_per_s: f64,
    /// Gain or loss of a batch: `batch_steps_per_s / single_steps_per_s`.
    pub batch_ratio: f64,
    /// A batch on `threads` threads.
    pub threads_steps_per_s: f64,
    /// The same number of processes at the same time, each with its share of the worlds on one thread. They do not wait for each
    /// other, while threads wait for the slowest at every step: the sum of what each does in its own time.
    pub processes_steps_per_s: f64,
    /// The same processes if the next step begins when all have done the last, as it must where one policy acts for all worlds.
    pub lockstep_steps_per_s: f64,
    /// Threads compared with processes that do not wait: the median of the ratios within a round, and its 95 % interval.
    pub threads_ratio: f64,
    pub threads_ratio_interval: [f64; 2],
    /// The same for processes in step.
    pub lockstep_ratio: f64,
    pub lockstep_ratio_interval: [f64; 2],
    /// Gain from threads: `threads_steps_per_s / batch_steps_per_s`.
    pub speed_up: f64,
    /// A batch on one thread with the proprioception of all joints, noise included.
    pub proprioception_steps_per_s: f64,
    /// Share of a step that proprioception takes, 0 to 1.
    pub proprioception_share: f64,
    /// Walking on a floor, with its observation and rewards, one thread.
    pub walking_steps_per_s: f64,
    /// The same walking task on `threads` threads.
    pub walking_threads_steps_per_s: f64,
    /// Heap bytes of one more world; `None` if the allocator does not count.
    pub bytes_per_world: Option<usize>,
}

pub fn run(options: &BatchOptions) -> Result<BatchReport, BenchError> {
    let BatchOptions { worlds, threads, rounds, seconds } = *options;
    let (mut world, targets) = standing_world()?;
    let start = world.row().clone();
    let budget = Duration::from_secs_f64(seconds);
    let bytes_per_world = bytes(&world, &targets, worlds)?;

    let mut threaded = Running::new(standing_batch(&world, &targets, worlds, threads, false)?);
    let mut separate = Processes::start(options)?;
    fiatlux_cli::report(format!("bench: {worlds} worlds, {rounds} rounds of {threads} threads and processes"));
    let [several, processes, lockstep] = alternate(rounds, |case| match case {
        0 => threaded.rate(budget),
        1 => separate.rate(),
        _ => separate.lockstep_rate(budget),
    })?;
    drop(separate);
    let ratios = |others: &[f64]| median(&mut several.iter().zip(others).map(|(a, b)| a / b).collect::<Vec<_>>());
    let (threads_ratio, threads_ratio_interval) = ratios(&processes);
    let (lockstep_ratio, lockstep_ratio_interval) = ratios(&lockstep);

    let mut standing = Running::new(standing_batch(&world, &targets, worlds, 1, false)?);
    let mut sensing = Running::new(standing_batch(&world, &targets, worlds, 1, true)?);
    let mut walking = [Running::new(walking_batch(worlds, 1)?), Running::new(walking_batch(worlds, threads)?)];
    let action = vec![0.0; targets.len()];
    fiatlux_cli::report(format!("bench: {ROUNDS} rounds of the other cases"));
    let others: [_; 5] = alternate(ROUNDS, |case| match case {
        0 => rate(
            budget,
            1,
            &mut world,
            |world| world.reset_to(&start).map(|_| ()).map_err(failed),
            |world| world.step(&action, &targets).map(|_| ()).map_err(failed),
        ),
        1 => standing.rate(budget),
        2 => sensing.rate(budget),
        3 => walking[0].rate(budget),
        _ => walking[1].rate(budget),
    })?;
    let middle = |mut rates: Vec<f64>| median(&mut rates).0.round();
    let [single, batch, proprioception, walking, walking_threads] = others.map(middle);
    let [several, processes, lockstep] = [several, processes, lockstep].map(middle);
    Ok(BatchReport {
        machine: machine(),
        worlds,
        threads,
        single_steps_per_s: single,
        batch_steps_per_s: batch,
        batch_ratio: batch / single,
        threads_steps_per_s: several,
        processes_steps_per_s: processes,
        lockstep_steps_per_s: lockstep,
        threads_ratio,
        threads_ratio_interval,
        lockstep_ratio,
        lockstep_ratio_interval,
        speed_up: several / batch,
        proprioception_steps_per_s: proprioception,
        proprioception_share: 1.0 - proprioception / batch,
        walking_steps_per_s: walking,
        walking_threads_steps_per_s: walking_threads,
        bytes_per_world,
    })
}

/// The rates of each case, which `measure` measures once a round. A round has an order of its own, drawn at random, so that no case
/// always follows the same one and a machine that becomes faster or slower favours none.
fn alternate<const CASES: usize>(
    rounds: usize,
    mut measure: impl FnMut(usize) -> Result<f64, BenchError>,
) -> Result<[Vec<f64>; CASES], BenchError> {
    let mut rates = [const { Vec::new() }; CASES];
    for round in 0..rounds {
        let mut random = Random::new(Stream::Batch, 0, round as u64);
        let mut order: [usize; CASES] = std::array::from_fn(|case| case);
        for last in (1..CASES).rev() {
            order.swap(last, random.index(last + 1));
        }
        for case in order {
            rates[case].push(measure(case)?);
        }
    }
    Ok(rates)
}

/// Heap bytes of one more world.
fn bytes(world: &World, targets: &[f64], worlds: usize) -> Result<Option<usize>, BenchError> {
    let size = |worlds| {
        let before = heap();
        let batch = standing_batch(world, targets, worlds, 1, true)?;
        let size = heap().saturating_sub(before);
        drop(batch);
        Ok::<_, BenchError>(size)
    };
    let each = size(2 * worlds)?.saturating_sub(size(worlds)?) / worlds;
    Ok((each > 0).then_some(each))
}

impl fmt::Display for BatchReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { worlds, threads, .. } = self;
        writeln!(f, "{}", self.machine)?;
        writeln!(
            f,
            "Control steps of 20 ms a second, medians of rounds in a drawn order; ratios with their 95 % intervals:\n"
        )?;
        let mut row = |name: &str, rate: f64, note: String| writeln!(f, "  {name:<46} {rate:>8.0}  {note}");
        let (share, each) = (100.0 * self.proprioception_share, worlds / threads);
        row("whole room, standing: one world in a loop", self.single_steps_per_s, String::new())?;
        row(
            &format!("{worlds} worlds on one thread"),
            self.batch_steps_per_s,
            format!("{:.3} of the loop (bar: at least 0.95)", self.batch_ratio),
        )?;
        row(
            "the same with proprioception",
            self.proprioception_steps_per_s,
            format!("which is {share:.1} % of the step (bar: at most 3 %)"),
        )?;
        let of = |ratio, [low, high]: [f64; 2]| format!("{ratio:.3} ({low:.3} to {high:.3})");
        row(
            &format!("{worlds} worlds on {threads} threads"),
            self.threads_steps_per_s,
            format!("{:.2} times one thread", self.speed_up),
        )?;
        row(
            &format!("{threads} processes of {each} worlds, without waiting"),
            self.processes_steps_per_s,
            format!("threads: {} of it (bar: at least 0.95)", of(self.threads_ratio, self.threads_ratio_interval)),
        )?;
        row(
            "the same processes, step by step",
            self.lockstep_steps_per_s,
            format!("threads: {} of it", of(self.lockstep_ratio, self.lockstep_ratio_interval)),
        )?;
        row(&format!("walking on a floor: {worlds} on one thread"), self.walking_steps_per_s, String::new())?;
        row(
            &format!("walking on a floor: {worlds} on {threads} threads"),
            self.walking_threads_steps_per_s,
            format!("{:.2} times one thread", self.walking_threads_steps_per_s / self.walking_steps_per_s),
        )?;
        let size = self.bytes_per_world.map_or("not counted".into(), |bytes| format!("{:.1} kB", bytes as f64 / 1e3));
        writeln!(f, "memory of one more world, with proprioception: {size}")
    }
}
