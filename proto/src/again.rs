//! The request that plays a recorded episode again.

use crate::v3::{EpisodeHeader, Mode, OpenRequest};

impl EpisodeHeader {
    /// The request for a session with the same rows. It is in lockstep, whatever the recorded mode, because a bag has the action that
    /// led to each row. It carries the recorded policy's name: what it records is a copy.
    pub fn request_again(&self) -> OpenRequest {
        let header = self.clone();
        // Grading uses the same fields, so a header cannot state one thing and do another.
        OpenRequest {
            policy: header.policy,
            task: header.task,
            seed: header.seed,
            mode: Mode::Lockstep.into(),
            gains: header.gains,
            robot: header.robot,
            randomization: header.randomization,
            end_on: if header.end_on_overridden { header.end_on } else { Vec::new() },
            thresholds: header.thresholds,
            episode_protocol: header.episode_protocol,
            recorded: false,
            ..header.request.unwrap_or_default()
        }
    }
}
