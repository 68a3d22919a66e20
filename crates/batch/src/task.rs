//! What a world of a batch plays.

use fiatlux_rules::Row;
use fiatlux_world::{AppliedWrench, Push, Random, Scene, World};

use crate::TaskError;

/// What a world of a batch plays: what an action means, what is observed, what is paid and what ends an episode. Every world
/// has a copy, which may keep what it needs from step to step; a copy of it goes into a [`Snapshot`](crate::Snapshot).
///
/// In a control step a world calls `command`, moves, and calls `judge`; where the episode goes on, `observe`. Where it ends,
/// `observe` (the final observation, if it is asked for), `place`, `begin` and `observe` (the first of the next episode).
/// `world` then stands at the row that is spoken of: [`World::row`], [`World::world_from_link`].
///
/// Draw random numbers from `random` alone, which is the world's own stream; then results depend on nothing else.
pub trait Task: TaskClone + Send + Sync {
    /// Names and sizes. They never change, and are the same in every world.
    fn spec(&self) -> &Spec;

    /// Changes the row drawn from the bank into the one that the episode starts from: a posture, a place, a velocity. What
    /// follows from it is measured afterwards.
    ///
    /// # Errors
    /// The task's own reasons; they end the batch's call.
    fn place(&mut self, _scene: &Scene, _row: &mut Row, _random: &mut Random) -> Result<(), TaskError> {
        Ok(())
    }

    /// An episode begins. Forgets the one before.
    ///
    /// # Errors
    /// The task's own reasons; they end the batch's call.
    fn begin(&mut self, world: &World, random: &mut Random) -> Result<(), TaskError>;

    /// Reads an action (finite numbers within [`Spec::action_limit`]) as joint targets; may add wrenches and a push.
    fn command(&mut self, scene: &Scene, row: &Row, action: &[f32], random: &mut Random, control: &mut Control);

    /// Judges the row that the command led to, and writes what each term of the reward pays. A row that diverged ends the
    /// episode as a failure whatever this says.
    fn judge(&mut self, world: &World, random: &mut Random, reward_terms: &mut [f32]) -> Outcome;

    /// Writes the observation of a row.
    ///
    /// # Errors
    /// The task's own reasons, such as a camera that the robot lacks; they end the batch's call.
    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError>;
}

/// Copies a task; every task that is `Clone` has it.
pub trait TaskClone {
    /// A copy with the same state.
    fn boxed(&self) -> Box<dyn Task>;
}

impl<T: Task + Clone + 'static> TaskClone for T {
    fn boxed(&self) -> Box<dyn Task> {
        Box::new(self.clone())
    }
}

/// Names and sizes of what a task takes and gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Spec {
    /// Name of each number of an action.
    pub actions: Vec<String>,
    /// Where a learner looks for each of them: least, greatest. Actions may leave it.
    pub action_range: Vec<[f32; 2]>,
    /// Largest size of a number of an action; larger ones are refused.
    pub action_limit: f32,
    /// The parts of an observation, in order.
    pub observation: Vec<Field>,
    /// Name of each term of the reward.
    pub rewards: Vec<String>,
}

impl Spec {
    /// How many numbers an observation has.
    pub fn observation_length(&self) -> usize {
        self.observation.iter().map(Field::length).sum()
    }
}

/// A run of numbers of an observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Unique within the observation.
    pub name: String,
    /// Extents, the slowest first; none for a single number.
    pub shape: Vec<usize>,
    /// Least and greatest value.
    pub range: [f32; 2],
}

impl Field {
    /// A field of any size of number.
    pub fn new(name: impl Into<String>, shape: &[usize]) -> Self {
        Self { name: name.into(), shape: shape.into(), range: [f32::NEG_INFINITY, f32::INFINITY] }
    }

    /// A term of a sensor, each number of which is (measured + noise) x scale, measured within `range`. Terms of sensors that
    /// repeat others' names, or that no robot has, begin with the sensor's name.
    pub fn of_sensor(sensor: &str, term: &str, shape: &[usize], range: [f64; 2], noise: f64, scale: f64) -> Self {
        let name = match sensor {
            "flat" | "privileged" | "verdict" => format!("{sensor}.{term}"),
            _ => term.to_owned(),
        };
        let range = [range[0] - noise, range[1] + noise].map(|bound| (bound * scale) as f32);
        Self { name, shape: shape.into(), range }
    }

    /// How many numbers it has.
    pub fn length(&self) -> usize {
        self.shape.iter().product()
    }
}

/// What an action comes to in a world. The batch clears wrenches and push before each command; both arrays have a number a
/// joint.
#[derive(Debug, Clone, Default)]
pub struct Control {
    /// For the row's record, in action units: finite and within [`ACTION_LIMIT`](fiatlux_world::ACTION_LIMIT).
    pub action: Vec<f64>,
    /// rad, finite; beyond a joint's limits they are clamped to them.
    pub joint_target: Vec<f64>,
    /// Held over the control step; more than 8, those of [`Disturbances`](crate::Disturbances) among them, allocate.
    pub wrenches: Vec<AppliedWrench>,
    /// A sudden change of the robot's velocity.
    pub push: Option<Push>,
}

/// How an episode goes on after a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It goes on with another step.
    Continues,
    /// It ends: the goal is reached. Counts as terminated.
    Success,
    /// It ends: the goal is out of reach. Counts as terminated.
    Failure,
    /// It ends for want of time. Counts as truncated.
    TimeOut,
}
