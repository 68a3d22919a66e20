//! Probes a model server without moving anything.

use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Contract, Frames, Mapping, ModelChunk, Picture, Row, Sensed, check_contract};

use super::VlaSource;

/// What a server says about itself, and its answer to one observation: the standing posture, and pictures of a grey
/// ramp.
#[derive(Debug)]
pub struct Probed {
    /// The contract that it announced.
    pub contract: Contract,
    /// Whether the contract fits the mapping.
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

    /// Requests the contract, resets, and requests one chunk. The result lists differences.
    ///
    /// # Errors
    /// [`BridgeError`]: nobody answers, or the answer cannot be decoded.
    pub fn probe(&self) -> Result<Probed, BridgeError> {
        let shared = &self.0;
        let mapping = &shared.mapping;
        let mut model = shared.options.model()?;
        let contract = model.contract()?;
        let fit = check_contract(mapping, &contract);
        let mut frames = Frames::default();
        let [width, height] = mapping.picture;
        for sensor in mapping.sensors() {
            let line = (0..width).flat_map(|column| [(255 * column / width) as u8; 3]);
            let rgb: Vec<u8> = (0..height).flat_map(|_| line.clone()).collect();
            frames.push(mapping, 0, sensor, Picture::new(width, height, rgb)?);
        }
        let q = shared.robot.q0();
        let zeros = vec![0.0; q.len()];
        let sensed = Sensed::still(q, &zeros, shared.robot.standing_height());
        let observation = mapping.observe(&shared.robot, &sensed, &frames, 0, "Stand still.", "probe")?;
        let images = observation.images.iter().map(|(key, tensor)| (key.clone(), tensor.shape().to_vec()));
        let states = observation.states.iter().map(|(key, numbers)| (key.clone(), vec![numbers.len()]));
        let sent = images.chain(states).collect();
        let mut ask = || {
            model.reset()?;
            let start = Instant::now();
            let chunk = model.infer(&observation)?;
            let latency = start.elapsed();
            let rows = shared.rows(q, &chunk);
            Ok(Answer { chunk, latency, rows })
        };
        Ok(Probed { contract, fit, sent, answer: ask() })
    }
}
