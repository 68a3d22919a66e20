//! A look at a model server that moves nothing.

use std::time::{Duration, Instant};

use fiatlux_bridge::{BridgeError, Contract, Frames, Mapping, ModelChunk, Picture, Row, Sensed, check_contract};

use super::VlaSource;

/// What a server said of itself and to one observation: the standing posture, and pictures of a grey ramp.
#[derive(Debug)]
pub struct Probed {
    /// Its contract.
    pub contract: Contract,
    /// Whether mapping and contract fit.
    pub fit: Result<(), BridgeError>,
    /// What was sent: key and shape.
    pub sent: Vec<(String, Vec<usize>)>,
    /// What came.
    pub answer: Result<Answer, BridgeError>,
}

/// A server's answer to one observation.
#[derive(Debug)]
pub struct Answer {
    /// Its numbers.
    pub chunk: ModelChunk,
    /// The time from the question to all of it.
    pub latency: Duration,
    /// What the mapping makes of it, where it fits.
    pub rows: Result<Vec<Row>, BridgeError>,
}

impl VlaSource {
    /// The mapping in force.
    pub fn mapping(&self) -> &Mapping {
        &self.0.mapping
    }

    /// The motion tokens that nobody can read: their key and width. The policy refuses to play them.
    pub fn undecoded(&self) -> Option<(&str, usize)> {
        self.0.check_decoder().err().and(self.0.mapping.token())
    }

    /// Asks for the contract, resets, and asks once for a chunk. What does not fit is in the result.
    ///
    /// # Errors
    /// [`BridgeError`]: the server is not there, or says nothing that can be read.
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
