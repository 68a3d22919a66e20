//! One world of a batch.

use std::sync::Arc;

use fiatlux_dynamics::{Contact, PreparedVariation, Site};
use fiatlux_rules::{Row, diverged};
use fiatlux_sensing::{SensorSuite, View};
use fiatlux_world::{ControlInput, Light, Random, Scene, Stream, World, WorldError};

use crate::disturbance::Disturber;
use crate::possible::{check_height, check_row};
use crate::snapshot::WorldState;
use crate::{Autoreset, Bank, BatchError, Control, Disturbances, Drawn, Outcome, Task, TaskError, Verdicts, Watch};

/// A prepared bank, shared by all threads.
#[derive(Debug)]
pub(crate) struct ReadyBank {
    pub scene: Arc<Scene>,
    pub starts: Vec<ReadyStart>,
    /// The links that are watched.
    sites: Vec<Site>,
    /// Sum of the weights up to and including each start; `None` where all weigh the same.
    sums: Option<Vec<f64>>,
}

#[derive(Debug)]
pub(crate) struct ReadyStart {
    row: Row,
    variation: PreparedVariation,
    light: Light,
    drawn: Drawn,
}

impl ReadyBank {
    /// Tries every start. Equal variations in a row are prepared once.
    pub fn new(bank: &Bank, index: usize, effort_factor: f64, watch: &Watch) -> Result<Self, BatchError> {
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
            let impossible = |problem| BatchError::StartRow { bank: index, start: number, problem };
            let mut row = start.row.clone();
            row.step = 0;
            check_row(&bank.scene, &row, effort_factor).map_err(impossible)?;
            world.reset_to(&row).map_err(refused)?;
            check_height(&world).map_err(impossible)?;
            let (light, mut drawn) = (start.light, start.drawn.clone());
            drawn.extend(light_by_name(&light).map(|(name, number)| (name.to_owned(), vec![number])));
            starts.push(ReadyStart { row, variation: variation.map_err(refused)?, light, drawn });
        }
        let weights = bank.starts.iter().map(|start| start.weight);
        let sums = weights.clone().scan(0.0, |sum, weight| {
            *sum += weight;
            Some(*sum)
        });
        let is_even = weights.clone().all(|weight| weight == bank.starts[0].weight);
        let sums = (!is_even).then(|| sums.collect());
        Ok(Self { scene: Arc::clone(&bank.scene), starts, sites: watch.sites(&bank.scene)?, sums })
    }

    fn draw(&self, random: &mut Random) -> usize {
        let Some(sums) = &self.sums else { return random.index(self.starts.len()) };
        let at = random.uniform(0.0, sums[sums.len() - 1]);
        sums.partition_point(|sum| *sum <= at).min(sums.len() - 1)
    }
}

fn light_by_name(light: &Light) -> [(&'static str, f64); 8] {
    let Light { dome, dome_yaw, key, key_pitch, key_yaw, tint_hue, tint_saturation, tint_value } = *light;
    [
        ("light.dome", dome),
        ("light.dome_yaw", dome_yaw),
        ("light.key", key),
        ("light.key_pitch", key_pitch),
        ("light.key_yaw", key_yaw),
        ("light.tint_hue", tint_hue),
        ("light.tint_saturation", tint_saturation),
        ("light.tint_value", tint_value),
    ]
}

/// Where the worlds of one bank and one thread take turns.
pub(crate) struct Stage {
    pub bank: Arc<ReadyBank>,
    pub world: World,
}

/// Shared by all worlds of a batch.
pub(crate) struct Shared {
    pub disturbances: Disturbances,
    pub autoreset: Autoreset,
    pub watch: Watch,
    /// Count of the numbers that a task observes.
    pub observation_length: usize,
}

/// The state of a world while others have their turn.
pub(crate) struct Slot {
    /// Index of its bank.
    pub bank: usize,
    /// The last step ended the episode, and the next one has not begun.
    pub has_ended: bool,
    row: Row,
    /// Index into the starts of its bank.
    start: usize,
    /// By how many steps the present episode ends earlier by time-out.
    shortened: u64,
    task: Box<dyn Task>,
    /// Seed and number of its random stream.
    stream: (u64, u64),
    random: Random,
    disturber: Disturber,
}

/// Parts that copies of a world take over as they are, in place of reading it from a snapshot.
pub(crate) struct Original {
    task: Box<dyn Task>,
    random: Random,
}

/// Why a world stopped in the middle of something.
pub(crate) enum Stopped {
    World(WorldError),
    /// A row to begin at that no episode reaches.
    Row(String),
    Task(TaskError),
}

impl Stopped {
    pub fn at(self, world: usize) -> BatchError {
        match self {
            Self::World(source) => BatchError::World { world, source },
            Self::Row(problem) => BatchError::Row { world, problem },
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
    /// Empty list for the observation of an episode's last row, if wanted.
    pub final_observation: Option<&'a mut Vec<f32>>,
    pub reward_terms: &'a mut [f32],
    /// Contact points of the step, if wanted.
    pub contacts: Option<&'a mut Vec<Contact>>,
    /// The benchmark's verdicts on an episode that the step ended.
    pub verdicts: &'a mut Option<Verdicts>,
}

impl Slot {
    pub fn new(bank: usize, ready: &ReadyBank, task: &dyn Task, seed: u64, world: usize) -> Self {
        Self {
            bank,
            has_ended: false,
            row: Row::zeros(ready.scene.robot_layout()),
            start: 0,
            shortened: 0,
            task: task.boxed(),
            stream: (seed, world as u64),
            random: Random::new(Stream::Batch, seed, world as u64),
            disturber: Disturber::default(),
        }
    }

    /// The sensors at its row.
    pub fn senses<'a>(&'a mut self, scene: &'a Scene) -> Option<(&'a mut SensorSuite, View<'a>)> {
        self.task.senses(scene, &self.row)
    }

    pub fn row(&self) -> &Row {
        &self.row
    }

    /// Values drawn for the present episode, in this bank.
    pub fn drawn(&self, bank: &ReadyBank) -> Drawn {
        let own = self.task.drawn().into_iter().map(|(name, number)| (name.to_owned(), vec![number]));
        bank.starts[self.start].drawn.clone().into_iter().chain(own).collect()
    }

    pub fn light(&self, bank: &ReadyBank) -> Light {
        bank.starts[self.start].light
    }

    /// Begins its random stream anew; the number is that of the world, but for copies of another one.
    pub fn reseed(&mut self, seed: u64, number: u64) {
        (self.stream, self.random) = ((seed, number), Random::new(Stream::Batch, seed, number));
    }

    /// Ends the present episode; the next one begins as the batch's autoreset says.
    pub fn end(&mut self, stage: &mut Stage, shared: &Shared, observation: &mut [f32]) -> Result<(), Stopped> {
        self.has_ended = true;
        match shared.autoreset {
            Autoreset::SameStep => self.begin(stage, shared, None, observation),
            Autoreset::NextStep | Autoreset::Disabled => Ok(()),
        }
    }

    /// Lets the present episode end by time-out this many steps earlier.
    pub fn shorten(&mut self, steps: u64) {
        self.shortened = steps;
    }

    /// Its state, for a snapshot.
    pub fn save(&self) -> Result<WorldState, TaskError> {
        Ok(WorldState {
            row: self.row.clone(),
            start: self.start,
            has_ended: self.has_ended,
            shortened: self.shortened,
            stream: self.stream,
            drawn: self.random.drawn(),
            disturber: self.disturber.clone(),
            task: self.task.save()?,
        })
    }

    /// A copy with the same state.
    pub fn twin(&self) -> Self {
        Self {
            bank: self.bank,
            has_ended: self.has_ended,
            row: self.row.clone(),
            start: self.start,
            shortened: self.shortened,
            task: self.task.boxed(),
            stream: self.stream,
            random: self.random.clone(),
            disturber: self.disturber.clone(),
        }
    }

    pub fn original(&self) -> Original {
        Original { task: self.task.boxed(), random: self.random.clone() }
    }

    /// Continues from a state of a world of the same bank.
    pub fn load(&mut self, state: &WorldState, bank: &ReadyBank) -> Result<(), TaskError> {
        let start = bank.starts.get(state.start).ok_or("the snapshot is damaged: the world's start does not exist")?;
        if !state.row.fits(bank.scene.robot_layout()) {
            return Err("the snapshot is damaged: the row is of another robot".into());
        }
        self.task.load(&state.task, &state.row, &start.light)?;
        let (seed, number) = state.stream;
        self.reseed(seed, number);
        self.random.skip(state.drawn);
        self.take_over(state);
        Ok(())
    }

    /// As [`Slot::load`], from the world of which the state is.
    pub fn copy_from(&mut self, state: &WorldState, original: &Original, bank: &ReadyBank) -> Result<(), TaskError> {
        self.task.copy_from(&*original.task, &state.task, &state.row, &bank.starts[state.start].light)?;
        (self.stream, self.random) = (state.stream, original.random.clone());
        self.take_over(state);
        Ok(())
    }

    fn take_over(&mut self, state: &WorldState) {
        self.row.clone_from(&state.row);
        (self.start, self.has_ended, self.shortened) = (state.start, state.has_ended, state.shortened);
        self.disturber.clone_from(&state.disturber);
    }

    /// Begins an episode from a start of the bank, or from a given row.
    pub fn begin(
        &mut self,
        stage: &mut Stage,
        shared: &Shared,
        row: Option<&Row>,
        observation: &mut [f32],
    ) -> Result<(), Stopped> {
        let Stage { bank, world } = stage;
        self.start = bank.draw(&mut self.random);
        (self.has_ended, self.shortened) = (false, 0);
        let start = &bank.starts[self.start];
        self.row.clone_from(row.unwrap_or(&start.row));
        self.row.step = 0;
        self.task.place(&bank.scene, &mut self.row, &mut self.random)?;
        world.vary(&start.variation);
        world.reset_to(&self.row)?;
        if row.is_some() {
            check_height(world).map_err(Stopped::Row)?;
        }
        self.row.clone_from(world.row());
        self.disturber.begin(&shared.disturbances, &mut self.random);
        self.task.begin(world, &start.light, &mut self.random)?;
        self.observe(stage, shared, observation)
    }

    fn observe(&mut self, stage: &Stage, shared: &Shared, observation: &mut [f32]) -> Result<(), Stopped> {
        let (task, rest) = observation.split_at_mut(shared.observation_length);
        self.task.observe(&stage.world, task)?;
        shared.watch.observe(&stage.world, &stage.bank.sites, rest);
        Ok(())
    }

    /// Looks with these sensors at the present row.
    pub fn look(
        &mut self,
        bank: &ReadyBank,
        shared: &Shared,
        sensors: &[String],
        observation: &mut [f32],
    ) -> Result<(), Stopped> {
        let task = &mut observation[..shared.observation_length];
        Ok(self.task.look(&bank.scene, &self.row, sensors, task)?)
    }

    /// Takes a control step; where an episode ends, the next one begins as the batch's autoreset says.
    pub fn step(
        &mut self,
        stage: &mut Stage,
        shared: &Shared,
        action: &[f64],
        control: &mut Control,
        results: Results<'_>,
    ) -> Result<(Outcome, f32), Stopped> {
        let Results { observation, final_observation, reward_terms, contacts, verdicts } = results;
        *verdicts = None;
        if self.has_ended {
            reward_terms.fill(0.0);
            self.begin(stage, shared, None, observation)?;
            return Ok((Outcome::Continues, 0.0));
        }
        control.wrenches.clear();
        control.push = None;
        self.task.command(&stage.bank.scene, &self.row, action, &mut self.random, control);
        self.disturber.act(&shared.disturbances, &mut self.random, control);
        let Control { action, joint_target, wrenches, push } = &*control;
        stage.world.vary(&stage.bank.starts[self.start].variation);
        let input = ControlInput { action, joint_target, wrenches, push: *push };
        stage.world.step_row(&mut self.row, &input)?;
        contacts.into_iter().for_each(|contacts| contacts.extend_from_slice(stage.world.dynamics().contacts()));
        let judged = self.task.judge(&stage.world, &mut self.random, reward_terms);
        let outcome = match judged {
            _ if diverged(&self.row) => Outcome::Failure,
            Outcome::Continues if self.row.step + self.shortened >= self.task.spec().horizon_steps => Outcome::TimeOut,
            judged => judged,
        };
        // As in the rulebook, a reward that is not finite pays nothing.
        reward_terms.iter_mut().filter(|term| !term.is_finite()).for_each(|term| *term = 0.0);
        let reward = reward_terms.iter().map(|term| f64::from(*term)).sum::<f64>() as f32;
        self.has_ended = outcome != Outcome::Continues;
        if self.has_ended {
            *verdicts = self.task.judges().map(Verdicts::of);
        }
        if self.has_ended && shared.autoreset == Autoreset::SameStep {
            if let Some(final_observation) = final_observation {
                // Parts that are not due stay as they were.
                final_observation.extend_from_slice(observation);
                self.observe(stage, shared, final_observation)?;
            }
            self.begin(stage, shared, None, observation)?;
        } else {
            self.observe(stage, shared, observation)?;
        }
        Ok((outcome, reward))
    }
}
