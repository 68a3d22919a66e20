//! Many worlds in step.

use std::sync::Arc;

use fiatlux_rules::Row;
use fiatlux_world::{Random, Scene, Stream};

use crate::buffers::check_length;
use crate::shard::{Order, Shard, part};
use crate::slot::{ReadyBank, Slot};
use crate::workers::Workers;
use crate::{Bank, BatchError, Buffers, Disturbances, Spec, Task};

/// Settings of a batch.
#[derive(Debug, Clone)]
pub struct BatchConfig {
    /// Number of worlds that each call steps.
    pub worlds: usize,
    /// Number of threads, including the caller's; at most one for each world. Results do not depend on it.
    pub threads: usize,
    /// Seed of the worlds' random streams.
    pub seed: u64,
    /// Starts of the worlds, all with the same robot. The worlds are spread evenly over the banks, in order, and a
    /// world stays in its bank's scene: there must be at least as many worlds as banks.
    pub banks: Vec<Bank>,
    /// Forces and pushes on the robots from outside.
    pub disturbances: Disturbances,
}

impl BatchConfig {
    /// One world for each bank, on the caller's thread, without disturbances.
    pub fn new(banks: Vec<Bank>) -> Self {
        Self { worlds: banks.len(), threads: 1, seed: 0, banks, disturbances: Disturbances::default() }
    }
}

/// Many worlds in step; see the crate's documentation. It keeps its threads, which sleep between calls, until it is dropped.
pub struct Batch {
    worlds: usize,
    spec: Arc<Spec>,
    banks: Vec<Arc<ReadyBank>>,
    workers: Workers,
    torn: bool,
}

/// A batch's state: [`Batch::restore`] continues from it exactly, on any number of threads.
#[derive(Clone)]
pub struct Snapshot {
    slots: Vec<Slot>,
    observation: Vec<f32>,
    spec: Arc<Spec>,
    banks: Vec<Arc<ReadyBank>>,
}

impl std::fmt::Debug for Batch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Batch").field("worlds", &self.worlds).field("threads", &self.threads()).finish_non_exhaustive()
    }
}

impl std::fmt::Debug for Snapshot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Snapshot").field("worlds", &self.slots.len()).finish_non_exhaustive()
    }
}

impl Batch {
    /// Makes worlds that each play a copy of the task. Each is at the start of an episode; [`Batch::reset`] writes its
    /// observation.
    ///
    /// # Errors
    /// [`BatchError`]: an invalid config, a start from which no world can start, or a task that cannot begin.
    pub fn new(config: BatchConfig, task: &dyn Task) -> Result<Self, BatchError> {
        let BatchConfig { worlds, threads, seed, banks, disturbances } = config;
        let refuse = |field, found, rule| Err(BatchError::Config { field, found, rule });
        match (worlds, threads, banks.len()) {
            (0, ..) => return refuse("worlds", 0, "give at least one"),
            (_, 0, _) => return refuse("threads", 0, "give at least one"),
            (.., 0) => return refuse("banks", 0, "give at least one"),
            (.., banks) if banks > worlds => return refuse("banks", banks, "give at least as many worlds as banks"),
            _ => {}
        }
        if banks.iter().any(|bank| bank.starts.is_empty()) {
            return refuse("bank.starts", 0, "give each bank a row to start from");
        }
        let expected = banks[0].scene.robot_layout();
        let odd = banks.iter().position(|bank| bank.scene.robot_layout() != expected);
        if let Some(bank) = odd {
            return Err(BatchError::Robots { bank, found: banks[bank].scene.robot_layout(), expected });
        }
        disturbances.check(banks[0].scene.robot.links().len())?;
        let ready = banks.iter().enumerate().map(|(index, bank)| ReadyBank::new(bank, index).map(Arc::new));
        let banks = ready.collect::<Result<Vec<_>, _>>()?;
        let (spec, disturbances) = (Arc::new(task.spec().clone()), Arc::new(disturbances));
        let threads = threads.min(worlds);
        let shard = |thread: usize| {
            let range = thread * worlds / threads..(thread + 1) * worlds / threads;
            let slot = |world, stage, bank: &ReadyBank| Slot::new(stage, bank, task, stream(seed, world));
            let bank_of = |world| world * banks.len() / worlds;
            Shard::new(range, &spec, &banks, Arc::clone(&disturbances), bank_of, slot)
        };
        let workers = Workers::new((0..threads).map(shard).collect())?;
        let mut batch = Self { worlds, spec, banks, workers, torn: false };
        batch.carry_out(Order::Reset, &[], &mut || true, |_| {})?;
        Ok(batch)
    }

    /// Number of worlds in the batch.
    pub fn worlds(&self) -> usize {
        self.worlds
    }

    /// Number of threads that step the worlds, including the caller's.
    pub fn threads(&self) -> usize {
        self.workers.len()
    }

    /// Names and sizes of actions, observations and rewards.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// The scene of a world; `None` if the world does not exist.
    pub fn scene(&self, world: usize) -> Option<&Arc<Scene>> {
        (world < self.worlds).then(|| &self.banks[world * self.banks.len() / self.worlds].scene)
    }

    /// Begins an episode in every world and writes the observations.
    ///
    /// # Errors
    /// [`BatchError`]: a buffer of another length, or a task that cannot begin.
    pub fn reset(&mut self, observation: &mut [f32]) -> Result<(), BatchError> {
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        self.carry_out(Order::Reset, &[], &mut || true, |shard| {
            let numbers = &shard.outputs.observation;
            let first = shard.first * (numbers.len() / shard.slots.len());
            observation[first..first + numbers.len()].copy_from_slice(numbers);
        })
    }

    /// As [`Batch::reset`], after restarting each world's random stream from this seed: everything that follows is as
    /// in a new batch.
    ///
    /// # Errors
    /// As for [`Batch::reset`].
    pub fn reset_with_seed(&mut self, seed: u64, observation: &mut [f32]) -> Result<(), BatchError> {
        self.workers.each(|shard| {
            for (index, slot) in shard.slots.iter_mut().enumerate() {
                slot.reseed(stream(seed, shard.first + index));
            }
        });
        self.reset(observation)
    }

    /// Begins an episode in one world: from a start of its bank, or from a row of its scene, of this or another world.
    /// `observation` is that world's part.
    ///
    /// # Errors
    /// [`BatchError`]: no such world, a buffer of another length, a row that makes no world, a task that cannot begin.
    pub fn reset_world(&mut self, world: usize, row: Option<&Row>, observation: &mut [f32]) -> Result<(), BatchError> {
        if world >= self.worlds {
            return Err(BatchError::NoWorld { world, worlds: self.worlds });
        }
        if self.torn {
            return Err(BatchError::Torn);
        }
        check_length("observation", observation.len(), self.spec.observation_length())?;
        let mut begun = Ok(());
        self.workers.each(|shard| {
            if let Some(index) = world.checked_sub(shard.first).filter(|index| *index < shard.slots.len()) {
                begun = shard.begin(index, row);
                let worlds = shard.slots.len();
                observation.copy_from_slice(part(&mut shard.outputs.observation, index, worlds));
            }
        });
        self.torn = begun.is_err();
        begun
    }

    /// Takes a control step in every world: actions are in the order of worlds, and results go into the buffers. If an
    /// episode ends, the next one begins in the same step.
    ///
    /// # Errors
    /// [`BatchError`]: buffers of another length, or an action that is not finite or too large, in which case nothing
    /// has changed; or a task that failed in the middle of the step, after which the batch must be reset.
    pub fn step(&mut self, actions: &[f32], buffers: &mut Buffers<'_>) -> Result<(), BatchError> {
        self.step_while(&mut || true, actions, buffers)
    }

    /// As [`Batch::step`], as long as `may_go_on` returns true: it is called before each world that the caller's thread
    /// steps. If it returns false, the batch must be reset, or restored from a snapshot.
    ///
    /// # Errors
    /// As for [`Batch::step`]; [`BatchError::Stopped`] if the step was broken off.
    pub fn step_while(
        &mut self,
        may_go_on: &mut dyn FnMut() -> bool,
        actions: &[f32],
        buffers: &mut Buffers<'_>,
    ) -> Result<(), BatchError> {
        if self.torn {
            return Err(BatchError::Torn);
        }
        buffers.check(&self.spec, self.worlds)?;
        self.check_actions(actions)?;
        let order = Order::Step { wants_final: buffers.final_observation.is_some() };
        self.carry_out(order, actions, may_go_on, |shard| buffers.copy_from(&shard.outputs, shard.first))
    }

    /// A copy of a world's row; `None` if the world does not exist.
    pub fn row(&self, world: usize) -> Option<Row> {
        let mut row = None;
        self.workers.each(|shard| {
            let index = world.checked_sub(shard.first);
            row = row.take().or(index.and_then(|index| shard.slots.get(index)).map(|slot| slot.row().clone()));
        });
        row
    }

    /// The state of all worlds, between two steps.
    pub fn save(&self) -> Snapshot {
        let (mut slots, mut observation) = (Vec::with_capacity(self.worlds), Vec::new());
        self.workers.each(|shard| {
            slots.extend(shard.slots.iter().cloned());
            observation.extend_from_slice(&shard.outputs.observation);
        });
        Snapshot { slots, observation, spec: Arc::clone(&self.spec), banks: self.banks.clone() }
    }

    /// Returns to a saved state, and writes its observations.
    ///
    /// # Errors
    /// [`BatchError::Snapshot`]: it was taken from a batch of another config; or a buffer of another length.
    pub fn restore(&mut self, snapshot: &Snapshot, observation: &mut [f32]) -> Result<(), BatchError> {
        let fits = snapshot.slots.len() == self.worlds
            && snapshot.spec == self.spec
            && snapshot.banks.len() == self.banks.len()
            && snapshot.banks.iter().zip(&self.banks).all(|(theirs, ours)| theirs.scene.spec == ours.scene.spec);
        if !fits {
            return Err(BatchError::Snapshot { found: snapshot.slots.len() });
        }
        check_length("observation", observation.len(), snapshot.observation.len())?;
        observation.copy_from_slice(&snapshot.observation);
        self.workers.each(|shard| {
            for (index, slot) in shard.slots.iter_mut().enumerate() {
                // Another number of threads has other stages.
                let stage = slot.stage;
                *slot = snapshot.slots[shard.first + index].clone();
                slot.stage = stage;
            }
            let numbers = &mut shard.outputs.observation;
            let (first, count) = (shard.first * (numbers.len() / shard.slots.len()), numbers.len());
            numbers.copy_from_slice(&snapshot.observation[first..first + count]);
        });
        self.torn = false;
        Ok(())
    }

    /// Lets every world carry out an order; `finish` sees the worlds of each thread if all went well there.
    fn carry_out(
        &mut self,
        order: Order,
        actions: &[f32],
        may_go_on: &mut dyn FnMut() -> bool,
        mut finish: impl FnMut(&mut Shard),
    ) -> Result<(), BatchError> {
        let mut error: Option<BatchError> = None;
        let each = actions.len() / self.worlds;
        let prepare = |shard: &mut Shard| {
            shard.order = order;
            if each > 0 {
                let count = shard.actions.len();
                shard.actions.copy_from_slice(&actions[shard.first * each..][..count]);
            }
        };
        self.workers.run(prepare, may_go_on, |shard| match shard.error.take() {
            None => finish(shard),
            // The threads' worlds come in order: of several errors the first world's is kept.
            Some(found) => error = error.take().or(Some(found)),
        });
        self.torn = error.is_some();
        error.map_or(Ok(()), Err)
    }

    fn check_actions(&self, actions: &[f32]) -> Result<(), BatchError> {
        let (names, limit) = (&self.spec.actions, self.spec.action_limit);
        check_length("actions", actions.len(), self.worlds * names.len())?;
        // NaN is within no limit.
        match actions.iter().position(|number| !(-limit..=limit).contains(number)) {
            Some(at) => Err(BatchError::Action {
                world: at / names.len(),
                name: names[at % names.len()].clone(),
                value: actions[at],
                limit,
            }),
            None => Ok(()),
        }
    }
}

/// The random stream of a world.
fn stream(seed: u64, world: usize) -> Random {
    Random::new(Stream::Batch, seed, world as u64)
}
