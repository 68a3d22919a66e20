//! What a policy is.

use fiatlux_proto::v3::{Chunk, Observation, Sensor, SessionInfo};
use fiatlux_session::Command;
use thiserror::Error;

use crate::balance::BalanceError;

/// Turns observations into commands. The terms of an observation are of the right length where they are not empty;
/// [`Policy::reset`] is the place to refuse a session that lacks a term.
pub trait Policy: Send {
    /// Name for the record.
    fn name(&self) -> String;

    /// The sensors it needs; none for those of the robot's own body. A session that is opened for it has these.
    fn sensors(&self) -> Vec<Sensor> {
        Vec::new()
    }

    /// Width and height of the cameras' images that it needs, pixels; none for the usual ones.
    fn image_size(&self) -> Option<[u32; 2]> {
        None
    }

    /// Sensors of the session that it wants to see of this step besides what the observation has: it is shown them in
    /// the observation that [`Policy::act`] gets. The server computes them then; lockstep waits. In real time the step
    /// may be over by then: the policy is asked again with the next observation, which may be the same.
    fn look(&mut self, _observation: &Observation) -> Vec<&'static str> {
        Vec::new()
    }

    /// An episode begins; `first` is its observation 0, which [`Policy::act`] is shown next.
    ///
    /// # Errors
    /// The policy cannot work in this session.
    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError>;

    /// Answers an observation. In lockstep each is shown once, in order; in real time only the newest one.
    ///
    /// # Errors
    /// The policy cannot go on.
    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError>;

    /// Where the command that [`Policy::act`] gave last comes from, for the record: of a policy that plays a model's chunks.
    fn source(&mut self) -> Option<Chunk> {
        None
    }

    /// The command of a step whose observation it does not need, as a recording has it. In lockstep such commands are sent
    /// ahead, and [`Policy::act`] is asked for the rest alone.
    fn foresee(&self, _step: u64) -> Option<Command> {
        None
    }
}

/// Why a policy cannot be made or go on.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// No policy has that name.
    #[error("there is no policy '{name}'; use one of {known}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// All names, separated by commas.
        known: String,
    },
    /// The session does not give what the policy reads.
    #[error(
        "policy {policy} needs the sensor {sensor}, which the session does not give; ask for it when you open the session"
    )]
    Sensor {
        /// Name of the policy.
        policy: &'static str,
        /// Name of the sensor.
        sensor: &'static str,
    },
    /// The session's robot is not the one that the policy knows.
    #[error("policy {policy} does not fit the session: {reason}")]
    Unfit {
        /// Name of the policy.
        policy: &'static str,
        /// What does not fit, and what to do.
        reason: String,
    },
    /// The balance controller refuses what it was given.
    #[error("the balance controller cannot go on")]
    Balance(#[from] BalanceError),
    /// The whole-body controller refuses.
    #[error("the whole-body controller cannot go on")]
    Wbc(#[from] fiatlux_wbc::WbcError),
    /// The model server refuses, does not fit, or is lost.
    #[error("policy vla cannot go on")]
    Bridge(#[from] fiatlux_bridge::BridgeError),
    /// A controller of others refuses.
    #[error("the foreign controller cannot be played")]
    Foreign(#[from] fiatlux_foreign::ForeignError),
    /// A word of a policy's name cannot be read.
    #[error("cannot read '{word}' as NAME=VALUE; use names of {fields}")]
    Words {
        /// As it was given.
        word: String,
        /// The names that are known.
        fields: &'static str,
    },
    /// A bag cannot be read.
    #[error("the bag to be replayed cannot be read")]
    Bag(#[from] fiatlux_bag::BagError),
    /// A bag has no action for a step.
    #[error(
        "the bag has actions for the steps before {actions} and none for step {step}; it was cut, or this run went on \
         longer than the recorded one did: compare task, seed, episode, gains, noise and thresholds with the bag's"
    )]
    Ended {
        /// Number of recorded actions.
        actions: usize,
        /// The step that has none.
        step: u64,
    },
    /// A command that no server takes.
    #[error("policy {policy} commands {field} {problem} in step {step}; correct the policy")]
    Command {
        /// Name of the policy.
        policy: String,
        /// Which of the two lists: `action` or `joint_target`.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
        /// Step of the observation that it answers.
        step: u64,
    },
}

impl PolicyError {
    /// A policy was asked for a command before [`Policy::reset`].
    pub(crate) fn not_reset(policy: &'static str) -> Self {
        Self::Unfit { policy, reason: "it was not reset; reset it first".into() }
    }
}
