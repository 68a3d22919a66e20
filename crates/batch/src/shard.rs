//! The worlds of one thread.

use std::ops::Range;
use std::sync::Arc;

use fiatlux_rules::Row;
use fiatlux_world::World;

use crate::slot::{ReadyBank, Results, Shared, Slot, Stage};
use crate::snapshot::WorldState;
use crate::{BatchError, Control, Outcome, Outputs, Snapshot, Spec};

/// What a thread should do with its worlds.
#[derive(Debug, Clone)]
pub(crate) enum Order {
    /// Begin an episode in each world, as its `begins` says.
    Reset,
    /// Continue each world that is marked from the one world of a snapshot.
    Load(Arc<Snapshot>),
    /// End the episode of each world that is marked.
    End,
    /// Take a control step in each world, with its actions.
    Step {
        /// Whether to observe the last rows of episodes too.
        wants_final: bool,
    },
}

/// Where the next episode of a world begins.
#[derive(Debug, Clone, Default)]
pub enum Begin {
    /// Nowhere: the present one goes on.
    #[default]
    Stays,
    /// At a start of its bank.
    AtStart,
    /// At a row of its scene, which becomes row 0: of another world, of a bag, or made by hand. Mass, friction and light are those of
    /// a start of its bank.
    AtRow(Box<Row>),
}

/// The worlds of one thread, and where they take turns: one [`World`] for each of their scenes, which stays in the cache.
pub(crate) struct Shard {
    /// Index of its first world in the batch.
    pub first: usize,
    pub slots: Vec<Slot>,
    pub order: Order,
    pub begins: Vec<Begin>,
    pub is_marked: Vec<bool>,
    pub actions: Vec<f64>,
    pub outputs: Outputs,
    pub error: Option<BatchError>,
    stages: Vec<Stage>,
    shared: Arc<Shared>,
    control: Control,
}

impl Shard {
    /// `bank_of` has the bank of each world of the batch; `slot` makes a world on one of the shard's stages.
    pub fn new(
        worlds: Range<usize>,
        spec: &Spec,
        banks: &[Arc<ReadyBank>],
        shared: Arc<Shared>,
        bank_of: impl Fn(usize) -> usize,
        slot: impl Fn(usize, usize, &ReadyBank) -> Slot,
    ) -> Self {
        let (mut stages, mut slots) = (Vec::<Stage>::new(), Vec::with_capacity(worlds.len()));
        for world in worlds.clone() {
            let bank = &banks[bank_of(world)];
            if !stages.last().is_some_and(|stage| Arc::ptr_eq(&stage.bank, bank)) {
                stages.push(Stage { bank: Arc::clone(bank), world: World::new(Arc::clone(&bank.scene)) });
            }
            slots.push(slot(world, stages.len() - 1, bank));
        }
        let joints = banks[0].scene.robot_layout().joints;
        Self {
            first: worlds.start,
            order: Order::Reset,
            begins: vec![Begin::AtStart; worlds.len()],
            is_marked: vec![false; worlds.len()],
            actions: vec![0.0; worlds.len() * spec.actions.len()],
            outputs: Outputs::of(spec, worlds.len()),
            error: None,
            stages,
            shared,
            control: Control {
                action: vec![0.0; joints],
                joint_target: vec![0.0; joints],
                wrenches: Vec::with_capacity(8),
                push: None,
            },
            slots,
        }
    }

    /// Carries out the order, as long as it may continue. Stops at the first world that fails.
    pub fn run(&mut self, mut may_go_on: impl FnMut() -> bool) {
        let mut worlds = 0..self.slots.len();
        let order = self.order.clone();
        let done = worlds.try_for_each(|index| match (may_go_on(), &order) {
            (false, _) => Err(BatchError::Stopped),
            (true, Order::Reset) => self.begin(index),
            (true, Order::Load(snapshot)) => self.copy(index, snapshot),
            (true, Order::End) => self.end(index),
            (true, Order::Step { wants_final }) => self.step(index, *wants_final),
        });
        self.error = done.err();
    }

    /// Begins an episode in one world, if it is due; its observation is in the outputs.
    fn begin(&mut self, index: usize) -> Result<(), BatchError> {
        let row = match std::mem::take(&mut self.begins[index]) {
            Begin::Stays => return Ok(()),
            Begin::AtStart => None,
            Begin::AtRow(row) => Some(row),
        };
        let slot = &mut self.slots[index];
        let observation = part(&mut self.outputs.observation, index, self.outputs.reward.len());
        let begun = slot.begin(&mut self.stages[slot.stage], &self.shared, row.as_deref(), observation);
        begun.map_err(|stopped| stopped.at(self.first + index))
    }

    /// Copies its worlds' observations to their places among those of all worlds.
    pub fn copy_observation(&self, observation: &mut [f32]) {
        let numbers = &self.outputs.observation;
        let first = self.first * (numbers.len() / self.slots.len());
        observation[first..first + numbers.len()].copy_from_slice(numbers);
    }

    /// Continues one world from a state; its observation is not changed.
    pub fn load(&mut self, index: usize, state: &WorldState) -> Result<(), BatchError> {
        let (slot, world) = (&mut self.slots[index], self.first + index);
        let bank = &self.stages[slot.stage].bank;
        slot.load(state, bank).map_err(|source| BatchError::Task { world, source })
    }

    /// Continues one world from a snapshot of one, if it is marked.
    fn copy(&mut self, index: usize, snapshot: &Snapshot) -> Result<(), BatchError> {
        if self.is_marked[index] {
            self.load(index, &snapshot.worlds[0])?;
            part(&mut self.outputs.observation, index, self.slots.len()).copy_from_slice(&snapshot.observation);
        }
        Ok(())
    }

    /// Ends the episode of one world, if it is marked.
    fn end(&mut self, index: usize) -> Result<(), BatchError> {
        if !self.is_marked[index] {
            return Ok(());
        }
        let slot = &mut self.slots[index];
        let observation = part(&mut self.outputs.observation, index, self.outputs.reward.len());
        let ended = slot.end(&mut self.stages[slot.stage], &self.shared, observation);
        ended.map_err(|stopped| stopped.at(self.first + index))
    }

    fn step(&mut self, index: usize, wants_final: bool) -> Result<(), BatchError> {
        let worlds = self.slots.len();
        let slot = &mut self.slots[index];
        let outputs = &mut self.outputs;
        let results = Results {
            observation: part(&mut outputs.observation, index, worlds),
            final_observation: wants_final.then(|| part(&mut outputs.final_observation, index, worlds)),
            reward_terms: part(&mut outputs.reward_terms, index, worlds),
        };
        let action = part(&mut self.actions, index, worlds);
        let stage = &mut self.stages[slot.stage];
        let stepped = slot.step(stage, &self.shared, action, &mut self.control, results);
        let (outcome, reward) = stepped.map_err(|stopped| stopped.at(self.first + index))?;
        outputs.reward[index] = reward;
        outputs.terminated[index] = matches!(outcome, Outcome::Success | Outcome::Failure);
        outputs.truncated[index] = outcome == Outcome::TimeOut;
        outputs.success[index] = outcome == Outcome::Success;
        Ok(())
    }
}

/// A world's part of an array that is world by world.
pub(crate) fn part<T>(array: &mut [T], world: usize, worlds: usize) -> &mut [T] {
    let each = array.len() / worlds;
    &mut array[world * each..][..each]
}
