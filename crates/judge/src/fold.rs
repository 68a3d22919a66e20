//! The fold that judges an episode: its state follows from the measured rows alone.

use serde::{Deserialize, Serialize};

use crate::cause::{Cause, Causes};
use crate::gate::{Criteria, GateSize, MAX_CRITERIA};
use crate::protocol::Protocol;
use crate::scores::Summary;
use crate::verdict::{End, Verdict};

/// The facts of a row that a fold needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowFacts {
    /// Number of the row.
    pub step: u64,
    /// This is the number of the row before plus 1.
    pub follows: bool,
    /// Criteria of the gate.
    pub criteria: Criteria,
    /// Conditions that it meets but for success, which follows from the rows before.
    pub conditions: Causes,
    /// Something broke.
    pub breaks: bool,
    /// Something was dropped that must not be, even if this does not end the episode.
    pub drops: bool,
    /// The robot rises or sinks faster than anybody climbs.
    pub leaps: bool,
    /// The robot is upright on its feet. Without it the strict way of counting counts no criterion.
    pub stands: bool,
    /// The pelvis is at working height.
    pub is_high: bool,
    /// Largest contact force on a hand body, N.
    pub hand_force_n: f64,
    /// The same over the physics steps, N.
    pub substep_force_n: f64,
    /// Sum of the action's squares.
    pub squared_action: f64,
}

impl RowFacts {
    /// A row of step 0 that follows, in which nothing but these criteria holds.
    pub fn new(criteria: Criteria) -> Self {
        Self {
            step: 0,
            follows: true,
            criteria,
            conditions: Causes::NONE,
            breaks: false,
            drops: false,
            leaps: false,
            stands: false,
            is_high: false,
            hand_force_n: 0.0,
            substep_force_n: 0.0,
            squared_action: 0.0,
        }
    }
}

/// By what a fold judges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FoldRules {
    /// Decides how criteria are counted, and if a spoilt episode may succeed.
    pub protocol: Protocol,
    /// The gate by that protocol.
    pub gate: GateSize,
    /// The causes that end the episode.
    pub ends_on: Causes,
    /// The causes that spoil it for good by protocol `strict`, as something broken or dropped and a leap do.
    pub spoilt_by: Causes,
    /// Counts criteria as the published numbers do: c0 in row 1, and in the last row another number, see [`Fold::advance`].
    pub published_counting: bool,
}

/// Folds the facts of an episode's rows into a verdict, one at a time. Rows after the end change nothing.
///
/// Where a row does not follow the one before, the window in which the gate must hold begins anew with it. A row that diverged ends
/// the episode as a failure, and nothing else of it counts.
#[derive(Debug, Clone)]
pub struct Fold {
    rules: FoldRules,
    state: FoldState,
}

/// State of a fold, for snapshots.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FoldState {
    first_step: u64,
    start_count: Option<u32>,
    /// Criteria that hold in row 0, for the strict way of counting.
    start_criteria: Criteria,
    /// Number of rows for which each criterion has held; protocol `strict` needs it.
    held_for: [u32; MAX_CRITERIA],
    squared_actions: f64,
    first_met: [Option<u64>; Cause::ALL.len()],
    verdict: Verdict,
}

impl FoldState {
    /// Before any row.
    const EMPTY: Self = Self {
        first_step: 0,
        start_count: None,
        start_criteria: Criteria::NONE,
        held_for: [0; MAX_CRITERIA],
        squared_actions: 0.0,
        first_met: [None; Cause::ALL.len()],
        verdict: Verdict::UNJUDGED,
    };
}

impl Fold {
    /// A fold that has seen no row.
    pub fn new(rules: FoldRules) -> Self {
        Self { rules, state: FoldState::EMPTY }
    }

    /// By what it judges.
    pub fn rules(&self) -> &FoldRules {
        &self.rules
    }

    /// Verdict on the rows so far.
    pub fn verdict(&self) -> &Verdict {
        &self.state.verdict
    }

    /// Criteria at the start, c0; `None` before the row that decides it.
    pub fn start_count(&self) -> Option<u32> {
        self.state.start_count
    }

    /// The first row that met a condition, whether or not that ended the episode.
    pub fn first_met(&self, cause: Cause) -> Option<u64> {
        self.state.first_met[cause as usize]
    }

    /// Control steps from the start to a row.
    pub fn steps_at(&self, step: u64) -> u64 {
        step.saturating_sub(self.state.first_step)
    }

    /// The state, from which [`Fold::set_state`] continues exactly.
    pub fn state(&self) -> &FoldState {
        &self.state
    }

    /// Continues from a state of a fold by the same rules.
    pub fn set_state(&mut self, state: FoldState) {
        self.state = state;
    }

    /// Starts over with row 0, the reset state, whatever its number. Neither gate nor terminations read it, apart from
    /// c0.
    pub fn start(&mut self, facts: &RowFacts) {
        self.state = FoldState { first_step: facts.step, start_criteria: facts.criteria, ..FoldState::EMPTY };
        let v = &mut self.state.verdict;
        (v.step, v.criteria, v.count) = (facts.step, facts.criteria, facts.criteria.count());
        if !self.rules.published_counting {
            self.count(facts.criteria.count());
        }
        self.note_what_stays(facts);
    }

    /// Judges the next row. `count_at_end` is the number of criteria that the published way of counting has in place of this row's
    /// where it is the last one.
    pub fn advance(&mut self, facts: &RowFacts, count_at_end: impl FnOnce() -> u32) {
        if self.state.verdict.end.is_some() {
            return;
        }
        let state = &mut self.state;
        if !facts.follows {
            state.verdict.sustained = 0;
            state.held_for = [0; MAX_CRITERIA];
        }
        state.squared_actions += facts.squared_action;
        for (rows, held) in state.held_for.iter_mut().zip(facts.criteria.as_slice()) {
            *rows = if *held { *rows + 1 } else { 0 };
        }
        let diverged = facts.conditions.contains(Cause::Diverged);
        let v = &mut state.verdict;
        (v.step, v.criteria, v.count) = (facts.step, facts.criteria, facts.criteria.count());
        if diverged {
            (v.sustained, v.success) = (0, false);
        } else {
            v.sustained = if facts.criteria.all() { v.sustained + 1 } else { 0 };
            self.note_what_stays(facts);
        }
        self.note_conditions(facts);
        if diverged {
            return;
        }
        let counted = match self.rules.protocol {
            _ if self.rules.published_counting && self.state.verdict.end.is_some() => count_at_end(),
            Protocol::Strict => self.count_sustained(facts.stands),
            Protocol::Published => facts.criteria.count(),
        };
        self.count(counted);
    }

    /// Summary of the episode so far.
    pub fn summary<T>(&self, task: T) -> Summary<T> {
        let v = &self.state.verdict;
        let steps = self.steps_at(v.step);
        Summary {
            task,
            success: v.success,
            broken: v.broken,
            dropped: v.dropped,
            gate_progress: v.progress,
            peak_hand_force_n: v.peak_hand_force_n,
            control_effort: if steps == 0 { 0.0 } else { self.state.squared_actions / steps as f64 },
            steps,
            end: v.end,
            reached_working_height: v.reached_working_height,
        }
    }

    /// Updates c0, the best count and the progress with a number of criteria.
    fn count(&mut self, count: u32) {
        let n = self.rules.gate.n;
        let c0 = *self.state.start_count.get_or_insert(count);
        let v = &mut self.state.verdict;
        v.best_count = v.best_count.max(count);
        v.progress = if c0 >= n { 1.0 } else { f64::from(v.best_count.saturating_sub(c0)) / f64::from(n - c0) };
    }

    /// Criteria that have held for the gate's window, see [`Gate::goals`](crate::Gate::goals); none where the robot does not stand or
    /// something is spoilt, so that falling with an open hand is worth nothing.
    fn count_sustained(&self, stands: bool) -> u32 {
        if self.is_spoilt() || !stands {
            return 0;
        }
        let GateSize { window, goals, .. } = self.rules.gate;
        let lasts = self.state.held_for.map(|rows| rows >= window);
        let at_start = self.state.start_criteria.as_slice().iter();
        let counts = |(i, held): (usize, &bool)| lasts[i] && (lasts[0] || i < goals || *held);
        at_start.enumerate().filter(|criterion| counts(*criterion)).count() as u32
    }

    /// True if something broke, was dropped or met a spoiling condition, or the robot leapt, in this row or earlier.
    fn is_spoilt(&self) -> bool {
        let v = &self.state.verdict;
        v.broken || v.dropped || v.leapt || self.rules.spoilt_by.iter().any(|cause| self.first_met(cause).is_some())
    }

    /// Forces and drops count in every row.
    fn note_what_stays(&mut self, facts: &RowFacts) {
        let v = &mut self.state.verdict;
        v.peak_hand_force_n = v.peak_hand_force_n.max(facts.hand_force_n);
        v.peak_substep_force_n = v.peak_substep_force_n.max(facts.substep_force_n);
        v.broken |= facts.breaks;
        v.dropped |= facts.drops;
        v.leapt |= facts.leaps;
        v.reached_working_height |= facts.is_high;
    }

    /// Conditions that the row meets, and the end that follows from those in force.
    fn note_conditions(&mut self, facts: &RowFacts) {
        let mut conditions = facts.conditions;
        for cause in conditions.iter() {
            self.state.first_met[cause as usize].get_or_insert(facts.step);
        }
        let may_fire =
            !conditions.contains(Cause::Diverged) && (self.rules.protocol == Protocol::Published || !self.is_spoilt());
        let (rules, state) = (&self.rules, &mut self.state);
        let v = &mut state.verdict;
        let fires = may_fire && !v.success && v.sustained >= rules.gate.window;
        if fires {
            conditions = conditions.union(Causes::of(&[Cause::Success]));
            state.first_met[Cause::Success as usize].get_or_insert(facts.step);
        }
        let ending = conditions.intersection(rules.ends_on);
        v.success |= fires;
        v.conditions = conditions;
        if !ending.is_empty() {
            v.end = Some(End { step: facts.step, causes: ending });
        }
    }
}
