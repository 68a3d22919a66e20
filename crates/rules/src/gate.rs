//! A gate: conditions that must hold together.

use crate::geometry::Geometry;
use crate::row::{Bulb, Row};
use crate::settle::PoseSpeed;
use crate::thresholds::Thresholds;

/// What a predicate reads beside the row.
#[derive(Debug, Clone, Copy)]
pub struct Context<'a> {
    /// Numbers to compare with.
    pub thresholds: &'a Thresholds,
    /// The scene's constants.
    pub geometry: &'a Geometry,
    /// Low-passed speeds of both bulbs, by [`Bulb`].
    pub bulb_speeds: [PoseSpeed; 2],
    /// Heights below which the bulbs count as dropped in this task, by [`Bulb`], m.
    pub drop_heights: [f64; 2],
}

impl Context<'_> {
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
    /// Name in results.
    pub name: &'static str,
    /// Whether it holds.
    pub holds: Predicate,
}

/// Conditions that must hold at the same control step, for a number of consecutive ones.
#[derive(Debug, Clone, Copy)]
pub struct Gate {
    /// The conditions, at most [`MAX_CRITERIA`].
    pub criteria: &'static [Criterion],
    /// Consecutive control steps; 1 where one is enough.
    pub sustain_steps: u32,
}

/// Criteria of the longest gate.
pub const MAX_CRITERIA: usize = 5;

/// Which criteria of a gate hold in a row, in the gate's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Criteria {
    held: [bool; MAX_CRITERIA],
    len: usize,
}

impl Gate {
    /// Number of criteria.
    pub fn n(&self) -> u32 {
        self.criteria.len() as u32
    }

    /// Evaluates every criterion.
    pub fn evaluate(&self, row: &Row, context: &Context<'_>) -> Criteria {
        let mut criteria = Criteria { held: [false; MAX_CRITERIA], len: self.criteria.len().min(MAX_CRITERIA) };
        for (held, criterion) in criteria.held.iter_mut().zip(self.criteria) {
            *held = (criterion.holds)(row, context);
        }
        criteria
    }
}

impl Criteria {
    /// One entry a criterion.
    pub fn as_slice(&self) -> &[bool] {
        &self.held[..self.len]
    }

    /// How many hold.
    pub fn count(&self) -> u32 {
        self.as_slice().iter().map(|held| u32::from(*held)).sum()
    }

    /// Whether all hold.
    pub fn all(&self) -> bool {
        self.as_slice().iter().all(|held| *held)
    }
}
