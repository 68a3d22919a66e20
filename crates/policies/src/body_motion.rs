//! A tracked body as the source of tokens for `sonic`: the stream of the makers' PICO program, and their encoder from the user's file.

use std::path::Path;
use std::time::{Duration, Instant};

use fiatlux_bridge::{BodyMotion, BodyStream};
use fiatlux_client::PolicyError;
use fiatlux_foreign::{Encoder, Pose, Token, token_of};
use fiatlux_proto::v3::{Observation, Sensor};

use super::body;

const NAME: &str = "sonic";
/// Longest wait for the first message.
const PATIENCE: Duration = Duration::from_secs(10);
/// Time between two looks for it.
const LOOK: Duration = Duration::from_millis(20);
/// Of a stream that says nothing for this long the last pose is held.
const MAX_AGE: Duration = Duration::from_millis(200);

/// The motion of a person who is tracked elsewhere.
pub(crate) struct TrackedBody {
    stream: BodyStream,
    /// `None` for a stream of tokens.
    encoder: Option<Encoder>,
}

impl TrackedBody {
    /// Waits for the first message of a stream. If it holds poses, `folder` needs the encoder.
    ///
    /// # Errors
    /// No message comes that can be read, or the encoder cannot be loaded.
    pub fn open(address: &str, folder: &Path) -> Result<Self, PolicyError> {
        Self::open_within(PATIENCE, address, folder)
    }

    fn open_within(patience: Duration, address: &str, folder: &Path) -> Result<Self, PolicyError> {
        let stream = BodyStream::start(address).map_err(PolicyError::of(NAME))?;
        let start = Instant::now();
        let first = loop {
            if let Some((motion, _)) = stream.motion() {
                break motion;
            }
            if start.elapsed() > patience {
                let problem = stream.problem();
                let because = if problem.is_empty() { String::new() } else { format!(" ({problem})") };
                let reason = format!(
                    "no body came from {address} within {} s{because}; start the sender, and let it send poses",
                    patience.as_secs_f64()
                );
                return Err(PolicyError::Unfit { policy: NAME, reason });
            }
            std::thread::sleep(LOOK);
        };
        let encoder = match first {
            BodyMotion::Token(_) => None,
            BodyMotion::Frames(_) => Some(Encoder::read(folder).map_err(PolicyError::of(NAME))?),
        };
        Ok(Self { stream, encoder })
    }

    /// SHA-256 of the encoder.
    pub fn digest(&self) -> Option<&str> {
        self.encoder.as_ref().map(Encoder::digest)
    }

    /// The robot's heading is not of its own body, so that an encoder needs its pose.
    pub fn sensors(&self) -> Vec<Sensor> {
        let names = ["proprioception", "last_action", "privileged"];
        names[..if self.encoder.is_some() { 3 } else { 2 }].iter().map(|name| Sensor::from(*name)).collect()
    }

    pub fn reset(&mut self) {
        if let Some(encoder) = &mut self.encoder {
            encoder.reset();
        }
    }

    /// The token of a control step.
    ///
    /// # Errors
    /// The observation lacks the robot's pose, the stream has changed from tokens to poses or back, or its numbers give no token.
    pub fn token(&mut self, observation: &Observation) -> Result<Token, PolicyError> {
        let changed = || PolicyError::Unfit {
            policy: NAME,
            reason: "the stream of the body has another version than at the start; start again".into(),
        };
        match (self.stream.motion().ok_or_else(changed)?, &mut self.encoder) {
            ((BodyMotion::Token(token), _), None) => token_of(&token.map(f64::from)).map_err(PolicyError::of(NAME)),
            ((BodyMotion::Frames(frames), age), Some(encoder)) => {
                let seen = observation.privileged.as_ref();
                let seen = seen.ok_or(PolicyError::Sensor { policy: NAME, sensor: "privileged" })?;
                let pelvis = body::pose(NAME, seen.robot.as_ref())?;
                let turn = pelvis.rotation.quaternion();
                // Held still, and not in the midst of a motion.
                let from = if age > MAX_AGE { frames.len().saturating_sub(1) } else { 0 };
                let poses: Vec<Pose<'_>> = frames[from..]
                    .iter()
                    .map(|frame| Pose { joints: &frame.joints, root: frame.root, wrists: &frame.wrists })
                    .collect();
                encoder.token(&poses, [turn.w, turn.i, turn.j, turn.k]).map_err(PolicyError::of(NAME))
            }
            _ => Err(changed()),
        }
    }
}

#[cfg(test)]
mod tests;
