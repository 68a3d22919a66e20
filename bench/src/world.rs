//! `bench world`: the time of one physics step.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use fiatlux_dynamics::Dynamics;
use fiatlux_world::PHYSICS_DT;

#[cfg(feature = "rapier")]
use super::MultibodyWorld;
use super::machine::machine;
use super::{BenchError, Case, CaseReport, Oracle, Report, Times, cases, room, worlds};

/// Rapier's multibody is slow: it is measured over this part of the time.
#[cfg(feature = "rapier")]
const MULTIBODY_SHARE: f64 = 0.05;
/// Smallest number of runs from one start that are measured.
const MIN_REPEATS: usize = 2;

/// Extent of the measurement, and engines to compare with.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    pub seconds: f64,
    /// The script that times MuJoCo; `None` leaves MuJoCo out.
    pub oracle: Option<PathBuf>,
}

/// Runs all cases, and names each on stderr.
pub fn run(options: &Options) -> Result<Report, BenchError> {
    let oracle = options.oracle.as_deref().map(Oracle::new).transpose()?;
    fiatlux_cli::report("bench: setting up");
    let cases = cases()?;
    let mut reports = Vec::new();
    for case in &cases {
        fiatlux_cli::report(format!("bench: {}", case.name));
        let repeats = repeats(case, options.seconds);
        // Half of it before MuJoCo and half after, so that a change in the machine's load affects both.
        let mut samples = Samples::default();
        samples.take(case, repeats.div_ceil(2));
        let mujoco = oracle.as_ref().map(|oracle| oracle.time(case, repeats)).transpose()?;
        samples.take(case, repeats.div_ceil(2));
        let mut report = samples.report(case.name);
        if let Some(mujoco) = mujoco {
            report.mujoco_us = Some(rounded(mujoco.mean_us));
            report.mujoco_options = Some(mujoco.options);
            report.mujoco_contacts = Some(mujoco.contacts);
            report.ratio = Some(rounded(report.mean_us / mujoco.mean_us));
        }
        reports.push(report);
    }
    #[cfg(not(feature = "rapier"))]
    fiatlux_cli::report("bench: Rapier's multibody is left out; build with --features rapier for it");
    #[cfg(feature = "rapier")]
    for case in &cases[..3] {
        for (substeps, label) in [(Some(1), "1 substep"), (None, "default")] {
            let name = format!("{}, Rapier multibody, {label}", case.name);
            fiatlux_cli::report(format!("bench: {name}"));
            reports.push(time_multibody(case, name, substeps, repeats(case, options.seconds * MULTIBODY_SHARE))?);
        }
    }
    Ok(Report { machine: machine(), cases: reports, room: room::run()?, worlds: worlds::run()? })
}

fn repeats(case: &Case, seconds: f64) -> usize {
    ((seconds / PHYSICS_DT / case.steps as f64).ceil() as usize).max(MIN_REPEATS)
}

/// Times of steps so far, and the solver's reports.
#[derive(Default)]
struct Samples {
    times: Vec<Duration>,
    contacts: u64,
    iterations: u64,
    unconverged: u64,
}

impl Samples {
    /// Times every step of this many runs from the start, after one that is not timed.
    fn take(&mut self, case: &Case, repeats: usize) {
        self.times.reserve(repeats * case.steps);
        let mut dynamics = Dynamics::new(&case.model);
        let mut state = case.start.clone();
        for run in 0..=repeats {
            state.clone_from(&case.start);
            for step in 0..case.steps {
                let begin = Instant::now();
                let report = case.step(&mut dynamics, &mut state, step);
                let elapsed = begin.elapsed();
                if run > 0 {
                    self.times.push(elapsed);
                    self.contacts += u64::from(report.contacts);
                    self.iterations += u64::from(report.iterations);
                    self.unconverged += u64::from(!report.converged);
                }
            }
        }
    }

    fn report(mut self, name: &str) -> CaseReport {
        CaseReport {
            iterations: Some(rounded(self.iterations as f64 / self.times.len().max(1) as f64)),
            unconverged: Some(self.unconverged),
            ..report(name.to_owned(), &mut self.times, self.contacts)
        }
    }
}

/// The same in Rapier, which holds the first targets. The world is built afresh for every run, and its first step,
/// which sets up the broad phase, is not timed.
#[cfg(feature = "rapier")]
fn time_multibody(
    case: &Case,
    name: String,
    substeps: Option<usize>,
    repeats: usize,
) -> Result<CaseReport, BenchError> {
    let mut samples = Vec::with_capacity(repeats * case.steps);
    let (mut contacts, mut apart_after) = (0, None);
    for _ in 0..repeats {
        let mut world = MultibodyWorld::new(&case.model, &case.start, &case.targets[0], substeps)?;
        world.step();
        for step in 1..case.steps {
            if !world.is_sane() {
                apart_after = Some(step);
                break;
            }
            let begin = Instant::now();
            world.step();
            samples.push(begin.elapsed());
            contacts += world.contacts() as u64;
        }
    }
    Ok(CaseReport { apart_after, ..report(name, &mut samples, contacts) })
}

fn report(name: String, samples: &mut [Duration], contacts: u64) -> CaseReport {
    let Times { mean_us, p50_us, p99_us } = Times::of(samples);
    CaseReport {
        name,
        mean_us: rounded(mean_us),
        p50_us: rounded(p50_us),
        p99_us: rounded(p99_us),
        contacts: rounded(contacts as f64 / samples.len().max(1) as f64),
        iterations: None,
        unconverged: None,
        apart_after: None,
        mujoco_us: None,
        mujoco_options: None,
        mujoco_contacts: None,
        ratio: None,
    }
}

/// Rounded to three decimals: more would be noise.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
