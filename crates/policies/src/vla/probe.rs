//! Probes a model server without moving anything.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use fiatlux_bridge::{
    BridgeError, Contract, Frames, Mapping, ModelChunk, ModelObservation, ModelOptions, Picture, Row, Sensed, Timeouts,
    check_contract,
};
use fiatlux_robot::lidar::{RANGE, RAYS};

use super::{Shared, VlaSource};

/// A wait that lasts longer is reported.
const SILENCE: Duration = Duration::from_secs(3);

/// A server's description of itself, and its answer to one observation: the standing posture, and pictures of a grey ramp.
#[derive(Debug)]
pub struct ProbeReport {
    /// The contract that it announced.
    pub contract: Contract,
    /// The contract fits the mapping, or the reason why not.
    pub fit: Result<(), BridgeError>,
    /// Key and shape of everything that was sent.
    pub sent: Vec<(String, Vec<usize>)>,
    /// Its answer, or why there is none.
    pub answer: Result<Answer, BridgeError>,
}

/// A server's answer to one observation.
#[derive(Debug)]
pub struct Answer {
    /// Rows of actions under the model's own keys.
    pub chunk: ModelChunk,
    /// Time from the question to the end of the answer.
    pub latency: Duration,
    /// The same for the question before, for which a server may compile; `None` if it was not asked.
    pub first: Option<Duration>,
    /// The answer converted by the mapping, or how it differs from it.
    pub rows: Result<Vec<Row>, BridgeError>,
}

impl VlaSource {
    /// The mapping in use.
    pub fn mapping(&self) -> &Mapping {
        &self.0.mapping
    }

    /// Key and width of motion tokens that have no decoder, so that the policy refuses to play them; else `None`.
    pub fn undecoded(&self) -> Option<(&str, usize)> {
        self.0.check_decoder().err().and(self.0.mapping.token())
    }

    /// The observation for a first question: the standing posture, pictures of a grey ramp, no forces, and nothing in the
    /// LiDAR's range.
    pub(super) fn example(&self) -> Result<ModelObservation, BridgeError> {
        let Shared { mapping, robot, .. } = &*self.0;
        let mut frames = Frames::default();
        let [width, height] = mapping.picture;
        for sensor in mapping.sensors() {
            let line = (0..width).flat_map(|column| [(255 * column / width) as u8; 3]);
            let rgb: Vec<u8> = (0..height).flat_map(|_| line.clone()).collect();
            frames.push(mapping, 0, sensor, Picture::new(width, height, rgb)?);
        }
        let zeros = vec![0.0; robot.q0().len()];
        let (forces, scan) = (vec![0.0; 3 * robot.hand_links().len()], vec![RANGE as f32; RAYS]);
        let still = Sensed::still(robot.q0(), &zeros, robot.standing_height());
        let sensed = Sensed { hand_contact_force: &forces, lidar: &scan, ..still };
        mapping.observe(robot, &sensed, &frames, 0, "Stand still.", "probe")
    }

    /// Asks a first question with a deadline of its own; returns the answer and the time that it took.
    pub(super) fn warm_up(&self, observation: &ModelObservation) -> Result<(ModelChunk, Duration), BridgeError> {
        let Shared { options, warm_up, .. } = &*self.0;
        let timeouts = Timeouts { reply: *warm_up, ..options.timeouts };
        let mut model = ModelOptions { timeouts, ..options.clone() }.model()?;
        let (start, limit_s) = (Instant::now(), warm_up.as_secs());
        let (_answered, waits) = mpsc::channel::<()>();
        std::thread::spawn(move || {
            if waits.recv_timeout(SILENCE) == Err(RecvTimeoutError::Timeout) {
                tracing::warn!(
                    "waiting for the model server's first answer, for which it may compile; at most {limit_s} s"
                );
            }
        });
        let answer = model.reset().and_then(|()| model.infer(observation));
        let chunk = answer.map_err(|error| match error {
            BridgeError::Timeout { waited, .. } | BridgeError::Silent { waited, .. } => {
                BridgeError::ColdStart { waited }
            }
            other => other,
        })?;
        Ok((chunk, start.elapsed()))
    }

    /// Requests the contract, resets, and requests a chunk twice. The result lists differences.
    ///
    /// # Errors
    /// [`BridgeError`]: nobody answers, or the answer cannot be decoded.
    pub fn probe(&self) -> Result<ProbeReport, BridgeError> {
        let shared = &self.0;
        let mapping = &shared.mapping;
        let contract = shared.options.model()?.contract()?;
        let fit = check_contract(mapping, &contract);
        let observation = self.example()?;
        let images = observation.images.iter().map(|(key, tensor)| (key.clone(), tensor.shape().to_vec()));
        let states = observation.states.iter().map(|(key, numbers)| (key.clone(), vec![numbers.len()]));
        let sent = images.chain(states).collect();
        // One connection at a time: some servers serve no second one.
        let ask = || {
            let first = match shared.warm_up.is_zero() {
                true => None,
                false => Some(self.warm_up(&observation)?.1),
            };
            let mut model = shared.options.model()?;
            model.reset()?;
            let start = Instant::now();
            let chunk = model.infer(&observation)?;
            let latency = start.elapsed();
            let rows = shared.rows(shared.robot.q0(), &chunk);
            Ok(Answer { chunk, latency, first, rows })
        };
        Ok(ProbeReport { contract, fit, sent, answer: ask() })
    }
}
