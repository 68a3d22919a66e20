//! One world of a batch.

use std::sync::Arc;

use fiatlux_dynamics::PreparedVariation;
use fiatlux_rules::{Row, diverged};
use fiatlux_world::{ControlInput, Random, Scene, World, WorldError};

use crate::disturbance::Disturber;
use crate::{Bank, BatchError, Control, Disturbances, Outcome, Task, TaskError};

/// A prepared bank, shared by all threads.
#[derive(Debug)]
pub(crate) struct ReadyBank {
    pub scene: Arc<Scene>,
    pub starts: Vec<ReadyStart>,
}

#[derive(Debug)]
pub(crate) struct ReadyStart {
    row: Row,
    variation: PreparedVariation,
}

impl ReadyBank {
    /// Tries every start. Equal variations in a row are prepared once.
    pub fn new(bank: &Bank, index: usize) -> Result<Self, BatchError> {
        let mut world = World::new(Arc::clone(&bank.scene));
        let mut starts: Vec<ReadyStart> = Vec::with_capacity(bank.starts.len());
        for (number, start) in bank.starts.iter().enumerate() {
            let before =
                number.checked_sub(1).map(|before| (&bank.starts[before].variation, &starts[before].variation));
            let variation = match before {
                Some((variation, ready)) if *variation == start.variation => Ok(ready.clone()),
                _ => start.variation.prepare(&bank.scene.model).map_err(WorldError::from),
            };
            let refused = |source| BatchError::Start { bank: index, start: number, source };
            let mut row = start.row.clone();
            row.step = 0;
            world.reset_to(&row).map_err(refused)?;
            starts.push(ReadyStart { row, variation: variation.map_err(refused)? });
        }
        Ok(Self { scene: Arc::clone(&bank.scene), starts })
    }
}

/// Where the worlds of one bank and one thread take turns.
pub(crate) struct Stage {
    pub bank: Arc<ReadyBank>,
    pub world: World,
}

/// The state of a world while others have their turn.
pub(crate) struct Slot {
    /// Index into the stages of its thread.
    pub stage: usize,
    row: Row,
    variation: PreparedVariation,
    task: Box<dyn Task>,
    random: Random,
    disturber: Disturber,
}

impl Clone for Slot {
    fn clone(&self) -> Self {
        Self {
            stage: self.stage,
            row: self.row.clone(),
            variation: self.variation.clone(),
            task: self.task.boxed(),
            random: self.random.clone(),
            disturber: self.disturber.clone(),
        }
    }
}

/// Why a world stopped in the middle of something.
pub(crate) enum Stopped {
    World(WorldError),
    Task(TaskError),
}

impl Stopped {
    pub fn at(self, world: usize) -> BatchError {
        match self {
            Self::World(source) => BatchError::World { world, source },
            Self::Task(source) => BatchError::Task { world, source },
        }
    }
}

impl From<WorldError> for Stopped {
    fn from(error: WorldError) -> Self {
        Self::World(error)
    }
}

impl From<TaskError> for Stopped {
    fn from(error: TaskError) -> Self {
        Self::Task(error)
    }
}

/// Buffers for the results of one world.
pub(crate) struct Results<'a> {
    pub observation: &'a mut [f32],
    /// Buffer for the observation of an episode's last row, if wanted.
    pub final_observation: Option<&'a mut [f32]>,
    pub reward_terms: &'a mut [f32],
}

impl Slot {
    pub fn new(stage: usize, bank: &ReadyBank, task: &dyn Task, random: Random) -> Self {
        Self {
            stage,
            row: Row::zeros(bank.scene.robot_layout()),
            variation: PreparedVariation::default(),
            task: task.boxed(),
            random,
            disturber: Disturber::default(),
        }
    }

    pub fn row(&self) -> &Row {
        &self.row
    }

    pub fn reseed(&mut self, random: Random) {
        self.random = random;
    }

    /// Begins an episode from a start of the bank, or from a given row.
    pub fn begin(
        &mut self,
        stage: &mut Stage,
        disturbances: &Disturbances,
        row: Option<&Row>,
        observation: &mut [f32],
    ) -> Result<(), Stopped> {
        let Stage { bank, world } = stage;
        let start = &bank.starts[self.random.index(bank.starts.len())];
        self.row.clone_from(row.unwrap_or(&start.row));
        self.row.step = 0;
        self.variation.clone_from(&start.variation);
        self.task.place(&bank.scene, &mut self.row, &mut self.random)?;
        world.vary(&self.variation);
        world.reset_to(&self.row)?;
        self.row.clone_from(world.row());
        self.disturber.begin(disturbances, &mut self.random);
        self.task.begin(world, &mut self.random)?;
        Ok(self.task.observe(world, observation)?)
    }

    /// Takes a control step, and begins the next episode where this one ends.
    pub fn step(
        &mut self,
        stage: &mut Stage,
        disturbances: &Disturbances,
        action: &[f32],
        control: &mut Control,
        results: Results<'_>,
    ) -> Result<(Outcome, f32), Stopped> {
        let Results { observation, final_observation, reward_terms } = results;
        control.wrenches.clear();
        control.push = None;
        self.task.command(&stage.bank.scene, &self.row, action, &mut self.random, control);
        self.disturber.act(disturbances, &mut self.random, control);
        let Control { action, joint_target, wrenches, push } = &*control;
        stage.world.vary(&self.variation);
        let input = ControlInput { action, joint_target, wrenches, push: *push };
        stage.world.step_row(&mut self.row, &input)?;
        let judged = self.task.judge(&stage.world, &mut self.random, reward_terms);
        let outcome = if diverged(&self.row) { Outcome::Failure } else { judged };
        // As in the rulebook, a reward that is not finite pays nothing.
        reward_terms.iter_mut().filter(|term| !term.is_finite()).for_each(|term| *term = 0.0);
        let reward = reward_terms.iter().map(|term| f64::from(*term)).sum::<f64>() as f32;
        if outcome == Outcome::Continues {
            self.task.observe(&stage.world, observation)?;
        } else {
            if let Some(final_observation) = final_observation {
                self.task.observe(&stage.world, final_observation)?;
            }
            self.begin(stage, disturbances, None, observation)?;
        }
        Ok((outcome, reward))
    }
}
