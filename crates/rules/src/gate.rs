//! Gates: conditions that must hold together.

use serde::{Deserialize, Serialize};

use crate::geometry::Geometry;
use crate::protocol::Protocol;
use crate::row::{Bulb, Row};
use crate::settle::PoseSpeed;
use crate::strict::UPRIGHT;
use crate::task::Task;
use crate::thresholds::Thresholds;

/// Inputs of a predicate besides the row.
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    /// Figures to compare with.
    pub thresholds: &'a Thresholds,
    /// Places and sizes in the scene that predicates measure against.
    pub geometry: &'a Geometry,
    /// Low-passed speeds of both bulbs, by [`Bulb`].
    pub bulb_speeds: [PoseSpeed; 2],
    /// Low-passed speeds of the bulbs in the frames of the palms, by [`Bulb`], then left and right, m/s.
    pub grip_speeds: [[f64; 2]; 2],
    /// Heights below which the bulbs count as dropped in this task, by [`Bulb`], m.
    pub drop_heights: [f64; 2],
}

impl<'a> Context<'a> {
    /// The context of a task with bulbs that do not move.
    pub(crate) fn at_rest(task: Task, thresholds: &'a Thresholds, geometry: &'a Geometry) -> Self {
        let drop_heights = [thresholds.old_drop_m, (task.spec().special.fresh_drop_m)(thresholds)];
        Self { thresholds, geometry, bulb_speeds: Default::default(), grip_speeds: Default::default(), drop_heights }
    }

    /// Low-passed speeds of a bulb.
    pub fn bulb_speed(&self, bulb: Bulb) -> PoseSpeed {
        self.bulb_speeds[bulb as usize]
    }

    /// Height below which a bulb counts as dropped in this task, m.
    pub fn drop_height(&self, bulb: Bulb) -> f64 {
        self.drop_heights[bulb as usize]
    }
}

/// A predicate of a row.
pub type Predicate = fn(&Row, &Context<'_>) -> bool;

/// One condition of a gate.
#[derive(Debug, Clone, Copy)]
pub struct Criterion {
    /// Name of the criterion in results, such as those of `results.json`.
    pub name: &'static str,
    /// Whether it holds in a row.
    pub holds: Predicate,
}

/// Conditions that must hold at the same control step, for a number of consecutive ones.
#[derive(Debug, Clone, Copy)]
pub struct Gate {
    /// The conditions, at most [`MAX_CRITERIA`].
    pub criteria: &'static [Criterion],
    /// Number of consecutive control steps; 1 if a single one is enough.
    pub sustain_steps: u32,
    /// Additional criteria of protocol `strict`; an upright pelvis is always one of them.
    pub strict: &'static [Criterion],
    /// Consecutive control steps in protocol `strict`.
    pub strict_steps: u32,
    /// How many of the first criteria are what the task is for. Strict progress counts the others only if they hold in
    /// row 0, or once the very first has held: a hand on a bulb, or a foot on a tread, is no progress by itself.
    pub goals: usize,
}

/// Criteria of the longest gate, the strict one of S09.
pub const MAX_CRITERIA: usize = 9;

/// Which criteria of a gate hold in a row, in the gate's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Criteria {
    held: [bool; MAX_CRITERIA],
    len: usize,
}

impl Gate {
    /// The criteria of a protocol, the published ones first.
    pub fn criteria_of(&self, protocol: Protocol) -> impl Iterator<Item = &'static Criterion> + use<> {
        let (strict, upright): (&[Criterion], &[Criterion]) = match protocol {
            Protocol::Published => (&[], &[]),
            Protocol::Strict => (self.strict, &[UPRIGHT]),
        };
        self.criteria.iter().chain(strict).chain(upright)
    }

    /// Number of a protocol's criteria.
    pub fn n(&self, protocol: Protocol) -> u32 {
        self.criteria_of(protocol).count() as u32
    }

    /// Number of consecutive control steps for which they must hold.
    pub fn window(&self, protocol: Protocol) -> u32 {
        match protocol {
            Protocol::Published => self.sustain_steps,
            Protocol::Strict => self.strict_steps,
        }
    }

    /// Evaluates every criterion of a protocol.
    pub fn evaluate(&self, protocol: Protocol, row: &Row, context: &Context<'_>) -> Criteria {
        let mut criteria = Criteria::default();
        for (held, criterion) in criteria.held.iter_mut().zip(self.criteria_of(protocol)) {
            *held = (criterion.holds)(row, context);
            criteria.len += 1;
        }
        criteria
    }
}

impl Criteria {
    /// Criteria of no gate: none.
    pub(crate) const NONE: Self = Self { held: [false; MAX_CRITERIA], len: 0 };

    /// One entry for each criterion.
    pub fn as_slice(&self) -> &[bool] {
        // A damaged snapshot may have any length.
        self.held.get(..self.len).unwrap_or_default()
    }

    /// How many of the criteria hold.
    pub fn count(&self) -> u32 {
        self.as_slice().iter().map(|held| u32::from(*held)).sum()
    }

    /// Whether every criterion holds; true for a gate that has none.
    pub fn all(&self) -> bool {
        self.as_slice().iter().all(|held| *held)
    }
}
