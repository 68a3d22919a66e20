//! Many worlds in step.

use std::ops::Range;
use std::sync::Arc;

use fiatlux_rules::Row;
use fiatlux_world::Scene;

use crate::buffers::{check_length, check_memory};
use crate::shard::{Order, Shard, part};
use crate::slot::{ReadyBank, Shared, Slot};
use crate::snapshot::settings;
use crate::workers::Workers;
use crate::{Autoreset, BatchConfig, BatchError, Begin, Buffers, Outputs, Snapshot, Spec, Task};

/// Many worlds in step; see the crate's documentation. It keeps its threads, which sleep between calls, until it is dropped.
pub struct Batch {
    worlds: usize,
    spec: Arc<Spec>,
    autoreset: Autoreset,
    /// What a snapshot of all worlds must share, and one of a world in each bank.
    settings: Vec<(String, String)>,
    settings_of_banks: Vec<Vec<(String, String)>>,
    banks: Vec<Arc<ReadyBank>>,
    workers: Workers,
    torn: bool,
}

impl Outputs {
    /// Buffers of zeros for all worlds of a batch.
    pub fn new(batch: &Batch) -> Self {
        Self::of(batch.spec(), batch.worlds())
    }
}

impl std::fmt::Debug for Batch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Batch").field("worlds", &self.worlds).field("threads", &self.threads()).finish_non_exhaustive()
    }
}

impl Batch {
    /// Makes worlds that each play a copy of the task. Each is at the start of an episode; [`Batch::reset`] writes its
    /// observation.
    ///
    /// # Errors
    /// [`BatchError`]: an invalid config, a start from which no world can start, or a task that cannot begin.
    pub fn new(config: BatchConfig, task: &dyn Task) -> Result<Self, BatchError> {
        config.check()?;
        let settings_of_banks = config.banks.chunks(1).map(|bank| settings(&config, 1, bank, task)).collect();
        let settings = settings(&config, config.worlds, &config.banks, task);
        let BatchConfig { worlds, threads, seed, banks, disturbances, autoreset } = config;
        check_memory(task.spec(), worlds)?;
        let expected = banks[0].scene.robot_layout();
        let odd = banks.iter().position(|bank| bank.scene.robot_layout() != expected);
        if let Some(bank) = odd {
            return Err(BatchError::Robots { bank, found: banks[bank].scene.robot_layout(), expected });
        }
        disturbances.check(banks[0].scene.robot.links().len())?;
        banks.iter().try_for_each(|bank| bank.ranges.check())?;
        let ready = banks.iter().enumerate().map(|(index, bank)| ReadyBank::new(bank, index).map(Arc::new));
        let banks = ready.collect::<Result<Vec<_>, _>>()?;
        let (spec, shared) = (Arc::new(task.spec().clone()), Arc::new(Shared { disturbances, autoreset }));
        let threads = threads.min(worlds);
        let shard = |thread: usize| {
            let range = thread * worlds / threads..(thread + 1) * worlds / threads;
            let slot = |world, stage, bank: &ReadyBank| Slot::new(stage, bank, task, seed, world);
            let bank_of = |world| world * banks.len() / worlds;
            Shard::new(range, &spec, &banks, Arc::clone(&shared), bank_of, slot)
        };
        let workers = Workers::new((0..threads).map(shard).collect())?;
        let mut batch = Self { worlds, spec, autoreset, settings, settings_of_banks, banks, workers, torn: false };
        batch.carry_out(&Order::Reset, &[], &mut || true, |_| {})?;
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
        (world < self.worlds).then(|| &self.banks[self.bank_of(world)].scene)
    }

    /// Begins an episode in every world and writes the observations.
    ///
    /// # Errors
    /// [`BatchError`]: a buffer of another length, or a task that cannot begin.
    pub fn reset(&mut self, observation: &mut [f32]) -> Result<(), BatchError> {
        self.reset_worlds(|_| Begin::AtStart, None, observation)
    }

    /// As [`Batch::reset`], after restarting each world's random stream from this seed: everything that follows is as
    /// in a new batch.
    ///
    /// # Errors
    /// As for [`Batch::reset`].
    pub fn reset_with_seed(&mut self, seed: u64, observation: &mut [f32]) -> Result<(), BatchError> {
        self.reset_worlds(|_| Begin::AtStart, Some(seed), observation)
    }

    /// Begins an episode in each world as `begin` says, after restarting the random stream of each of them if there is a seed.
    /// The observations of worlds that stay are those of their present rows.
    ///
    /// # Errors
    /// As for [`Batch::reset`]; a row that makes no world, after which the batch must be reset.
    pub fn reset_worlds(
        &mut self,
        begin: impl FnMut(usize) -> Begin,
        seed: Option<u64>,
        observation: &mut [f32],
    ) -> Result<(), BatchError> {
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        self.workers.check_process()?;
        let begins: Vec<_> = (0..self.worlds).map(begin).collect();
        if self.torn && begins.iter().any(|begin| matches!(begin, Begin::Stays)) {
            return Err(BatchError::Torn);
        }
        let mut begins = begins.into_iter();
        self.workers.each(|shard| {
            for (index, slot) in shard.slots.iter_mut().enumerate() {
                let begin = begins.next().unwrap_or_default();
                if let Some(seed) = seed.filter(|_| !matches!(begin, Begin::Stays)) {
                    slot.reseed(seed, (shard.first + index) as u64);
                }
                shard.begins[index] = begin;
            }
        });
        self.carry_out(&Order::Reset, &[], &mut || true, |shard| shard.copy_observation(observation))
    }

    /// Lets the marked worlds continue exactly from the state of one world: with the same actions they then do what it does, to the
    /// last bit. They must share its bank.
    ///
    /// # Errors
    /// [`BatchError`]: no such world, marks or a buffer of another length, a world of another bank, a task that cannot be saved.
    pub fn copy_world(&mut self, world: usize, marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        let snapshot = self.save_world(world)?;
        self.restore_worlds(&snapshot, marks, observation)
    }

    /// The state of one world, for [`Batch::restore_worlds`].
    ///
    /// # Errors
    /// As for [`Batch::save`]; [`BatchError::NoWorld`].
    pub fn save_world(&self, world: usize) -> Result<Snapshot, BatchError> {
        if world >= self.worlds {
            return Err(BatchError::NoWorld { world, worlds: self.worlds });
        }
        self.save_range(world..world + 1, &self.settings_of_banks[self.bank_of(world)])
    }

    /// Lets the marked worlds continue exactly from a snapshot of one world, of this batch or another one of the same settings.
    ///
    /// # Errors
    /// As for [`Batch::restore`], if the settings of a marked world differ.
    pub fn restore_worlds(
        &mut self,
        snapshot: &Snapshot,
        marks: &[bool],
        observation: &mut [f32],
    ) -> Result<(), BatchError> {
        check_length("marks", marks.len(), self.worlds)?;
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        check_length("worlds of the snapshot", snapshot.worlds.len(), 1)?;
        check_length("observation of the snapshot", snapshot.observation.len(), self.spec.observation_length())?;
        if self.torn && marks.contains(&false) {
            return Err(BatchError::Torn);
        }
        let mut last = None;
        for world in (0..self.worlds).filter(|world| marks[*world]) {
            let bank = self.bank_of(world);
            if last.replace(bank) != Some(bank) {
                snapshot.check(&self.settings_of_banks[bank])?;
            }
        }
        self.carry_out_where(&Order::Load(Arc::new(snapshot.clone())), marks, observation)
    }

    /// Ends the present episodes of the marked worlds, for ends of the caller's own. The next ones begin as [`Autoreset`] says; the
    /// observations are then those of their starts.
    ///
    /// # Errors
    /// As for [`Batch::reset`]; marks of another length.
    pub fn end_episodes(&mut self, marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        check_length("marks", marks.len(), self.worlds)?;
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        if self.torn {
            return Err(BatchError::Torn);
        }
        self.carry_out_where(&Order::End, marks, observation)
    }

    fn carry_out_where(&mut self, order: &Order, marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        self.workers.check_process()?;
        self.workers.each(|shard| {
            let count = shard.is_marked.len();
            shard.is_marked.copy_from_slice(&marks[shard.first..][..count]);
        });
        self.carry_out(order, &[], &mut || true, |shard| shard.copy_observation(observation))
    }

    /// Lets the present episode of each world end by time-out so many steps earlier than [`Spec::horizon_steps`], so that worlds which
    /// began together do not end together.
    ///
    /// # Errors
    /// [`BatchError`]: a list of another length.
    pub fn shorten_episodes(&mut self, steps: &[u64]) -> Result<(), BatchError> {
        check_length("steps", steps.len(), self.worlds)?;
        self.workers.check_process()?;
        self.workers.each(|shard| {
            shard.slots.iter_mut().zip(&steps[shard.first..]).for_each(|(slot, steps)| slot.shorten(*steps));
        });
        Ok(())
    }

    /// Takes a control step in every world: actions are in the order of worlds, and results go into the buffers. Where an
    /// episode ends, the next one begins as [`Autoreset`] says.
    ///
    /// # Errors
    /// [`BatchError`]: buffers of another length, or an action that is not finite or too large, in which case nothing
    /// has changed; or a task that failed in the middle of the step, after which the batch must be reset.
    pub fn step(&mut self, actions: &[f64], buffers: &mut Buffers<'_>) -> Result<(), BatchError> {
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
        actions: &[f64],
        buffers: &mut Buffers<'_>,
    ) -> Result<(), BatchError> {
        if self.torn {
            return Err(BatchError::Torn);
        }
        buffers.check(&self.spec, self.worlds)?;
        self.check_actions(actions)?;
        self.workers.check_process()?;
        self.check_ended()?;
        let order = Order::Step { wants_final: buffers.final_observation.is_some() };
        self.carry_out(&order, actions, may_go_on, |shard| buffers.copy_from(&shard.outputs, shard.first))
    }

    /// A copy of a world's row.
    ///
    /// # Errors
    /// [`BatchError::NoWorld`]; [`BatchError::Forked`].
    pub fn row(&self, world: usize) -> Result<Row, BatchError> {
        self.workers.check_process()?;
        let mut row = None;
        self.workers.each(|shard| {
            let index = world.checked_sub(shard.first);
            row = row.take().or(index.and_then(|index| shard.slots.get(index)).map(|slot| slot.row().clone()));
        });
        row.ok_or(BatchError::NoWorld { world, worlds: self.worlds })
    }

    /// The state of all worlds, between two steps.
    ///
    /// # Errors
    /// [`BatchError`]: a task that cannot be saved, or a batch that must be reset first.
    pub fn save(&self) -> Result<Snapshot, BatchError> {
        self.save_range(0..self.worlds, &self.settings)
    }

    fn save_range(&self, range: Range<usize>, settings: &[(String, String)]) -> Result<Snapshot, BatchError> {
        if self.torn {
            return Err(BatchError::Torn);
        }
        self.workers.check_process()?;
        let (mut worlds, mut observation) = (Vec::with_capacity(range.len()), Vec::new());
        self.workers.each(|shard| {
            let count = shard.slots.len();
            for index in 0..count {
                if range.contains(&(shard.first + index)) {
                    worlds.push(shard.slots[index].save());
                    observation.extend_from_slice(part(&mut shard.outputs.observation, index, count));
                }
            }
        });
        let number = |(index, saved): (usize, Result<_, _>)| {
            saved.map_err(|source| BatchError::Task { world: range.start + index, source })
        };
        let worlds = worlds.into_iter().enumerate().map(number).collect::<Result<_, _>>()?;
        Ok(Snapshot { settings: settings.to_vec(), worlds, observation })
    }

    /// Returns to a saved state, and writes its observations.
    ///
    /// # Errors
    /// [`BatchError::Snapshot`]: it was taken from a batch with other settings; seed and threads may differ. A buffer of
    /// another length. [`BatchError::Task`]: a damaged snapshot, after which the batch must be reset.
    pub fn restore(&mut self, snapshot: &Snapshot, observation: &mut [f32]) -> Result<(), BatchError> {
        snapshot.check(&self.settings)?;
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        check_length("observation of the snapshot", snapshot.observation.len(), observation.len())?;
        check_length("worlds of the snapshot", snapshot.worlds.len(), self.worlds)?;
        self.workers.check_process()?;
        let mut loaded = Ok(());
        self.workers.each(|shard| {
            for (index, world) in snapshot.worlds[shard.first..][..shard.slots.len()].iter().enumerate() {
                if let Err(error) = shard.load(index, world) {
                    loaded = Err(error);
                }
            }
            let numbers = &mut shard.outputs.observation;
            let (first, count) = (shard.first * (numbers.len() / shard.slots.len()), numbers.len());
            numbers.copy_from_slice(&snapshot.observation[first..first + count]);
        });
        observation.copy_from_slice(&snapshot.observation);
        self.torn = loaded.is_err();
        loaded
    }

    /// Lets every world carry out an order; `finish` sees the worlds of each thread if all went well there.
    fn carry_out(
        &mut self,
        order: &Order,
        actions: &[f64],
        may_go_on: &mut dyn FnMut() -> bool,
        mut finish: impl FnMut(&mut Shard),
    ) -> Result<(), BatchError> {
        let mut error: Option<BatchError> = None;
        let each = actions.len() / self.worlds;
        let prepare = |shard: &mut Shard| {
            shard.order = order.clone();
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

    /// Worlds are spread evenly over the banks.
    fn bank_of(&self, world: usize) -> usize {
        world * self.banks.len() / self.worlds
    }

    /// Refuses a step of worlds whose episode has ended, if nothing begins the next one.
    fn check_ended(&self) -> Result<(), BatchError> {
        let mut ended = None;
        if self.autoreset == Autoreset::Disabled {
            self.workers.each(|shard| {
                let found = shard.slots.iter().position(|slot| slot.has_ended);
                ended = ended.or(found.map(|index| shard.first + index));
            });
        }
        ended.map_or(Ok(()), |world| Err(BatchError::Ended { world }))
    }

    fn check_actions(&self, actions: &[f64]) -> Result<(), BatchError> {
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
