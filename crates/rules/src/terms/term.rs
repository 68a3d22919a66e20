//! Reward terms, and the state that they keep.

use fiatlux_judge::{Cause, Verdict};

use crate::context::Context;
use crate::parts::JointGroups;
use crate::row::{CONTROL_DT, Row};

/// Shortest start distance that an approach is measured against, m (paper).
const MIN_START_DISTANCE: f64 = 1e-3;

/// The inputs of a term in a step.
pub(crate) struct View<'a> {
    pub before: &'a Row,
    pub row: &'a Row,
    pub context: &'a Context<'a>,
    pub joints: &'a JointGroups,
    pub verdict: &'a Verdict,
}

pub(crate) type Measure = fn(&Row, &Context<'_>) -> f64;

/// Formula of a term.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Kind {
    /// A value in each step.
    Rate(fn(&View<'_>) -> f64),
    /// Difference of the potential `clamp((d0 - d) / d0, 0, 1)` of a distance d that was d0 in row 0.
    Approach(Measure),
    /// Difference of a potential between 0 and 1.
    Potential(Measure),
    /// Rise of a measure above its best so far.
    Record(Measure),
    /// 1 on the first step on which a predicate holds.
    Once(fn(&Row, &Context<'_>) -> bool),
    /// 1 on the first step on which a condition is met.
    Condition(Cause),
    /// Rise of the gate progress, paid unscaled.
    GateProgress,
}

impl Kind {
    /// A name for digests, which cannot cover the functions themselves.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Rate(_) => "rate",
            Kind::Approach(_) => "approach",
            Kind::Potential(_) => "potential",
            Kind::Record(_) => "record",
            Kind::Once(_) => "once",
            Kind::Condition(cause) => cause.name(),
            Kind::GateProgress => "gate_progress",
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct TermSpec {
    pub name: &'static str,
    pub weight: f64,
    pub kind: Kind,
}

impl TermSpec {
    pub const GATE_PROGRESS: Self = Self::new("gate_progress", 1.0, Kind::GateProgress);

    pub const fn new(name: &'static str, weight: f64, kind: Kind) -> Self {
        Self { name, weight, kind }
    }
}

/// Payment of one term in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// Name of the term in results.
    pub name: &'static str,
    /// Value of the term before weighting.
    pub value: f64,
    /// Weight of the term in the reward.
    pub weight: f64,
    /// Contribution to the reward of the step.
    pub reward: f64,
}

impl Term {
    pub(crate) fn unpaid(spec: &TermSpec) -> Self {
        Self { name: spec.name, value: 0.0, weight: spec.weight, reward: 0.0 }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Ledger {
    spec: TermSpec,
    /// Start distance of an approach, m.
    start: f64,
    /// Last potential or progress, or best measure.
    level: f64,
    paid: bool,
}

/// State of a term in an episode: start, level, and true once it has paid.
pub(crate) type LedgerState = (f64, f64, bool);

impl Ledger {
    pub(crate) fn new(spec: TermSpec) -> Self {
        Self { spec, start: 0.0, level: 0.0, paid: false }
    }

    pub(crate) fn spec(&self) -> &TermSpec {
        &self.spec
    }

    pub(crate) fn state(&self) -> LedgerState {
        (self.start, self.level, self.paid)
    }

    pub(crate) fn set_state(&mut self, (start, level, paid): LedgerState) {
        *self = Self { spec: self.spec, start, level, paid };
    }

    pub(crate) fn start(&mut self, row: &Row, context: &Context<'_>) {
        *self = Self::new(self.spec);
        match self.spec.kind {
            Kind::Approach(distance) => {
                self.start = distance(row, context).max(MIN_START_DISTANCE);
                self.level = self.approach(distance(row, context));
            }
            Kind::Potential(potential) => self.level = bounded(potential(row, context)),
            Kind::Record(measure) => self.level = finite(measure(row, context)),
            Kind::Rate(_) | Kind::Once(_) | Kind::Condition(_) | Kind::GateProgress => {}
        }
    }

    pub(crate) fn advance(&mut self, view: &View<'_>, term: &mut Term) {
        let (row, context) = (view.row, view.context);
        let value = match self.spec.kind {
            Kind::Rate(rate) => rate(view),
            Kind::Approach(distance) => self.rise_to(self.approach(distance(row, context))),
            Kind::Potential(potential) => self.rise_to(bounded(potential(row, context))),
            Kind::GateProgress => self.rise_to(view.verdict.progress),
            Kind::Record(measure) => {
                // `max` takes the other where one is NaN.
                let best = finite(measure(row, context)).max(self.level);
                self.rise_to(best)
            }
            Kind::Once(predicate) => self.once(predicate(row, context)),
            Kind::Condition(cause) => self.once(view.verdict.conditions.contains(cause)),
        };
        let reward = match self.spec.kind {
            Kind::GateProgress => value,
            _ => value * term.weight * CONTROL_DT,
        };
        // A finite value can be too large to weight.
        (term.value, term.reward) = if reward.is_finite() { (value, reward) } else { (0.0, 0.0) };
    }

    fn approach(&self, distance: f64) -> f64 {
        bounded((self.start - distance) / self.start)
    }

    fn rise_to(&mut self, level: f64) -> f64 {
        level - std::mem::replace(&mut self.level, level)
    }

    fn once(&mut self, holds: bool) -> f64 {
        let pays = holds && !self.paid;
        self.paid |= holds;
        f64::from(u8::from(pays))
    }
}

/// Into [0, 1]; what is not finite is at the bottom.
fn bounded(potential: f64) -> f64 {
    if potential.is_finite() { potential.clamp(0.0, 1.0) } else { 0.0 }
}

/// An infinite measure becomes NaN.
fn finite(measure: f64) -> f64 {
    if measure.is_finite() { measure } else { f64::NAN }
}
