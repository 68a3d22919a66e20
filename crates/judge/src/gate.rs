//! Gates: conditions that must hold together.

use serde::{Deserialize, Serialize};

use crate::protocol::Protocol;

/// Conditions that must hold at the same control step, for a number of consecutive ones. `C` is one condition.
#[derive(Debug, Clone, Copy)]
pub struct Gate<C: 'static> {
    /// The conditions, at most [`MAX_CRITERIA`] with those of `strict`.
    pub criteria: &'static [C],
    /// Number of consecutive control steps; 1 if a single one is enough.
    pub sustain_steps: u32,
    /// Additional criteria of protocol `strict`.
    pub strict: &'static [C],
    /// Consecutive control steps in protocol `strict`.
    pub strict_steps: u32,
    /// Number of criteria, from the first, that are the task's goal. Strict progress counts the others only if they hold in row
    /// 0, or once the very first has held: only the goal itself is progress.
    pub goals: usize,
}

/// Criteria of the longest gate.
pub const MAX_CRITERIA: usize = 10;

/// Which criteria of a gate hold in a row, in the gate's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Criteria {
    held: [bool; MAX_CRITERIA],
    len: usize,
}

/// The numbers of a gate by one protocol, which a [`Fold`](crate::Fold) needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GateSize {
    /// Number of criteria.
    pub n: u32,
    /// Number of consecutive control steps for which they must hold.
    pub window: u32,
    /// As [`Gate::goals`].
    pub goals: usize,
}

impl<C> Gate<C> {
    /// The criteria of a protocol, the published ones first.
    pub fn criteria_of(&self, protocol: Protocol) -> impl Iterator<Item = &'static C> + use<C> {
        let strict: &[C] = match protocol {
            Protocol::Published => &[],
            Protocol::Strict => self.strict,
        };
        self.criteria.iter().chain(strict)
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

    /// Its numbers by a protocol.
    pub fn size(&self, protocol: Protocol) -> GateSize {
        GateSize { n: self.n(protocol), window: self.window(protocol), goals: self.goals }
    }

    /// Evaluates every criterion of a protocol.
    pub fn evaluate(&self, protocol: Protocol, holds: impl Fn(&C) -> bool) -> Criteria {
        let mut criteria = Criteria::default();
        for (held, criterion) in criteria.held.iter_mut().zip(self.criteria_of(protocol)) {
            *held = holds(criterion);
            criteria.len += 1;
        }
        criteria
    }
}

impl Criteria {
    /// Criteria of no gate: none.
    pub const NONE: Self = Self { held: [false; MAX_CRITERIA], len: 0 };

    /// One entry for each criterion.
    pub fn as_slice(&self) -> &[bool] {
        // A damaged snapshot may have any length.
        self.held.get(..self.len).unwrap_or_default()
    }

    /// Number of criteria that hold.
    pub fn count(&self) -> u32 {
        self.as_slice().iter().map(|held| u32::from(*held)).sum()
    }

    /// True if every criterion holds; also for a gate that has none.
    pub fn all(&self) -> bool {
        self.as_slice().iter().all(|held| *held)
    }
}
