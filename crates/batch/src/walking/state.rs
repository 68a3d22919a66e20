//! State of a walker in an episode, for snapshots.

use fiatlux_sensing::NoiseSeed;
use fiatlux_wbc::{BodyCommand, Clock, History, MOVED, Setpoint};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Walking;
use super::arms::Arms;
use super::hands::Hands;
use crate::TaskError;

#[derive(Serialize, Deserialize)]
struct State {
    /// Seed and episode.
    noise: Option<(u64, u64)>,
    history: History,
    command: BodyCommand,
    command_left: u32,
    setpoint: Setpoint,
    clock: Clock,
    arms: Arms,
    hands: Hands,
    actions: [[f64; MOVED]; 3],
    slow_velocity: [f64; 3],
    /// Positions, then velocities.
    feet: [[[f64; 3]; 2]; 2],
    joint_velocity: Vec<f64>,
}

impl Walking {
    pub(super) fn state(&self) -> Result<Vec<u8>, TaskError> {
        Ok(postcard::to_allocvec(&State {
            noise: self.noise.map(|noise| (noise.seed, noise.episode)),
            history: self.history.clone(),
            command: self.command,
            command_left: self.command_left,
            setpoint: self.setpoint,
            clock: self.clock.clone(),
            arms: self.arms.clone(),
            hands: self.hands.clone(),
            actions: self.actions,
            slow_velocity: self.slow_velocity.into(),
            feet: [self.foot_position, self.foot_velocity].map(|feet| feet.map(Into::into)),
            joint_velocity: self.joint_velocity.clone(),
        })?)
    }

    pub(super) fn set_state(&mut self, saved: &[u8]) -> Result<(), TaskError> {
        let state: State = postcard::from_bytes(saved)?;
        let is_of_this =
            state.history.frames() == self.options.frames && state.joint_velocity.len() == self.joint_velocity.len();
        if !is_of_this {
            return Err("the snapshot has another number of frames or joints".into());
        }
        self.noise = state.noise.map(|(seed, episode)| NoiseSeed { seed, episode });
        self.observer.restart(self.noise);
        (self.history, self.command, self.command_left) = (state.history, state.command, state.command_left);
        (self.setpoint, self.clock, self.arms, self.hands) = (state.setpoint, state.clock, state.arms, state.hands);
        (self.actions, self.slow_velocity) = (state.actions, state.slow_velocity.into());
        [self.foot_position, self.foot_velocity] = state.feet.map(|feet| feet.map(Vector3::from));
        self.joint_velocity = state.joint_velocity;
        Ok(())
    }
}
