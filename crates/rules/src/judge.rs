//! The fold that judges an episode: its state follows from the rows alone.

mod state;

use crate::bulb_motion::BulbMotion;
use crate::cause::{Cause, Causes};
use crate::context::Context;
use crate::errand;
use crate::evidence::Evidence;
use crate::gate::{Criteria, Gate, MAX_CRITERIA};
use crate::geometry::Geometry;
use crate::predicates::standing;
use crate::protocol::Protocol;
use crate::row::Row;
use crate::scores::Summary;
use crate::strict::upright;
use crate::task::Task;
use crate::thresholds::Thresholds;
use crate::verdict::{End, Verdict};

pub(crate) use self::state::JudgeState;

/// Choices of a session or of a grading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct JudgeOptions {
    /// What ends an episode instead of the task's own conditions, besides [`Cause::Diverged`], which always does. Cleared
    /// conditions are still noted.
    pub end_on: Option<Causes>,
    /// Counts criteria as the published numbers do: `c0` in row 1, and in place of an episode's last row the reset
    /// state with that row's contact forces, which is what a simulator shows that resets within the step. Protocol `strict`
    /// ignores this.
    pub published_counting: bool,
}

/// Judges the rows of one episode, one at a time. Rows after the end change nothing.
///
/// Rows are consecutive. Where a row's number is not the last one plus 1, nothing is carried over the gap: the window
/// in which the gate must hold begins anew with this row, the bulbs' low-passed speeds start again from rest, and no
/// bulb was struck.
///
/// A row that diverged ends the episode as a failure. Nothing else of it counts: no criterion, no force, no drop.
///
/// Whatever numbers rows hold, nothing panics.
#[derive(Debug, Clone)]
pub struct Judge {
    protocol: Protocol,
    task: Task,
    thresholds: Thresholds,
    geometry: Geometry,
    options: JudgeOptions,
    /// Row 0, for the published way of counting.
    first_row: Option<Box<Row>>,
    first_step: u64,
    start_count: Option<u32>,
    /// Criteria that hold in row 0, for the strict way of counting.
    start_criteria: Criteria,
    motion: BulbMotion,
    /// Measurements of the last row.
    evidence: Evidence,
    /// Number of rows for which each criterion has held; protocol `strict` needs it.
    held_for: [u32; MAX_CRITERIA],
    squared_actions: f64,
    first_met: [Option<u64>; Cause::ALL.len()],
    verdict: Verdict,
}

/// The verdict before any row.
const UNJUDGED: Verdict = Verdict {
    step: 0,
    criteria: Criteria::NONE,
    count: 0,
    best_count: 0,
    progress: 0.0,
    sustained: 0,
    success: false,
    conditions: Causes::NONE,
    broken: false,
    dropped: false,
    leapt: false,
    reached_working_height: false,
    peak_hand_force_n: 0.0,
    peak_substep_force_n: 0.0,
    end: None,
};

impl Judge {
    /// A judge that has seen no row; [`Judge::start`] shows it row 0.
    pub fn new(
        protocol: Protocol,
        task: Task,
        thresholds: Thresholds,
        geometry: Geometry,
        options: JudgeOptions,
    ) -> Self {
        Self {
            protocol,
            task,
            thresholds,
            geometry,
            options,
            first_row: None,
            first_step: 0,
            start_count: None,
            start_criteria: Criteria::NONE,
            motion: BulbMotion::default(),
            evidence: Evidence::default(),
            held_for: [0; MAX_CRITERIA],
            squared_actions: 0.0,
            first_met: [None; Cause::ALL.len()],
            verdict: UNJUDGED,
        }
    }

    /// Forgets all rows, but keeps its options.
    fn forget(&mut self) {
        (self.first_row, self.first_step, self.start_count) = (None, 0, None);
        self.start_criteria = Criteria::NONE;
        (self.motion, self.evidence) = (BulbMotion::default(), Evidence::default());
        (self.held_for, self.squared_actions) = ([0; MAX_CRITERIA], 0.0);
        (self.first_met, self.verdict) = ([None; Cause::ALL.len()], UNJUDGED);
    }

    /// The rulebook by which it judges.
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The task that is judged.
    pub fn task(&self) -> Task {
        self.task
    }

    /// The thresholds that are in force.
    pub fn thresholds(&self) -> &Thresholds {
        &self.thresholds
    }

    /// Places and sizes in the scene that criteria measure against.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// The causes that end an episode.
    pub fn ends_on(&self) -> Causes {
        let usual = Causes::of(&[Cause::Success, Cause::Fall, Cause::TimeOut]);
        let chosen = self.options.end_on.unwrap_or_else(|| usual.union(self.task.spec().also_ends_on));
        chosen.union(Causes::of(&[Cause::Diverged]))
    }

    /// Verdict on the rows so far.
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// Criteria at the start, c0; `None` before the row that decides it.
    pub fn start_count(&self) -> Option<u32> {
        self.start_count
    }

    /// The first row that met a condition, whether or not that ended the episode.
    pub fn first_met(&self, cause: Cause) -> Option<u64> {
        self.first_met[cause as usize]
    }

    /// Largest contact force of a bulb on a hand body in the row last shown, N.
    pub fn hand_force_n(&self) -> f64 {
        self.evidence.hand_force_n
    }

    /// Context in which predicates read the row last shown.
    pub fn context(&self) -> Context<'_> {
        let Evidence { bulb_speeds, grip_speeds, .. } = self.evidence;
        Context { bulb_speeds, grip_speeds, ..at_rest(self.task, &self.thresholds, &self.geometry) }
    }

    /// Starts over with row 0, the reset state, whatever its number. Neither gate nor terminations read it, apart from
    /// c0.
    pub fn start(&mut self, row: &Row) -> &Verdict {
        self.forget();
        self.first_step = row.step;
        self.evidence = self.see(row);
        let criteria = self.gate().evaluate(self.protocol, row, &self.context());
        self.start_criteria = criteria;
        self.verdict.step = row.step;
        self.verdict.criteria = criteria;
        self.verdict.count = criteria.count();
        if self.options.published_counting && self.protocol == Protocol::Published {
            self.first_row = Some(Box::new(row.clone()));
        } else {
            self.count(criteria.count());
        }
        self.note_hands_and_bulbs();
        &self.verdict
    }

    /// Judges the next row, whose number is the last one plus 1.
    pub fn advance(&mut self, row: &Row) -> &Verdict {
        if self.verdict.end.is_none() {
            let evidence = self.see(row);
            self.judge(row, evidence);
        }
        &self.verdict
    }

    /// Measures the next row without judging it.
    pub(crate) fn see(&mut self, row: &Row) -> Evidence {
        let follows = self.evidence.step.checked_add(1) == Some(row.step);
        if !follows {
            self.motion = BulbMotion::default();
        }
        let steps = self.steps_at(row.step);
        let cx = at_rest(self.task, &self.thresholds, &self.geometry);
        Evidence::of(row, follows, steps, &mut self.motion, self.task.spec(), &cx)
    }

    /// Judges a row with the measurements of any judge of the same task and thresholds.
    pub(crate) fn judge(&mut self, row: &Row, evidence: Evidence) {
        if self.verdict.end.is_some() {
            return;
        }
        self.evidence = evidence;
        if !evidence.follows {
            self.verdict.sustained = 0;
            self.held_for = [0; MAX_CRITERIA];
        }
        self.squared_actions += evidence.squared_action;
        let criteria = self.gate().evaluate(self.protocol, row, &self.context());
        for (rows, held) in self.held_for.iter_mut().zip(criteria.as_slice()) {
            *rows = if *held { *rows + 1 } else { 0 };
        }
        let diverged = evidence.conditions.contains(Cause::Diverged);
        let v = &mut self.verdict;
        v.step = row.step;
        v.criteria = criteria;
        v.count = criteria.count();
        if diverged {
            (v.sustained, v.success) = (0, false);
        } else {
            v.sustained = if criteria.all() { v.sustained + 1 } else { 0 };
            self.note_hands_and_bulbs();
        }
        self.note_conditions();
        if diverged {
            return;
        }
        let counted = match (&self.first_row, self.verdict.end) {
            (Some(first), Some(_)) => self.count_after_reset(first, row),
            _ if self.protocol == Protocol::Strict => self.count_sustained(row),
            _ => criteria.count(),
        };
        self.count(counted);
    }

    /// Summary of the episode so far.
    pub fn summary(&self) -> Summary {
        let v = &self.verdict;
        let steps = self.steps_at(v.step);
        Summary {
            task: self.task,
            success: v.success,
            broken: v.broken,
            dropped: v.dropped,
            gate_progress: v.progress,
            peak_hand_force_n: v.peak_hand_force_n,
            control_effort: if steps == 0 { 0.0 } else { self.squared_actions / steps as f64 },
            steps,
            end: v.end,
            reached_working_height: v.reached_working_height,
        }
    }

    fn gate(&self) -> &'static Gate {
        &self.task.spec().gate
    }

    /// Control steps from the start to a row.
    fn steps_at(&self, step: u64) -> u64 {
        step.saturating_sub(self.first_step)
    }

    /// Updates c0, the best count and the progress with a number of criteria.
    fn count(&mut self, count: u32) {
        let n = self.gate().n(self.protocol);
        let c0 = *self.start_count.get_or_insert(count);
        let best = self.verdict.best_count.max(count);
        self.verdict.best_count = best;
        self.verdict.progress = if c0 >= n { 1.0 } else { f64::from(best.saturating_sub(c0)) / f64::from(n - c0) };
    }

    /// Number of criteria as counted by a simulator that has already reset the scene, but not the contact forces.
    fn count_after_reset(&self, first: &Row, last: &Row) -> u32 {
        let mut reset = first.clone();
        for measure in errand::HAND_FORCE {
            reset.force_mut(measure).copy_from_slice(last.force(measure));
        }
        let context = at_rest(self.task, &self.thresholds, &self.geometry);
        self.gate().evaluate(self.protocol, &reset, &context).count()
    }

    /// Criteria that have held for the gate's window, see [`Gate::goals`]; none where the robot does not stand or something is
    /// spoilt, so that falling with an open hand is worth nothing.
    fn count_sustained(&self, row: &Row) -> u32 {
        let context = self.context();
        if self.is_spoilt() || !standing(row, &context) || !upright(row, &context) {
            return 0;
        }
        let gate = self.gate();
        let lasts = self.held_for.map(|rows| rows >= gate.window(self.protocol));
        let at_start = self.start_criteria.as_slice().iter();
        let counts = |(i, held): (usize, &bool)| lasts[i] && (lasts[0] || i < gate.goals || *held);
        at_start.enumerate().filter(|criterion| counts(*criterion)).count() as u32
    }

    /// Whether something broke, was dropped, fell or tipped, or the robot leapt, in this row or earlier.
    fn is_spoilt(&self) -> bool {
        let v = &self.verdict;
        v.broken
            || v.dropped
            || v.leapt
            || [Cause::Fall, Cause::Tip, Cause::Crush].iter().any(|cause| self.first_met(*cause).is_some())
    }

    /// Forces and drops count in every row.
    fn note_hands_and_bulbs(&mut self) {
        let breaks = self.breaks();
        let (seen, v) = (&self.evidence, &mut self.verdict);
        v.peak_hand_force_n = v.peak_hand_force_n.max(seen.hand_force_n);
        v.peak_substep_force_n = v.peak_substep_force_n.max(seen.substep_force_n);
        v.broken |= breaks;
        v.dropped |= seen.drops;
        v.leapt |= seen.leaps;
        v.reached_working_height |= seen.is_high;
    }

    /// Published: a hand presses too hard in the last physics step. Strict: anything does in any physics step, or strikes it, but
    /// for the first rows.
    fn breaks(&self) -> bool {
        let Evidence { step, hand_force_n, bulb_force_n, has_blow, .. } = self.evidence;
        let limit = self.thresholds.fragility_n;
        match self.protocol {
            Protocol::Published => hand_force_n > limit,
            Protocol::Strict if self.steps_at(step) <= u64::from(self.thresholds.impact_exempt_rows) => false,
            Protocol::Strict => bulb_force_n > limit || has_blow,
        }
    }

    /// Conditions that the row meets, and the end that follows from those in force.
    fn note_conditions(&mut self) {
        let Evidence { step, mut conditions, .. } = self.evidence;
        for cause in conditions.iter() {
            self.first_met[cause as usize].get_or_insert(step);
        }
        let window = self.gate().window(self.protocol);
        let may_fire =
            !conditions.contains(Cause::Diverged) && (self.protocol == Protocol::Published || !self.is_spoilt());
        let fires = may_fire && !self.verdict.success && self.verdict.sustained >= window;
        if fires {
            conditions = conditions.union(Causes::of(&[Cause::Success]));
            self.first_met[Cause::Success as usize].get_or_insert(step);
        }
        let ending = conditions.intersection(self.ends_on());
        self.verdict.success |= fires;
        self.verdict.conditions = conditions;
        if !ending.is_empty() {
            self.verdict.end = Some(End { step, causes: ending });
        }
    }
}

/// The context of a task, with bulbs that do not move.
fn at_rest<'a>(task: Task, thresholds: &'a Thresholds, geometry: &'a Geometry) -> Context<'a> {
    Context::at_rest((task.spec().special.fresh_drop_m)(thresholds), thresholds, geometry)
}
