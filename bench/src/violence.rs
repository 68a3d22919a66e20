//! `bench violence`: how the engine behaves under targets that no sound policy sends, but that a learner finds.

mod accuracy;
mod export;
mod flight;
mod trial;

use std::collections::BTreeMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::Serialize;

use super::BenchError;
use super::machine::machine;
use super::report::write_table;
pub use export::export;
use trial::Trials;

/// Number of runs and of threads.
#[derive(Debug, Clone, PartialEq)]
pub struct ViolenceOptions {
    pub runs: u64,
    /// Random starts of 1 s.
    pub starts: u64,
    pub threads: usize,
}

/// Result of `bench violence`.
#[derive(Debug, Clone, Serialize)]
pub struct ViolenceReport {
    pub machine: String,
    /// Conservation of energy in free flight without drives, limits and contact.
    pub flight: Vec<FlightReport>,
    pub trials: Vec<TrialReport>,
    /// One entry for each pattern of targets.
    pub accuracy: Vec<AccuracyReport>,
}

/// Conservation of energy over 0.1 s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FlightReport {
    /// Speed of every joint at the start, rad/s, with a random sign.
    pub joint_speed: f64,
    /// Largest change of the kinetic energy at any step, of all starts, as a part of it.
    pub worst: f64,
    /// Mean relative change at the end.
    pub mean: f64,
}

/// Results of a set of runs.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TrialReport {
    pub name: String,
    pub runs: u64,
    /// Number of runs that ended as diverged.
    pub diverged: u64,
    /// Largest speed of a joint with a rated speed at the end of a physics step, rad/s.
    pub joint_speed: f64,
    /// Largest speed of the pelvis, m/s.
    pub pelvis_speed: f64,
    /// Deepest contact point, m.
    pub penetration: f64,
    /// The run with the deepest contact point.
    pub deepest_run: u64,
    /// Number of runs in which a contact point was deeper than 5 mm for more than 0.1 s.
    pub deep_runs: u64,
    /// In these runs, the pairs that were deepest, each with the number of runs and its depth, m.
    pub deep_pairs: BTreeMap<String, (u64, f64)>,
    pub steps: u64,
    /// Number of physics steps that were tried twice.
    pub retried: u64,
    /// Number of physics steps whose second try did not converge.
    pub unconverged: u64,
}

/// Distance to a simulation of the same second at 0.25 ms with the same targets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AccuracyReport {
    pub name: String,
    /// At 0.1, 0.2, 0.5 and 1 s: median distance of the pelvis, m, and of the joints (root mean square), rad.
    pub errors: [(f64, f64); 4],
}

/// Runs everything, and reports progress on stderr.
pub fn run(options: &ViolenceOptions) -> Result<ViolenceReport, BenchError> {
    let flight = flight::JOINT_SPEEDS.map(flight::measure).into_iter().collect::<Result<_, _>>()?;
    let trials = Trials::new()?;
    let mut reports = Vec::new();
    for (index, pattern) in trial::PATTERNS.into_iter().enumerate() {
        // The first patterns get the remainder.
        let patterns = trial::PATTERNS.len() as u64;
        let runs = options.runs / patterns + u64::from((index as u64) < options.runs % patterns);
        reports.push(share(&pattern.name(), runs, options.threads, |run| trials.violent(pattern, run))?);
    }
    reports.push(share("random starts", options.starts, options.threads, |start| trials.random_start(start))?);
    let accuracy = accuracy::measure(&trials, options.runs)?;
    Ok(ViolenceReport { machine: machine(), flight, trials: reports, accuracy })
}

/// Runs on all threads and sums up the results; the sum does not depend on the order.
fn share(
    name: &str,
    runs: u64,
    threads: usize,
    play: impl Fn(u64) -> Result<TrialReport, BenchError> + Sync,
) -> Result<TrialReport, BenchError> {
    let next = AtomicU64::new(0);
    let worker = || {
        let mut sum = TrialReport::default();
        loop {
            let run = next.fetch_add(1, Ordering::Relaxed);
            if run >= runs {
                return Ok(sum);
            }
            if run.is_multiple_of(1000) {
                fiatlux_cli::report(format!("bench: {name}, run {run} of {runs}"));
            }
            sum.add(play(run)?);
        }
    };
    let mut total = TrialReport { name: name.into(), ..TrialReport::default() };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            total.add(worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        }
        Ok(total)
    })
}

impl TrialReport {
    fn add(&mut self, other: TrialReport) {
        self.runs += other.runs;
        self.diverged += other.diverged;
        self.joint_speed = self.joint_speed.max(other.joint_speed);
        self.pelvis_speed = self.pelvis_speed.max(other.pelvis_speed);
        // Among equals the first run wins, so that the order of the sum does not show.
        let rank = |report: &TrialReport| (report.penetration, std::cmp::Reverse(report.deepest_run));
        if rank(&other) > rank(self) {
            (self.penetration, self.deepest_run) = (other.penetration, other.deepest_run);
        }
        self.deep_runs += other.deep_runs;
        self.steps += other.steps;
        self.retried += other.retried;
        self.unconverged += other.unconverged;
        for (pair, (count, depth)) in other.deep_pairs {
            let entry = self.deep_pairs.entry(pair).or_default();
            *entry = (entry.0 + count, entry.1.max(depth));
        }
    }

    fn cells(&self) -> Vec<String> {
        vec![
            self.name.clone(),
            self.runs.to_string(),
            self.diverged.to_string(),
            format!("{:.0}", self.joint_speed),
            format!("{:.1}", self.pelvis_speed),
            format!("{:.1} in run {}", self.penetration * 1e3, self.deepest_run),
            self.deep_runs.to_string(),
            self.steps.to_string(),
            self.retried.to_string(),
            self.unconverged.to_string(),
        ]
    }
}

const TRIALS: [&str; 10] = [
    "targets",
    "runs",
    "diverged",
    "joint rad/s",
    "pelvis m/s",
    "deepest mm",
    "deep runs",
    "steps",
    "tried twice",
    "unconverged",
];
const ACCURACY: [&str; 5] = ["targets", "0.1 s", "0.2 s", "0.5 s", "1 s"];

impl fmt::Display for ViolenceReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n", self.machine)?;
        writeln!(f, "Kinetic energy after 0.1 s of free flight, no drives, limits or contact:")?;
        for FlightReport { joint_speed, worst, mean } in &self.flight {
            let (worst, mean) = (100.0 * worst, 100.0 * mean);
            writeln!(
                f,
                "every joint at {joint_speed} rad/s: within {worst:.3} % at every step, {mean:+.3} % in the mean"
            )?;
        }
        writeln!(f, "\nViolent targets for 10 s, and 1 s from random starts:\n")?;
        let header = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
        let mut rows = vec![header(&TRIALS)];
        rows.extend(self.trials.iter().map(TrialReport::cells));
        write_table(f, &rows)?;
        for (report, (pair, (count, depth))) in
            self.trials.iter().flat_map(|r| r.deep_pairs.iter().map(move |p| (r, p)))
        {
            writeln!(f, "{}: {pair} deep in {count} runs, {:.1} mm at most", report.name, depth * 1e3)?;
        }
        writeln!(f, "\nFrom the same at 0.25 ms: median distance of the pelvis, mm, and of the joints, mrad:\n")?;
        let mut rows = vec![header(&ACCURACY)];
        let cell = |(pelvis, joints): &(f64, f64)| format!("{:.2} / {:.2}", pelvis * 1e3, joints * 1e3);
        rows.extend(self.accuracy.iter().map(|report| {
            std::iter::once(report.name.clone()).chain(report.errors.iter().map(cell)).collect::<Vec<_>>()
        }));
        write_table(f, &rows)
    }
}
