//! The interface of tasks for the worlds of a batch.

use std::any::Any;
use std::collections::BTreeMap;

use fiatlux_rules::{End, Judges, Protocol, Row, Summary};
use fiatlux_sensing::{SensorSuite, View};
use fiatlux_world::{AppliedWrench, Light, Push, Random, Scene, World};

use crate::TaskError;

/// The verdicts of the benchmark's judges on an episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdicts {
    /// Of the published judge.
    pub published: Summary,
    /// Of the strict one; `None` for an episode that the published judge ends.
    pub strict: Option<Summary>,
    /// As in a bag: where the published judge would not have ended it, the end of the judge in force.
    pub end: Option<End>,
}

impl Verdicts {
    /// Of judges, as they are.
    pub fn of(judges: &Judges) -> Self {
        let published = judges.of(Protocol::Published).summary();
        let strict = (judges.protocol() == Protocol::Strict).then(|| judges.of(Protocol::Strict).summary());
        Self { published, strict, end: published.end.or(judges.in_force().verdict().end) }
    }
}

/// A task for the worlds of a batch: it gives actions a meaning, and defines observations, rewards and ends. Every
/// world has a copy, which may keep state from step to step; a [`Snapshot`](crate::Snapshot) includes it.
///
/// In a control step a world calls `command`, moves, and calls `judge`; if the episode continues, it calls `observe`.
/// If the episode ends, it calls `observe` (for the final observation, if wanted), `place`, `begin` and `observe` (for
/// the first one of the next episode). `world` is then at the row in question: [`World::row`],
/// [`World::world_from_link`].
///
/// Draw random numbers only from `random`, the world's own stream, so that results depend on nothing else.
pub trait Task: TaskClone + Send + Sync {
    /// Names and sizes. They never change, and are the same in every world.
    fn spec(&self) -> &Spec;

    /// Changes the row drawn from the bank into the start of the episode: a posture, a place, a velocity. Quantities
    /// that follow from these are measured afterwards.
    ///
    /// # Errors
    /// The task's own reasons; they end the batch's call.
    fn place(&mut self, _scene: &Scene, _row: &mut Row, _random: &mut Random) -> Result<(), TaskError> {
        Ok(())
    }

    /// Begins an episode, and forgets the last one. Only cameras see the light.
    ///
    /// # Errors
    /// The task's own reasons; they end the batch's call.
    fn begin(&mut self, world: &World, light: &Light, random: &mut Random) -> Result<(), TaskError>;

    /// Converts an action (finite numbers within [`Spec::action_limit`]) to joint targets; may add wrenches and a push.
    fn command(&mut self, scene: &Scene, row: &Row, action: &[f64], random: &mut Random, control: &mut Control);

    /// Judges the row that the command led to, and writes the value of each reward term. A row that diverged ends the
    /// episode as a failure, whatever this returns.
    fn judge(&mut self, world: &World, random: &mut Random, reward_terms: &mut [f32]) -> Outcome;

    /// Writes the observation of a row. The buffer has that of the row before it in the episode, so that a part which is not due can
    /// stay as it is; at row 0 it has anything.
    ///
    /// # Errors
    /// The task's own reasons, such as a camera that the robot lacks; they end the batch's call.
    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError>;

    /// The robot's sensors at a row, with the noise of the episode, for whoever asks more of them than the observation has; `None`
    /// for a task without sensors, or before its first episode.
    fn senses<'a>(&'a mut self, _scene: &'a Scene, _row: &'a Row) -> Option<(&'a mut SensorSuite, View<'a>)> {
        None
    }

    /// Writes the parts of these sensors again, whatever their rate. `row` is the present one, and the buffer has its observation.
    ///
    /// # Errors
    /// By default, that the task's observation has no sensors by name.
    fn look(
        &mut self,
        _scene: &Scene,
        _row: &Row,
        _sensors: &[String],
        _observation: &mut [f32],
    ) -> Result<(), TaskError> {
        Err("this task has no sensors to look at".into())
    }

    /// The benchmark's judges of the present episode; `None` for a task that they do not judge, and before the first episode.
    fn judges(&self) -> Option<&Judges> {
        None
    }

    /// Name and value of each quantity that it drew for the episode.
    fn drawn(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Name and value of each of its settings. A snapshot is restored only where all of them are equal.
    fn settings(&self) -> Vec<(&'static str, String)>;

    /// Saves the state of the episode, for a [`Snapshot`](crate::Snapshot).
    ///
    /// # Errors
    /// By default, that the task cannot be saved.
    fn save(&self) -> Result<Vec<u8>, TaskError> {
        Err("this task cannot be saved; implement Task::save and Task::load for it".into())
    }

    /// Continues exactly from what [`Task::save`] returned at this row, in the light of the episode. The bytes may be damaged.
    ///
    /// # Errors
    /// Bytes that another task saved, or that are damaged.
    fn load(&mut self, _saved: &[u8], _row: &Row, _light: &Light) -> Result<(), TaskError> {
        Err("this task cannot be restored; implement Task::save and Task::load for it".into())
    }

    /// Continues exactly as another task of the same settings and scene does, of which `saved` is what [`Task::save`] returned at this
    /// row. Copying one world into a thousand reads the bytes a thousand times unless a task overrides this.
    ///
    /// # Errors
    /// As for [`Task::load`].
    fn copy_from(&mut self, _other: &dyn Task, saved: &[u8], row: &Row, light: &Light) -> Result<(), TaskError> {
        self.load(saved, row, light)
    }
}

/// Copies a boxed task; implemented for every task that is `Clone`.
pub trait TaskClone {
    /// A copy with the same state.
    fn boxed(&self) -> Box<dyn Task>;

    /// The task itself, for [`Task::copy_from`].
    fn as_any(&self) -> &dyn Any;
}

impl<T: Task + Clone + 'static> TaskClone for T {
    fn boxed(&self) -> Box<dyn Task> {
        Box::new(self.clone())
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// Names and sizes of a task's actions, observations and rewards.
#[derive(Debug, Clone, PartialEq)]
pub struct Spec {
    /// Name of each number of an action.
    pub actions: Vec<String>,
    /// Range in which a learner should explore each number: least, greatest. Actions may exceed it.
    pub action_range: Vec<[f32; 2]>,
    /// Control steps after which an episode ends by time-out, if not before.
    pub horizon_steps: u64,
    /// Largest absolute value in an action; larger ones are refused.
    pub action_limit: f64,
    /// The parts of an observation, in order.
    pub observation: Vec<Field>,
    /// Name of each term of the reward.
    pub rewards: Vec<String>,
    /// Weight of each, as far as the caller can choose it.
    pub reward_weights: Vec<f64>,
}

impl Spec {
    /// Count of the words of 4 bytes in an observation: a number each, or four bytes of a picture.
    pub fn observation_length(&self) -> usize {
        self.observation.iter().map(Field::words).sum()
    }
}

/// Consecutive numbers of an observation. A picture's are bytes, four in each word of the observation, as they lie in memory; the last
/// word is filled up.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Name of the field, unique within the observation.
    pub name: String,
    /// Size of each dimension, slowest first; empty for a single number.
    pub shape: Vec<usize>,
    /// Least and greatest possible value.
    pub range: [f32; 2],
}

impl Field {
    /// A field with an unlimited range.
    pub fn new(name: impl Into<String>, shape: &[usize]) -> Self {
        Self { name: name.into(), shape: shape.into(), range: [f32::NEG_INFINITY, f32::INFINITY] }
    }

    /// A term of a sensor, whose numbers are (measured + noise) x scale, with measured values in `range`. Terms of
    /// sensors that repeat other sensors' names, or that no robot has, begin with the sensor's name.
    pub fn of_sensor(sensor: &str, term: &str, shape: &[usize], range: [f64; 2], noise: f64, scale: f64) -> Self {
        let name = match sensor {
            "flat" | "privileged" | "verdict" => format!("{sensor}.{term}"),
            _ => term.to_owned(),
        };
        let range = [range[0] - noise, range[1] + noise].map(|bound| (bound * scale) as f32);
        Self { name, shape: shape.into(), range }
    }

    /// Age of the numbers of a sensor that is not computed in every step, s, with the greatest possible one.
    pub fn of_age(sensor: &str, oldest: f64) -> Self {
        Self { name: format!("{sensor}.age"), shape: Vec::new(), range: [0.0, oldest as f32] }
    }

    /// True if the numbers are the bytes of a picture, from 0 to 255: height x width x 3, or height x width labels.
    pub fn is_picture(&self) -> bool {
        matches!(self.shape[..], [_, _, 3] | [_, _]) && self.range == [0.0, 255.0]
    }

    /// Count of numbers in the field.
    pub fn length(&self) -> usize {
        self.shape.iter().product()
    }

    /// Count of the words of 4 bytes that it takes in an observation.
    pub fn words(&self) -> usize {
        if self.is_picture() { self.length().div_ceil(size_of::<f32>()) } else { self.length() }
    }
}

/// The command of an action for a world. The batch clears wrenches and push before each command; both arrays have one
/// number for each joint.
#[derive(Debug, Clone, Default)]
pub struct Control {
    /// Action to record in the row, in action units: finite and within [`ACTION_LIMIT`](fiatlux_world::ACTION_LIMIT).
    pub action: Vec<f64>,
    /// Joint targets, rad, finite; they are clamped to the joints' limits.
    pub joint_target: Vec<f64>,
    /// Wrenches held over the control step; more than 8, including those of [`Disturbances`](crate::Disturbances),
    /// cause an allocation.
    pub wrenches: Vec<AppliedWrench>,
    /// A sudden change of the robot's velocity.
    pub push: Option<Push>,
}

/// Outcome of a step: the episode goes on or ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The episode goes on with another step.
    Continues,
    /// The episode ends because the goal is reached. Counts as terminated.
    Success,
    /// The episode ends because the goal is out of reach. Counts as terminated.
    Failure,
    /// The episode ends by time-out. Counts as truncated.
    TimeOut,
}

/// Refuses weights of terms that a reward does not have, and weights that are not finite.
pub(crate) fn check_weights<'a>(
    given: &BTreeMap<String, f64>,
    terms: impl Iterator<Item = &'a str> + Clone,
) -> Result<(), TaskError> {
    for (name, weight) in given {
        if !terms.clone().any(|term| term == name) {
            let terms: Vec<_> = terms.collect();
            return Err(format!("the reward has no term {name:?}; the terms are {}", terms.join(", ")).into());
        }
        if !weight.is_finite() {
            return Err(format!("the weight of {name:?} is {weight}; give a finite one").into());
        }
    }
    Ok(())
}
