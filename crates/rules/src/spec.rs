//! Everything that defines a task, to be filled in by a page of `tasks/`.

use fiatlux_judge::Causes;

use crate::context::Gate;
use crate::parts::Bulb;
use crate::terms::term::TermSpec;
use crate::thresholds::Thresholds;

/// Control steps of half a second: the sustain window of S03 and S08.
pub(crate) const HALF_SECOND: u32 = 25;
/// Control steps of a second: the sustain window of S01, S06 and S11.
pub(crate) const ONE_SECOND: u32 = 50;
/// Horizon of a subtask and of `climb`: 120 s.
pub(crate) const SUBTASK_HORIZON: u64 = 6_000;

/// Control mode of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControlMode {
    /// Walking on the floor.
    FlatNavigation,
    /// Hands at work: grasping, holding, placing or fitting.
    Manipulation,
    /// Feet, and hands, on the ladder.
    Climbing,
}

impl ControlMode {
    /// As in the paper's table.
    pub fn name(self) -> &'static str {
        match self {
            ControlMode::FlatNavigation => "Flat Navigation",
            ControlMode::Manipulation => "Manipulation",
            ControlMode::Climbing => "Climbing",
        }
    }
}

/// Difficulty of a subtask. The subtask's weight is the product of its factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Factor {
    /// Work from the ladder.
    Balance,
    /// Letting go so that the thing stays where it was put.
    Release,
    /// Taking hold of a thing at rest.
    Grasp,
    /// Carrying a load on the way: the ladder or a bulb.
    Carry,
    /// Up or down the ladder.
    Traverse,
    /// Bringing a bulb and the socket together, or apart.
    Mate,
    /// Several control modes in one episode.
    Span,
}

impl Factor {
    /// Its multiplier (paper, table of weights).
    pub fn multiplier(self) -> f64 {
        match self {
            Factor::Balance => 2.0,
            Factor::Release => 1.8,
            Factor::Grasp => 1.4,
            Factor::Carry | Factor::Traverse | Factor::Mate | Factor::Span => 1.5,
        }
    }
}

/// The kind of ladder that a task is played with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ladder {
    /// Anywhere in the room, and free to be carried.
    Free,
    /// Ready below the fixture, and free to move.
    Coupled,
    /// Fixed to the floor, in the scene of `climb`.
    Fixed,
}

/// Where a bulb is at the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spot {
    /// In the socket's hold.
    Socket,
    /// Standing on the work bench.
    Bench,
    /// Upright in the crate.
    Crate,
    /// In the robot's right hand.
    Hand,
    /// On the floor, out of the way, where the scene of `climb` parks it.
    Parked,
}

/// A thing that a start is measured from, or that the robot faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Landmark {
    /// The origin of the ladder.
    Ladder,
    /// The origin of the crate.
    Crate,
    /// The origin of the fresh bulb.
    FreshBulb,
}

/// Distance of the robot from a landmark at the start. The scene config has the figures, as `start.<name>_distance`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StartDistance {
    /// Before the lowest tread.
    Mounting,
    /// Where an arm reaches into the crate.
    Dispose,
    /// A step back from the crate.
    Leave,
}

/// Where the robot stands at the start, before noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stand {
    /// In its own zone, turned as the room's layout has it.
    OwnZone,
    /// In its own zone, turned to a landmark.
    OwnZoneFacing(Landmark),
    /// On the side of the ladder's steps at the mounting distance, turned to the ladder.
    LadderSteps,
    /// On the ladder's platform, turned to the fixture.
    Platform,
    /// Off a landmark in the direction of its own zone, never beyond it, turned to a landmark.
    Beside {
        /// The landmark that it stands next to.
        landmark: Landmark,
        /// Distance from it.
        distance: StartDistance,
        /// Landmark that it faces.
        facing: Landmark,
    },
    /// At the bench, within reach of the fresh bulb and turned to it (`start.grab_place`).
    BenchAtBulb,
    /// At the bench and clear of it (`start.carry_place`), turned to a landmark.
    BenchFacing(Landmark),
}

/// Reset noise. The scene config has the figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetNoise {
    /// The robot is exactly in its place and posture.
    None,
    /// That of a robot in the open, `start.noise`.
    Usual,
    /// That of a robot at or on the ladder, `start.ladder_noise`.
    AtLadder,
}

/// The state in which a task starts, as data: the world carries it out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StartSpec {
    /// Which ladder it is played with.
    pub ladder: Ladder,
    /// Where the robot stands.
    pub robot: Stand,
    /// Noise that a reset adds.
    pub noise: ResetNoise,
    /// Where the old bulb is.
    pub old_bulb: Spot,
    /// Where the fresh bulb is.
    pub fresh_bulb: Spot,
    /// A place nearly as near to the crate as [`Thresholds::crate_near_m`] is not taken: the gate asks to come nearer.
    pub away_from_crate: bool,
}

impl StartSpec {
    /// Where a bulb is.
    pub fn spot(&self, bulb: Bulb) -> Spot {
        match bulb {
            Bulb::Old => self.old_bulb,
            Bulb::Fresh => self.fresh_bulb,
        }
    }

    /// The bulb in the robot's right hand.
    pub fn in_hand(&self) -> Option<Bulb> {
        Bulb::ALL.into_iter().find(|bulb| self.spot(*bulb) == Spot::Hand)
    }
}

/// The reward of a task.
#[derive(Debug, Clone, Copy)]
pub(crate) enum RewardSpec {
    /// Gate progress; in training also these hints, success, failures and motion.
    Subtask {
        /// Additional terms that guide a learner.
        hints: &'static [TermSpec],
    },
    /// These terms and motion, whether in training or not.
    Own {
        /// The task's own terms.
        terms: &'static [TermSpec],
        /// Weight of the sway of the centre of mass.
        com_sway: f64,
    },
}

/// Rules that differ in one or two tasks; [`SpecialRules::NONE`] has the usual ones.
#[derive(Debug, Clone, Copy)]
pub struct SpecialRules {
    /// Height below which the fresh bulb counts as dropped, m.
    pub fresh_drop_m: fn(&Thresholds) -> f64,
    /// The bulbs lie on the floor from the start: no bulb counts as dropped.
    pub bulbs_parked: bool,
    /// The bulb that has to stay in the socket: without it the condition [`Cause::Unseated`](crate::Cause::Unseated) is
    /// met.
    pub keeps_seated: Option<Bulb>,
    /// Grades mention that the pelvis was at working height, which the gate does not need.
    pub notes_working_height: bool,
}

impl SpecialRules {
    /// No special rule: what most tasks have.
    pub const NONE: Self = Self {
        fresh_drop_m: |thresholds| thresholds.fresh_drop_m,
        bulbs_parked: false,
        keeps_seated: None,
        notes_working_height: false,
    };
}

/// Everything that defines a task.
#[derive(Debug, Clone, Copy)]
pub struct TaskSpec {
    /// Short name, such as `S01` or `replace`.
    pub short_id: &'static str,
    /// Full id, such as `Fiatlux-S01-MoveLadder-v1`.
    pub id: &'static str,
    /// Name for people, such as `Move Ladder`.
    pub name: &'static str,
    /// Instruction that the robot gets.
    pub instruction: &'static str,
    /// Factors of its weight; empty if it has no weight.
    pub factors: &'static [Factor],
    /// Weight in the benchmark score; 0 outside it.
    pub weight: f64,
    /// Control modes that it allows.
    pub modes: &'static [ControlMode],
    /// Control steps until time-out.
    pub horizon_steps: u64,
    /// The bulbs that the robot handles; dropping or crushing them concerns the task.
    pub bulbs: &'static [Bulb],
    /// Where robot, ladder and bulbs are at the start.
    pub start: StartSpec,
    /// Condition for success.
    pub gate: Gate,
    /// Criteria that hold in its start state.
    pub start_count: u32,
    /// Causes that end it besides success, fall and time-out.
    pub also_ends_on: Causes,
    /// Rules that differ from those of other tasks.
    pub special: SpecialRules,
    /// The terms of its reward.
    pub(crate) reward: RewardSpec,
}
