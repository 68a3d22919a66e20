//! Many worlds in step.

use std::ops::Range;
use std::sync::Arc;

use fiatlux_dynamics::Contact;
use fiatlux_rules::Row;
use fiatlux_sensing::{SensorSuite, View};
use fiatlux_world::{Light, Scene};

use crate::buffers::{Memory, check_length, check_memory};
use crate::job::{Job, Order, Worker};
use crate::possible::check_row;
use crate::slot::{ReadyBank, Shared, Slot};
use crate::snapshot::settings;
use crate::workers::Workers;
use crate::{Autoreset, BatchConfig, BatchError, Begin, Buffers, Drawn, Outputs, Snapshot, Spec, Task, Verdicts};

/// Many worlds in step; see the crate's documentation. It keeps its threads, which sleep between calls, until it is dropped.
pub struct Batch {
    worlds: usize,
    spec: Arc<Spec>,
    autoreset: Autoreset,
    /// Settings that a snapshot of all worlds must share, and those of one world in each bank.
    settings: Vec<(String, String)>,
    settings_of_banks: Vec<Vec<(String, String)>>,
    banks: Vec<Arc<ReadyBank>>,
    workers: Workers,
    /// The largest factor of a drive's effort limit among the starts.
    effort_factor: f64,
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
        let BatchConfig { worlds, threads, seed, banks, disturbances, autoreset, watch } = config;
        let expected = banks[0].scene.robot_layout();
        let odd = banks.iter().position(|bank| bank.scene.robot_layout() != expected);
        if let Some(bank) = odd {
            return Err(BatchError::Robots { bank, found: banks[bank].scene.robot_layout(), expected });
        }
        let mut spec = task.spec().clone();
        let observation_length = spec.observation_length();
        spec.observation.extend(watch.fields(expected));
        check_memory(&spec, worlds)?;
        disturbances.check(banks[0].scene.robot.links().len())?;
        banks.iter().try_for_each(|bank| bank.ranges.check())?;
        let drives = banks.iter().flat_map(|bank| &bank.starts).flat_map(|start| &start.variation.drives);
        let effort_factor = drives.map(|(_, drive)| drive.effort_limit).fold(1.0, f64::max);
        let ready = banks.iter().enumerate();
        let ready = ready.map(|(index, bank)| ReadyBank::new(bank, index, effort_factor, &watch).map(Arc::new));
        let banks = ready.collect::<Result<Vec<_>, _>>()?;
        let spec = Arc::new(spec);
        let shared = Arc::new(Shared { disturbances, autoreset, watch, observation_length });
        let threads = threads.min(worlds);
        let job = |world: usize| {
            let bank = world * banks.len() / worlds;
            Job::new(world, &spec, Slot::new(bank, &banks[bank], task, seed, world))
        };
        let memory = Memory { worlds, numbers: spec.observation_length() };
        let mut jobs = Vec::new();
        jobs.try_reserve_exact(worlds).map_err(|_| memory.error())?;
        for world in 0..worlds {
            if !memory.is_left(world) {
                return Err(memory.error());
            }
            jobs.push(job(world));
        }
        let of_threads = banks.clone();
        let worker = move |thread: usize| {
            let own = thread * worlds / threads..(thread + 1) * worlds / threads;
            Worker::new(own, worlds, &of_threads, Arc::clone(&shared))
        };
        let workers = Workers::new(jobs, threads, worker)?;
        let mut batch =
            Self { worlds, spec, autoreset, settings, settings_of_banks, banks, workers, effort_factor, torn: false };
        let mut asked = 0;
        let mut is_memory_left = || {
            asked += 1;
            memory.is_left(asked - 1)
        };
        let begun = batch.carry_out(&Order::Reset, &[], &mut is_memory_left, |_| {});
        begun.map_err(|error| if matches!(error, BatchError::Stopped) { memory.error() } else { error })?;
        if memory.is_left(0) { Ok(batch) } else { Err(memory.error()) }
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
    /// As for [`Batch::reset`]; [`BatchError::Row`]: a row that no episode reaches. Nothing has changed then.
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
        for (world, begin) in begins.iter().enumerate() {
            let Begin::AtRow(row) = begin else { continue };
            let bank = &self.banks[self.bank_of(world)];
            let checked = check_row(&bank.scene, row, self.effort_factor);
            checked.map_err(|problem| BatchError::Row { world, problem })?;
        }
        for (mut job, begin) in self.workers.jobs().zip(begins) {
            if matches!(begin, Begin::Stays) {
                continue;
            }
            job.keep();
            if let Some(seed) = seed {
                let number = job.world as u64;
                job.slot.reseed(seed, number);
            }
            job.begin = begin;
        }
        self.change(&Order::Reset, observation)
    }

    /// Lets the marked worlds continue exactly from the state of one world: with the same actions they then do what it does, to the
    /// last bit. They must share its bank.
    ///
    /// # Errors
    /// [`BatchError`]: no such world, marks or a buffer of another length, a world of another bank, a task that cannot be saved.
    pub fn copy_world(&mut self, world: usize, marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        let snapshot = self.save_world(world)?;
        self.check_fits(&snapshot, marks, observation)?;
        let original = self.workers.job(world).map(|job| job.slot.original());
        let original = original.ok_or(BatchError::NoWorld { world, worlds: self.worlds })?;
        self.carry_out_where(&Order::Copy(Arc::new((snapshot, original))), marks, observation)
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
        self.check_fits(snapshot, marks, observation)?;
        self.carry_out_where(&Order::Load(Arc::new(snapshot.clone())), marks, observation)
    }

    /// Refuses a snapshot from which the marked worlds cannot continue.
    fn check_fits(&self, snapshot: &Snapshot, marks: &[bool], observation: &[f32]) -> Result<(), BatchError> {
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
        Ok(())
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

    /// Lets the marked worlds compute these sensors of their present row again, whatever their rate, and writes the observations.
    ///
    /// # Errors
    /// As for [`Batch::reset`]; marks of another length; [`BatchError::Task`]: a sensor that the observation does not have. Nothing
    /// has changed then.
    pub fn look(&mut self, sensors: &[String], marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        check_length("marks", marks.len(), self.worlds)?;
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        if self.torn {
            return Err(BatchError::Torn);
        }
        self.carry_out_where(&Order::Look(Arc::new(sensors.to_vec())), marks, observation)
    }

    fn carry_out_where(&mut self, order: &Order, marks: &[bool], observation: &mut [f32]) -> Result<(), BatchError> {
        self.workers.check_process()?;
        for (mut job, mark) in self.workers.jobs().zip(marks) {
            job.is_marked = *mark;
            if *mark {
                job.keep();
            }
        }
        self.change(order, observation)
    }

    /// Carries out an order other than a step in the worlds that keep their state; if one refuses, all are as before.
    fn change(&mut self, order: &Order, observation: &mut [f32]) -> Result<(), BatchError> {
        let was_torn = self.torn;
        let done = self.carry_out(order, &[], &mut || true, |_| {});
        self.torn = was_torn && done.is_err();
        for mut job in self.workers.jobs() {
            job.settle(done.is_err());
            if done.is_ok() {
                job.copy_observation(observation);
            }
        }
        done
    }

    /// Lets the present episode of each world end by time-out this many steps earlier than [`Spec::horizon_steps`], so that worlds which
    /// began together do not end together.
    ///
    /// # Errors
    /// [`BatchError`]: a list of another length.
    pub fn shorten_episodes(&mut self, steps: &[u64]) -> Result<(), BatchError> {
        check_length("steps", steps.len(), self.worlds)?;
        self.workers.check_process()?;
        self.workers.jobs().zip(steps).for_each(|(mut job, steps)| job.slot.shorten(*steps));
        Ok(())
    }

    /// Takes a control step in every world: actions are in the order of worlds, and results go into the buffers. Where an
    /// episode ends, the next one begins as [`Autoreset`] says.
    ///
    /// # Errors
    /// [`BatchError`]: buffers of another length, or an action that is not finite or too large, in which case nothing
    /// has changed; or a task that failed in the middle of the step, after which the batch must be reset.
    pub fn step(&mut self, actions: &[f64], buffers: &mut Buffers<'_>) -> Result<(), BatchError> {
        if self.torn {
            return Err(BatchError::Torn);
        }
        buffers.check(&self.spec, self.worlds)?;
        self.check_actions(actions)?;
        self.workers.check_process()?;
        self.check_ended()?;
        let order = Order::Step { wants_final: buffers.final_observation.is_some() };
        self.carry_out(&order, actions, &mut || true, |job| buffers.copy_from(job))
    }

    /// Worlds whose episode has ended while the next one has not begun, as [`Autoreset`] may leave them.
    #[must_use]
    pub fn ended(&self) -> Vec<bool> {
        self.workers.jobs().map(|job| job.slot.has_ended).collect()
    }

    /// The benchmark's verdicts on the episodes that the last step ended, by world; worlds whose episode went on, and those of tasks that
    /// the benchmark does not judge, are left out.
    pub fn verdicts(&self) -> impl Iterator<Item = (usize, Verdicts)> {
        self.workers.jobs().filter_map(|job| Some((job.world, job.verdicts?)))
    }

    /// A copy of a world's row.
    ///
    /// # Errors
    /// [`BatchError::NoWorld`]; [`BatchError::Forked`].
    pub fn row(&self, world: usize) -> Result<Row, BatchError> {
        self.workers.check_process()?;
        let row = self.workers.job(world).map(|job| job.slot.row().clone());
        row.ok_or(BatchError::NoWorld { world, worlds: self.worlds })
    }

    /// Asks the sensors of a world for more than its observation has, at its present row and with its episode's noise. Worlds may be
    /// asked by several threads at once, each by one.
    ///
    /// # Errors
    /// As for [`Batch::row`]; [`BatchError::Task`]: the task has no sensors.
    pub fn sense<T>(&self, world: usize, ask: impl FnOnce(&mut SensorSuite, &View<'_>) -> T) -> Result<T, BatchError> {
        self.workers.check_process()?;
        let none = || BatchError::NoWorld { world, worlds: self.worlds };
        let mut job = self.workers.job(world).ok_or_else(none)?;
        let scene = &self.banks[job.slot.bank].scene;
        let (suite, view) = job.slot.senses(scene).ok_or_else(|| {
            let source = "this task has no sensors; use a task of the benchmark".into();
            BatchError::Task { world, source }
        })?;
        let said = ask(suite, &view);
        suite.release();
        Ok(said)
    }

    /// Values drawn for a world's present episode, by name: the start of its bank, light, what varies, and what the task draws.
    ///
    /// # Errors
    /// As for [`Batch::row`].
    pub fn drawn(&self, world: usize) -> Result<Drawn, BatchError> {
        self.workers.check_process()?;
        let drawn = self.workers.job(world).map(|job| job.slot.drawn(&self.banks[job.slot.bank]));
        drawn.ok_or(BatchError::NoWorld { world, worlds: self.worlds })
    }

    /// The light of a world's present episode.
    ///
    /// # Errors
    /// As for [`Batch::row`].
    pub fn light(&self, world: usize) -> Result<Light, BatchError> {
        self.workers.check_process()?;
        let light = self.workers.job(world).map(|job| job.slot.light(&self.banks[job.slot.bank]));
        light.ok_or(BatchError::NoWorld { world, worlds: self.worlds })
    }

    /// The contact points of a world's last step, if [`Watch::contacts`](crate::Watch::contacts) says so: those of its last physics step, 5 ms,
    /// each with its part of the mean force. The step that ends an episode has its own. None after a reset or a copy.
    ///
    /// # Errors
    /// As for [`Batch::row`].
    pub fn contacts(&self, world: usize) -> Result<Vec<Contact>, BatchError> {
        self.workers.check_process()?;
        let contacts = self.workers.job(world).map(|job| job.contacts.clone());
        contacts.ok_or(BatchError::NoWorld { world, worlds: self.worlds })
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
        for job in self.workers.jobs().skip(range.start).take(range.len()) {
            worlds.push(job.slot.save().map_err(|source| BatchError::Task { world: job.world, source })?);
            observation.extend_from_slice(&job.observation);
        }
        Ok(Snapshot { settings: settings.to_vec(), worlds, observation })
    }

    /// Returns to a saved state, and writes its observations.
    ///
    /// # Errors
    /// [`BatchError::Snapshot`]: it was taken from a batch with other settings; seed and threads may differ. A buffer of
    /// another length. [`BatchError::Task`]: a damaged snapshot. Nothing has changed then.
    pub fn restore(&mut self, snapshot: &Snapshot, observation: &mut [f32]) -> Result<(), BatchError> {
        snapshot.check(&self.settings)?;
        check_length("observation", observation.len(), self.worlds * self.spec.observation_length())?;
        check_length("observation of the snapshot", snapshot.observation.len(), observation.len())?;
        check_length("worlds of the snapshot", snapshot.worlds.len(), self.worlds)?;
        self.workers.check_process()?;
        let mut loaded = Ok(());
        let each = self.spec.observation_length();
        for (mut job, state) in self.workers.jobs().zip(&snapshot.worlds) {
            job.keep();
            let bank = &self.banks[job.slot.bank];
            loaded = loaded.and_then(|()| job.load(state, bank));
            let first = job.world * each;
            job.observation.copy_from_slice(&snapshot.observation[first..first + each]);
        }
        self.workers.jobs().for_each(|mut job| job.settle(loaded.is_err()));
        if loaded.is_ok() {
            observation.copy_from_slice(&snapshot.observation);
            self.torn = false;
        }
        loaded
    }

    /// Lets every world carry out an order; `finish` sees those where all went well.
    fn carry_out(
        &mut self,
        order: &Order,
        actions: &[f64],
        may_go_on: &mut dyn FnMut() -> bool,
        mut finish: impl FnMut(&mut Job),
    ) -> Result<(), BatchError> {
        let mut error: Option<BatchError> = None;
        let went_on = self.workers.run(order, actions, may_go_on, |job| match job.error.take() {
            None => finish(job),
            // Of several errors the first world's is kept.
            Some(found) => error = error.take().or(Some(found)),
        });
        error = error.or((!went_on).then_some(BatchError::Stopped));
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
            ended = self.workers.jobs().find(|job| job.slot.has_ended).map(|job| job.world);
        }
        ended.map_or(Ok(()), |world| Err(BatchError::Ended { world }))
    }

    /// Refuses actions that [`Batch::step`] refuses, and takes no step.
    ///
    /// # Errors
    /// [`BatchError`]: a list of another length; a number that is not finite or too large.
    pub fn check_actions(&self, actions: &[f64]) -> Result<(), BatchError> {
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
