//! Statistics of a session so far. It reads no clock and does no I/O.

use std::collections::BTreeMap;

use fiatlux_client::{Command, RoundTrips};
use fiatlux_proto::v3::{EpisodeEnd, Mode, Notice, Observation, ObservationTerm, SessionInfo};

/// Sensors of at least this many numbers are looked at alone, to measure what they cost.
const LARGE: usize = 500;
/// Looks at each of them in lockstep; their median is shown.
const LOOKS: usize = 3;
/// Steps between two looks at the same sensor.
const LOOK_PERIOD: u64 = 50;

#[derive(Default)]
pub struct SessionStatistics {
    pub info: SessionInfo,
    pub policy: String,
    pub episode: u64,
    /// The newest part of every sensor.
    pub latest: Observation,
    /// Number of observations.
    pub count: u64,
    /// In the session's order.
    pub sensors: Vec<SensorStatistics>,
    /// Steps in which each criterion of the gate held, and steps with a verdict.
    pub held: Vec<u64>,
    pub verdicts: u64,
    /// Steps in which each joint's target was beyond its limits.
    pub beyond: Vec<u64>,
    /// Time from an action to the observation that answers it.
    pub steps: RoundTrips,
    /// Time that the policy took.
    pub acting: RoundTrips,
    pub notices: Vec<Notice>,
    pub end: Option<EpisodeEnd>,
}

#[derive(Default)]
pub struct SensorStatistics {
    pub name: &'static str,
    /// Observations that had it without a look, and the step of the newest with or without.
    pub count: u64,
    pub step: Option<u64>,
    /// Size in a message.
    pub bytes: usize,
    /// Times of looks at this sensor alone, and looks requested, answered or not.
    pub looks: RoundTrips,
    tries: usize,
}

impl SessionStatistics {
    /// Before the first observation.
    pub fn new(info: SessionInfo, policy: String, episode: u64) -> Self {
        // A program opens one session, and policies name sensors for its whole life.
        let sensor = |name: &String| SensorStatistics { name: name.clone().leak(), ..SensorStatistics::default() };
        let sensors = info.sensors.iter().map(|asked| sensor(&asked.name)).collect();
        let held = vec![0; info.task.as_ref().map_or(0, |task| task.criteria.len())];
        let beyond = vec![0; info.joints.len()];
        Self { info, policy, episode, sensors, held, beyond, ..Self::default() }
    }

    /// Takes in an observation; `look` are the sensors in it that were looked at, and the time that this took, s.
    pub fn observe(&mut self, observation: &Observation, look: Option<(Vec<&'static str>, f64)>) {
        self.count += 1;
        let sizes = observation.sizes();
        for seen in &mut self.sensors {
            let Some(bytes) = size_of(seen.name, &self.info, &sizes) else { continue };
            (seen.step, seen.bytes) = (Some(observation.step), bytes);
            match &look {
                Some((sensors, seconds)) if sensors.as_slice() == [seen.name] => seen.looks.push(*seconds),
                Some((sensors, _)) if sensors.contains(&seen.name) => {}
                _ => seen.count += 1,
            }
        }
        if let Some(verdict) = &observation.verdict {
            self.verdicts += 1;
            for (held, holds) in self.held.iter_mut().zip(&verdict.criteria) {
                *held += u64::from(*holds);
            }
        }
        (self.latest.episode, self.latest.step) = (observation.episode, observation.step);
        self.latest.overlay(observation);
    }

    /// Takes in the policy's answer, and the time that it took, s.
    pub fn act(&mut self, command: &Command, seconds: f64) {
        self.acting.push(seconds);
        let (numbers, scale) = match command {
            Command::Action(numbers) => (numbers, Some(self.info.action_scale)),
            Command::JointTarget(numbers) | Command::WholeBody(_, numbers) => (numbers, None),
        };
        for ((number, joint), count) in numbers.iter().zip(&self.info.joints).zip(&mut self.beyond) {
            let target = scale.map_or(*number, |scale| joint.q0 + scale * number);
            // Single precision on the way here may have moved a target off its limit.
            const SLACK: f64 = 1e-6;
            *count += u64::from(target < joint.lower - SLACK || target > joint.upper + SLACK);
        }
    }

    /// The sensors of the session that an observation lacks.
    pub fn absent(&self, observation: &Observation) -> Vec<&'static str> {
        let sizes = observation.sizes();
        let names = self.sensors.iter().map(|seen| seen.name);
        names.filter(|name| size_of(name, &self.info, &sizes).is_none()).collect()
    }

    /// The large sensor whose turn it is to be looked at in this step, unless the observation has it.
    pub fn turn(&mut self, observation: &Observation) -> Option<&'static str> {
        // From step 1 on: sensors with a rate are in the observation of step 0.
        let turn = usize::try_from((observation.step % LOOK_PERIOD).checked_sub(1)?).ok()?;
        let is_large = |seen: &SensorStatistics| {
            self.info.terms_of(seen.name).map(ObservationTerm::length).sum::<usize>() >= LARGE
        };
        let index = self.sensors.iter().enumerate().filter(|(_, seen)| is_large(seen)).nth(turn)?.0;
        // In real time a look costs steps.
        let looks = if self.info.mode() == Mode::RealTime { 1 } else { LOOKS };
        let seen = &mut self.sensors[index];
        seen.tries += 1;
        let is_due = seen.tries <= looks && size_of(seen.name, &self.info, &observation.sizes()).is_none();
        is_due.then_some(seen.name)
    }
}

/// Size in a message of a sensor's part, bytes; `None` if it is absent.
fn size_of(sensor: &str, info: &SessionInfo, sizes: &BTreeMap<&'static str, usize>) -> Option<usize> {
    let field = &info.terms_of(sensor).next()?.field;
    sizes.get(field.split('.').next()?).copied()
}
