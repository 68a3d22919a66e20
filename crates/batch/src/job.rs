//! One world of a batch as the threads see it, and what each thread has of its own.

use std::ops::Range;
use std::sync::Arc;

use fiatlux_dynamics::Contact;
use fiatlux_rules::Row;
use fiatlux_world::World;

use crate::slot::{Original, ReadyBank, Results, Shared, Slot, Stage, Stopped};
use crate::snapshot::{Snapshot, WorldState};
use crate::{BatchError, Control, Outcome, Spec, Verdicts};

/// Up to this many banks, every thread can step the worlds of all of them; with more, only those of the banks that it begins with.
const MAX_SHARED_BANKS: usize = 16;

/// Words of an observation up to which a world keeps room for the last one of an episode. With pictures, whose memory counts, the room
/// is there only in a step in which an episode ends.
const KEPT_WORDS: usize = 1 << 13;

/// A job for one world.
#[derive(Clone)]
pub(crate) enum Order {
    /// Begin an episode, as `begin` says.
    Reset,
    /// Continue from the one world of a snapshot, if marked.
    Load(Arc<Snapshot>),
    /// The same, with the world that the snapshot is of.
    Copy(Arc<(Snapshot, Original)>),
    /// End the episode, if marked.
    End,
    /// Look with these sensors, if marked.
    Look(Arc<Vec<String>>),
    /// Take a control step with its action.
    Step {
        /// Observe the last row of an episode too.
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

/// One world and its results. Two of them share no cache line.
#[repr(align(64))]
pub(crate) struct Job {
    /// Index of the world in the batch.
    pub world: usize,
    pub slot: Slot,
    pub begin: Begin,
    pub is_marked: bool,
    pub observation: Vec<f32>,
    pub final_observation: Vec<f32>,
    pub reward: f32,
    pub reward_terms: Vec<f32>,
    /// Contact points of the last step, if they are watched.
    pub contacts: Vec<Contact>,
    pub outcome: Outcome,
    /// The verdicts on the episode that the last step ended, if the benchmark's judge it.
    pub verdicts: Option<Verdicts>,
    pub error: Option<BatchError>,
    /// The state before a call that may be refused.
    kept: Option<Kept>,
}

/// The state of a world before a call, for one that is refused.
struct Kept {
    slot: Slot,
    observation: Vec<f32>,
    contacts: Vec<Contact>,
}

impl Job {
    pub fn new(world: usize, spec: &Spec, slot: Slot) -> Self {
        let numbers = |length| vec![0.0; length];
        Self {
            world,
            slot,
            begin: Begin::AtStart,
            is_marked: false,
            observation: numbers(spec.observation_length()),
            final_observation: Vec::with_capacity(Some(spec.observation_length()).filter(is_kept).unwrap_or_default()),
            reward: 0.0,
            reward_terms: numbers(spec.rewards.len()),
            contacts: Vec::new(),
            outcome: Outcome::Continues,
            verdicts: None,
            error: None,
            kept: None,
        }
    }

    /// Keeps its state until [`Job::settle`].
    pub fn keep(&mut self) {
        let (slot, observation, contacts) = (self.slot.twin(), self.observation.clone(), self.contacts.clone());
        self.kept = Some(Kept { slot, observation, contacts });
    }

    /// Ends a call: where it was refused, the world is again as [`Job::keep`] found it.
    pub fn settle(&mut self, refused: bool) {
        self.begin = Begin::Stays;
        let kept = self.kept.take().filter(|_| refused);
        if let Some(Kept { slot, observation, contacts }) = kept {
            (self.slot, self.observation, self.contacts) = (slot, observation, contacts);
        }
    }

    /// Copies its observation to its place among those of all worlds.
    pub fn copy_observation(&self, observation: &mut [f32]) {
        part(observation, self.world, self.observation.len()).copy_from_slice(&self.observation);
    }

    /// Continues from a state; the observation is not changed.
    pub fn load(&mut self, state: &WorldState, bank: &ReadyBank) -> Result<(), BatchError> {
        self.contacts.clear();
        self.slot.load(state, bank).map_err(|source| BatchError::Task { world: self.world, source })
    }
}

/// A thread's own memory: the worlds that it begins with, and one [`World`] for each bank, where the worlds of the bank take
/// turns and which stays in the cache.
pub(crate) struct Worker {
    /// The worlds that it begins with.
    pub own: Range<usize>,
    /// The worlds that it can step: those of its banks.
    pub reach: Range<usize>,
    first_bank: usize,
    stages: Vec<Stage>,
    shared: Arc<Shared>,
    control: Control,
}

impl Worker {
    /// `worlds` are all worlds of the batch, spread evenly over the banks.
    pub fn new(own: Range<usize>, worlds: usize, banks: &[Arc<ReadyBank>], shared: Arc<Shared>) -> Self {
        let count = banks.len();
        let (first, last) = match count {
            ..=MAX_SHARED_BANKS => (0, count - 1),
            _ => (own.start * count / worlds, (own.end - 1) * count / worlds),
        };
        let stage =
            |bank: &Arc<ReadyBank>| Stage { bank: Arc::clone(bank), world: World::new(Arc::clone(&bank.scene)) };
        let joints = banks[0].scene.robot_layout().joints;
        Self {
            own,
            reach: (first * worlds).div_ceil(count)..((last + 1) * worlds).div_ceil(count),
            first_bank: first,
            stages: banks[first..=last].iter().map(stage).collect(),
            shared,
            control: Control {
                action: vec![0.0; joints],
                joint_target: vec![0.0; joints],
                wrenches: Vec::with_capacity(8),
                push: None,
            },
        }
    }

    /// Carries out an order in a world.
    pub fn run(&mut self, job: &mut Job, order: &Order, action: &[f64]) -> Result<(), BatchError> {
        let stage = &mut self.stages[job.slot.bank - self.first_bank];
        let (shared, world) = (&*self.shared, job.world);
        let keeps_contacts = match order {
            Order::Reset => matches!(job.begin, Begin::Stays),
            Order::Load(_) | Order::Copy(_) => !job.is_marked,
            Order::End | Order::Look(_) => true,
            Order::Step { .. } => false,
        };
        if !keeps_contacts {
            job.contacts.clear();
        }
        let done = match order {
            Order::Reset => match std::mem::take(&mut job.begin) {
                Begin::Stays => Ok(()),
                Begin::AtStart => job.slot.begin(stage, shared, None, &mut job.observation),
                Begin::AtRow(row) => job.slot.begin(stage, shared, Some(&row), &mut job.observation),
            },
            Order::Load(snapshot) if job.is_marked => {
                job.observation.copy_from_slice(&snapshot.observation);
                job.slot.load(&snapshot.worlds[0], &stage.bank).map_err(Stopped::Task)
            }
            Order::Copy(copied) if job.is_marked => {
                let (snapshot, original) = &**copied;
                job.observation.copy_from_slice(&snapshot.observation);
                job.slot.copy_from(&snapshot.worlds[0], original, &stage.bank).map_err(Stopped::Task)
            }
            Order::End if job.is_marked => job.slot.end(stage, shared, &mut job.observation),
            Order::Look(sensors) if job.is_marked => job.slot.look(&stage.bank, shared, sensors, &mut job.observation),
            Order::Load(_) | Order::Copy(_) | Order::End | Order::Look(_) => Ok(()),
            Order::Step { wants_final } => {
                job.final_observation.clear();
                if !is_kept(&job.final_observation.capacity()) {
                    job.final_observation = Vec::new();
                }
                let results = Results {
                    observation: &mut job.observation,
                    final_observation: wants_final.then_some(&mut job.final_observation),
                    reward_terms: &mut job.reward_terms,
                    contacts: shared.watch.contacts.then_some(&mut job.contacts),
                    verdicts: &mut job.verdicts,
                };
                let stepped = job.slot.step(stage, shared, action, &mut self.control, results);
                stepped.map(|(outcome, reward)| (job.outcome, job.reward) = (outcome, reward))
            }
        };
        done.map_err(|stopped| stopped.at(world))
    }
}

/// True if room for an observation of so many words is kept.
fn is_kept(words: &usize) -> bool {
    *words <= KEPT_WORDS
}

/// A world's part of an array with `each` numbers for every world.
pub(crate) fn part<T>(array: &mut [T], world: usize, each: usize) -> &mut [T] {
    &mut array[world * each..][..each]
}
