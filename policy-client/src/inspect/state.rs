//! What has been seen of a session so far. It reads no clock and does no I/O.

use std::collections::BTreeMap;

use fiatlux_client::{Command, RoundTrips};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{EpisodeEnd, Mode, Notice, Observation, ObservationTerm, SessionInfo};

use super::terms::{SENSORS, Sensor};

/// Number of looks at each large sensor; their median is shown.
const LOOKS: u32 = 3;
/// Steps between two looks at the same sensor.
const LOOK_PERIOD: u64 = 50;
/// Largest number of notices to show.
const NOTICES: usize = 5;

/// What has been seen of a session so far.
#[derive(Default)]
pub struct State {
    pub info: SessionInfo,
    pub policy: String,
    pub episode: u64,
    /// The newest numbers of every sensor; `step` is the newest one's.
    pub latest: Observation,
    /// The newest scan, with the body's sensors at its step.
    pub scanned: Observation,
    /// Terms that are not in the list here, as the session describes them, with their newest numbers.
    pub others: Vec<(ObservationTerm, Vec<f64>)>,
    /// What was seen of each sensor, by name.
    pub seen: BTreeMap<&'static str, Seen>,
    pub observations: u64,
    /// Size of all observations, without those of looks, bytes.
    pub bytes: u64,
    /// Time from an action to the observation that answers it: over all, and by the large sensors in it.
    pub steps: RoundTrips,
    pub steps_with: BTreeMap<Vec<&'static str>, RoundTrips>,
    /// Time that the policy took.
    pub acting: RoundTrips,
    /// Steps in which each criterion held, and steps with a verdict.
    pub held: Vec<u64>,
    pub verdicts: u64,
    pub reward: f64,
    pub out_of_limits: OutOfLimits,
    pub notices: Vec<Notice>,
    pub notice_count: u64,
    pub end: Option<EpisodeEnd>,
    /// Time since the first observation, s.
    pub wall_s: f64,
    /// Part of `wall_s` that looks took, s.
    pub look_s: f64,
    first_s: Option<f64>,
    acted_s: Option<f64>,
}

/// What has been seen of a sensor.
#[derive(Default)]
pub struct Seen {
    /// Number of observations that contained it.
    pub count: u64,
    /// Step of the newest observation that contained it.
    pub step: u64,
    /// Size in a message, bytes, without the fields that all observations have.
    pub bytes: usize,
    /// Durations of looks at this sensor alone.
    pub looks: RoundTrips,
    /// Number of looks requested, answered or not.
    tries: u32,
}

/// Commands beyond the limits of the joints.
#[derive(Default)]
pub struct OutOfLimits {
    pub steps: u64,
    /// Steps in which each joint was beyond its limits, by joint index.
    pub joints: Vec<u64>,
}

impl State {
    /// The state of a session before its first observation.
    pub fn new(info: SessionInfo, policy: String, episode: u64) -> Self {
        let out_of_limits = OutOfLimits { joints: vec![0; info.joints.len()], ..OutOfLimits::default() };
        let held = vec![0; info.task.as_ref().map_or(0, |task| task.criteria.len())];
        let others = info.terms.iter().filter(|term| Sensor::by_name(&term.sensor).is_none());
        let others = others.map(|term| (term.clone(), Vec::new())).collect();
        Self { info, policy, episode, held, out_of_limits, others, ..Self::default() }
    }

    /// Takes in an observation; returns false if it is the same as before. In real time the same one is shown again if
    /// the step of a look was over.
    pub fn observed(&mut self, observation: &Observation, now_s: f64) -> bool {
        if self.observations > 0 && observation.step == self.latest.step {
            return false;
        }
        self.observations += 1;
        self.bytes += observation.encoded_len() as u64;
        (self.latest.episode, self.latest.step) = (observation.episode, observation.step);
        let mut large = Vec::new();
        for sensor in &SENSORS {
            if self.keep(sensor, observation) {
                self.seen.entry(sensor.name).or_default().count += 1;
                large.extend(sensor.is_large.then_some(sensor.name));
            }
        }
        self.keep_others(observation);
        if let Some(acted_s) = self.acted_s.take() {
            self.steps.push(now_s - acted_s);
            self.steps_with.entry(large).or_default().push(now_s - acted_s);
        }
        if let Some(verdict) = &observation.verdict {
            self.verdicts += 1;
            self.reward += verdict.reward;
            for (held, holds) in self.held.iter_mut().zip(&verdict.criteria) {
                *held += u64::from(*holds);
            }
        }
        self.passed(now_s);
        true
    }

    /// The sensors to look at in this step: with `all`, those of the session that the observation lacks, else a large
    /// one whose turn it is.
    pub fn wanted(&mut self, observation: &Observation, all: bool) -> Vec<&'static str> {
        let absent = |sensor: &&Sensor| self.is_asked(sensor.name) && !sensor.is_in(observation);
        if all {
            return SENSORS.iter().filter(absent).map(|sensor| sensor.name).collect();
        }
        // From step 1 on: sensors with a rate are in the observation of step 0.
        let turn = (observation.step % LOOK_PERIOD).checked_sub(1).and_then(|turn| usize::try_from(turn).ok());
        let large = SENSORS.iter().filter(|sensor| sensor.is_large);
        let wanted = turn.and_then(|turn| large.filter(|sensor| self.is_asked(sensor.name)).nth(turn)).filter(absent);
        let Some(sensor) = wanted else { return Vec::new() };
        // In real time a look costs steps.
        let looks = if self.is_real_time() { 1 } else { LOOKS };
        let seen = self.seen.entry(sensor.name).or_default();
        seen.tries += 1;
        if seen.tries > looks { Vec::new() } else { vec![sensor.name] }
    }

    /// Takes in the answer to a look.
    pub fn looked(&mut self, sensors: &[&'static str], observation: &Observation, took_s: f64) {
        for sensor in sensors.iter().filter_map(|name| Sensor::by_name(name)) {
            self.keep(sensor, observation);
        }
        self.keep_others(observation);
        self.look_s += took_s;
        if let [only] = sensors {
            self.seen.entry(only).or_default().looks.push(took_s);
        }
    }

    /// Takes in the policy's answer.
    pub fn acted(&mut self, command: &Command, took_s: f64, now_s: f64) {
        self.acting.push(took_s);
        self.acted_s = Some(now_s);
        let (numbers, scale) = match command {
            Command::Action(numbers) => (numbers, Some(self.info.action_scale)),
            Command::JointTarget(numbers) | Command::WholeBody(_, numbers) => (numbers, None),
        };
        let mut beyond = false;
        for ((number, joint), count) in numbers.iter().zip(&self.info.joints).zip(&mut self.out_of_limits.joints) {
            let target = scale.map_or(*number, |scale| joint.q0 + scale * number);
            // Single precision on the way here may have moved a target off its limit.
            const SLACK: f64 = 1e-6;
            if target < joint.lower - SLACK || target > joint.upper + SLACK {
                *count += 1;
                beyond = true;
            }
        }
        self.out_of_limits.steps += u64::from(beyond);
        self.passed(now_s);
    }

    /// Takes in a notice from the server.
    pub fn noticed(&mut self, notice: Notice) {
        self.notice_count += notice.count.max(1);
        if self.notices.len() == NOTICES {
            self.notices.remove(0);
        }
        self.notices.push(notice);
    }

    /// Simulated time of the newest observation, s.
    pub fn simulated_s(&self) -> f64 {
        self.latest.step as f64 * self.info.control_dt
    }

    /// Mode of the session: `lockstep` or `real time`.
    pub fn mode(&self) -> &'static str {
        if self.is_real_time() { "real time" } else { "lockstep" }
    }

    /// Whether the server steps by the wall clock.
    pub fn is_real_time(&self) -> bool {
        self.info.mode() == Mode::RealTime
    }

    /// Steps for each second of wall clock, in lockstep without the time of looks; 0 before the second observation.
    pub fn steps_per_s(&self) -> f64 {
        let spent_s = if self.is_real_time() { self.wall_s } else { self.wall_s - self.look_s };
        if spent_s > 0.0 { self.latest.step as f64 / spent_s } else { 0.0 }
    }

    /// Whether the session includes a sensor.
    pub fn is_asked(&self, name: &str) -> bool {
        self.info.sensors.iter().any(|sensor| sensor.name == name)
    }

    fn passed(&mut self, now_s: f64) {
        self.wall_s = now_s - *self.first_s.get_or_insert(now_s);
    }

    fn keep_others(&mut self, observation: &Observation) {
        for (term, newest) in &mut self.others {
            let (numbers, offset) = (observation.numbers(&term.field), term.offset as usize);
            if let Some(own) = numbers.get(offset..offset.saturating_add(term.length())) {
                *newest = own.to_vec();
            }
        }
    }

    fn keep(&mut self, sensor: &'static Sensor, observation: &Observation) -> bool {
        let bytes = sensor.keep(observation, &mut self.latest);
        if bytes > 0 {
            let seen = self.seen.entry(sensor.name).or_default();
            (seen.bytes, seen.step) = (bytes, observation.step);
        }
        if bytes > 0 && sensor.name == "lidar" {
            self.scanned = Observation {
                lidar: observation.lidar.clone(),
                proprioception: observation.proprioception.clone().or_else(|| self.latest.proprioception.clone()),
                privileged: observation.privileged.clone().or_else(|| self.latest.privileged.clone()),
                ..Observation::default()
            };
        }
        bytes > 0
    }
}
