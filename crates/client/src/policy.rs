//! The trait that policies implement, and their errors.

use fiatlux_proto::v3::{Chunk, Observation, OpenRequest, Sensor, SessionInfo, Source};
use fiatlux_rules::Task;
use fiatlux_session::Command;
use thiserror::Error;

/// Turns observations into commands. Each term of an observation is either empty or of the right length; use
/// [`Policy::reset`] to refuse a session that lacks a term.
pub trait Policy: Send {
    /// Name of the policy for the record. An evaluation goes on with episodes of the same name, so a name has the arguments that
    /// decide what the policy does, and a digest of its weights if they come from a file.
    fn name(&self) -> String;

    /// Tasks that the policy can play. A run with others is refused before it is registered.
    fn tasks(&self) -> &'static [Task] {
        &Task::ALL
    }

    /// Sensors that the policy needs; if empty, it gets proprioception, contact forces and the last action. A session
    /// opened for it has exactly these.
    fn sensors(&self) -> Vec<Sensor> {
        Vec::new()
    }

    /// Width and height of the camera images that it needs, pixels; `None` for the default.
    fn image_size(&self) -> Option<[u32; 2]> {
        None
    }

    /// Sensors of the session to read in this step in addition to those of the observation; [`Policy::act`] gets an
    /// observation that includes them. The server computes them on request while lockstep waits. In real time the step
    /// may be over by then: the policy is asked again with the next observation, which may be the same.
    fn look(&mut self, _observation: &Observation) -> Vec<&'static str> {
        Vec::new()
    }

    /// Starts an episode; `first` is its observation 0, which [`Policy::act`] receives next.
    ///
    /// # Errors
    /// The policy cannot work in this session.
    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError>;

    /// True while somebody looks at observation 0 before the episode starts. The session is kept open meanwhile, and the question
    /// is asked again; [`Policy::act`] answers the observation once this is false.
    fn waits(&mut self, _first: &Observation) -> bool {
        false
    }

    /// True if its commands come from a person, such as one whose tracked body the robot follows. Its episodes are marked so, and
    /// are never ranked.
    fn is_person(&self) -> bool {
        false
    }

    /// Answers an observation. In lockstep it receives each one once, in order; in real time only the newest.
    ///
    /// # Errors
    /// The policy cannot continue.
    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError>;

    /// For a policy that plays a model's chunks: where the last command of [`Policy::act`] comes from, for the record.
    fn source(&mut self) -> Option<Chunk> {
        None
    }

    /// The command of a step for which the policy needs no observation, such as one of a recording. In lockstep these
    /// are sent ahead, and [`Policy::act`] is called only for the others.
    fn foresee(&self, _step: u64) -> Option<Command> {
        None
    }
}

/// Why a policy cannot be made or cannot continue.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages name the fields.
pub enum PolicyError {
    /// No policy has this name.
    #[error("'{name}' is not a known policy; use one of {known}{hint}")]
    Unknown { name: String, hint: String, known: String },
    /// A run has tasks that the policy does not play.
    #[error("policy {policy} does not play {refused}; choose tasks that it plays: --tasks {plays}")]
    Tasks { policy: String, refused: String, plays: String },
    /// The session lacks a sensor that the policy reads.
    #[error("policy {policy} needs the sensor {sensor}, which the session lacks; ask for it when you open the session")]
    Sensor { policy: &'static str, sensor: &'static str },
    /// The session's robot or task is not one that the policy knows.
    #[error("policy {policy} does not fit the session: {reason}")]
    Unfit { policy: &'static str, reason: String },
    /// The policy's own error, which says why it cannot be made or cannot continue.
    #[error("policy {policy} cannot go on")]
    Failed { policy: &'static str, source: Box<dyn std::error::Error + Send + Sync> },
    /// A word in a policy's arguments is not NAME=VALUE with a known name.
    #[error("cannot read '{word}' as NAME=VALUE; use names of {fields}")]
    Words { word: String, fields: &'static str },
    /// The bag has no action for a step.
    #[error(
        "the bag has actions for the steps before {actions} and none for step {step}; it was cut, or this run went on \
         longer than the recorded one did: compare task, seed, episode, gains, noise and thresholds with the bag's"
    )]
    Ended { actions: usize, step: u64 },
    /// The policy gives a command that every server would refuse.
    #[error("policy {policy} commands {field} {problem} in step {step}; correct the policy")]
    Command { policy: String, field: &'static str, problem: String, step: u64 },
}

/// The request of a session for a policy: its name, sensors and size of pictures, and where its actions come from.
pub fn request_of(policy: &dyn Policy) -> OpenRequest {
    let [image_width, image_height] = policy.image_size().unwrap_or_default();
    let source = if policy.is_person() { Source::Person } else { Source::Unspecified }.into();
    let (name, sensors) = (policy.name(), policy.sensors());
    OpenRequest { policy: name, sensors, image_width, image_height, source, ..OpenRequest::default() }
}

/// Refuses tasks that a policy does not play.
///
/// # Errors
/// [`PolicyError::Tasks`].
pub fn check_tasks(policy: &dyn Policy, tasks: &[Task]) -> Result<(), PolicyError> {
    let plays = policy.tasks();
    let refused: Vec<&str> = tasks.iter().filter(|task| !plays.contains(task)).map(|task| task.short_id()).collect();
    if refused.is_empty() {
        return Ok(());
    }
    let plays: Vec<&str> = plays.iter().map(|task| task.short_id()).collect();
    Err(PolicyError::Tasks { policy: policy.name(), refused: refused.join(", "), plays: plays.join(",") })
}

impl PolicyError {
    /// Wraps the errors of a policy's own parts.
    pub fn of<E: std::error::Error + Send + Sync + 'static>(policy: &'static str) -> impl Fn(E) -> Self {
        move |source| Self::Failed { policy, source: Box::new(source) }
    }

    /// The error of a policy that is asked for a command before [`Policy::reset`].
    pub fn not_reset(policy: &'static str) -> Self {
        Self::Unfit { policy, reason: "it was not reset; reset it first".into() }
    }
}
