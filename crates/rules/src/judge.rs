//! The judge of the errand: it measures rows, and a fold makes a verdict of them.

use fiatlux_judge::{Cause, Causes, Criteria, Fold, FoldRules, FoldState, Protocol, RowFacts, Verdict};
use serde::{Deserialize, Serialize};

use crate::bulb_motion::BulbMotion;
use crate::context::{Context, Gate};
use crate::errand;
use crate::evidence::Evidence;
use crate::geometry::Geometry;
use crate::predicates::standing;
use crate::row::Row;
use crate::strict::upright;
use crate::task::{Summary, Task};
use crate::thresholds::Thresholds;

/// Choices of a session or of a grading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct JudgeOptions {
    /// Causes that end an episode in place of the task's own, besides [`Cause::Diverged`], which always does. The task's own
    /// are still noted.
    pub end_on: Option<Causes>,
    /// Counts criteria as the published numbers do: `c0` in row 1, and in place of an episode's last row the reset
    /// state with that row's contact forces, which is what a simulator shows that resets within the step. Protocol `strict`
    /// ignores this.
    pub published_counting: bool,
}

/// Causes that spoil an episode for good by protocol `strict`, besides something broken or dropped and a leap.
const SPOILT_BY: Causes = Causes::of(&[Cause::Fall, Cause::Tip, Cause::Crush]);

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
    task: Task,
    thresholds: Thresholds,
    geometry: Geometry,
    /// Row 0, for the published way of counting.
    first_row: Option<Box<Row>>,
    motion: BulbMotion,
    /// Measurements of the last row.
    evidence: Evidence,
    fold: Fold,
}

/// State of a judge, for snapshots. Published counting is left out: only gradings use it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct JudgeState {
    motion: BulbMotion,
    evidence: Evidence,
    fold: FoldState,
}

impl Judge {
    /// A judge that has seen no row; [`Judge::start`] shows it row 0.
    pub fn new(
        protocol: Protocol,
        task: Task,
        thresholds: Thresholds,
        geometry: Geometry,
        options: JudgeOptions,
    ) -> Self {
        let usual = Causes::of(&[Cause::Success, Cause::Fall, Cause::TimeOut]);
        let chosen = options.end_on.unwrap_or_else(|| usual.union(task.spec().also_ends_on));
        let rules = FoldRules {
            protocol,
            gate: task.spec().gate.size(protocol),
            ends_on: chosen.union(Causes::of(&[Cause::Diverged])),
            spoilt_by: SPOILT_BY,
            published_counting: options.published_counting && protocol == Protocol::Published,
        };
        let (motion, evidence) = (BulbMotion::default(), Evidence::default());
        Self { task, thresholds, geometry, first_row: None, motion, evidence, fold: Fold::new(rules) }
    }

    /// The rulebook by which it judges.
    pub fn protocol(&self) -> Protocol {
        self.fold.rules().protocol
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
        self.fold.rules().ends_on
    }

    /// Verdict on the rows so far.
    pub fn verdict(&self) -> &Verdict {
        self.fold.verdict()
    }

    /// Criteria at the start, c0; `None` before the row that decides it.
    pub fn start_count(&self) -> Option<u32> {
        self.fold.start_count()
    }

    /// The first row that met a condition, whether or not that ended the episode.
    pub fn first_met(&self, cause: Cause) -> Option<u64> {
        self.fold.first_met(cause)
    }

    /// Largest contact force of a bulb on a hand body in the row last shown, N.
    pub fn hand_force_n(&self) -> f64 {
        self.evidence.hand_force_n
    }

    /// Summary of the episode so far.
    pub fn summary(&self) -> Summary {
        self.fold.summary(self.task)
    }

    /// Context in which predicates read the row last shown.
    pub fn context(&self) -> Context<'_> {
        let Evidence { bulb_speeds, grip_speeds, .. } = self.evidence;
        Context { bulb_speeds, grip_speeds, ..at_rest(self.task, &self.thresholds, &self.geometry) }
    }

    /// Starts over with row 0, the reset state, whatever its number. Neither gate nor terminations read it, apart from
    /// c0.
    pub fn start(&mut self, row: &Row) -> &Verdict {
        (self.motion, self.evidence) = (BulbMotion::default(), Evidence::default());
        self.first_row = self.fold.rules().published_counting.then(|| Box::new(row.clone()));
        self.evidence = self.measure(row, 0);
        let facts = self.facts(row, 0);
        self.fold.start(&facts);
        self.fold.verdict()
    }

    /// Judges the next row, whose number is the last one plus 1.
    pub fn advance(&mut self, row: &Row) -> &Verdict {
        if self.verdict().end.is_none() {
            let evidence = self.see(row);
            self.judge(row, evidence);
        }
        self.fold.verdict()
    }

    /// Measures the next row without judging it.
    pub(crate) fn see(&mut self, row: &Row) -> Evidence {
        self.measure(row, self.fold.steps_at(row.step))
    }

    /// Judges a row with the measurements of any judge of the same task and thresholds.
    pub(crate) fn judge(&mut self, row: &Row, evidence: Evidence) {
        if self.verdict().end.is_some() {
            return;
        }
        self.evidence = evidence;
        let facts = self.facts(row, self.fold.steps_at(row.step));
        let Self { task, thresholds, geometry, first_row, fold, .. } = self;
        let at_end = || match first_row {
            Some(first) => count_after_reset(first, row, &at_rest(*task, thresholds, geometry), &task.spec().gate),
            None => facts.criteria.count(),
        };
        fold.advance(&facts, at_end);
    }

    pub(crate) fn state(&self) -> JudgeState {
        JudgeState { motion: self.motion.clone(), evidence: self.evidence, fold: self.fold.state().clone() }
    }

    pub(crate) fn set_state(&mut self, JudgeState { motion, evidence, fold }: JudgeState) {
        (self.first_row, self.motion, self.evidence) = (None, motion, evidence);
        self.fold.set_state(fold);
    }

    /// Measures a row, `steps` after the start.
    fn measure(&mut self, row: &Row, steps: u64) -> Evidence {
        let follows = self.evidence.step.checked_add(1) == Some(row.step);
        if !follows {
            self.motion = BulbMotion::default();
        }
        let cx = at_rest(self.task, &self.thresholds, &self.geometry);
        Evidence::of(row, follows, steps, &mut self.motion, self.task.spec(), &cx)
    }

    /// Facts of the row to which the measurements belong, `steps` after the start.
    fn facts(&self, row: &Row, steps: u64) -> RowFacts {
        let (seen, cx, protocol) = (&self.evidence, self.context(), self.protocol());
        RowFacts {
            step: row.step,
            follows: seen.follows,
            criteria: evaluate(&self.task.spec().gate, protocol, row, &cx),
            conditions: seen.conditions,
            breaks: self.breaks(steps),
            drops: seen.drops,
            leaps: seen.leaps,
            stands: protocol == Protocol::Strict && standing(row, &cx) && upright(row, &cx),
            is_high: seen.is_high,
            hand_force_n: seen.hand_force_n,
            substep_force_n: seen.substep_force_n,
            squared_action: seen.squared_action,
        }
    }

    /// Published: a hand presses too hard in the last physics step. Strict: anything does in any physics step, or strikes it, but
    /// for the first rows.
    fn breaks(&self, steps: u64) -> bool {
        let Evidence { hand_force_n, bulb_force_n, has_blow, .. } = self.evidence;
        let limit = self.thresholds.fragility_n;
        match self.protocol() {
            Protocol::Published => hand_force_n > limit,
            Protocol::Strict if steps <= u64::from(self.thresholds.impact_exempt_rows) => false,
            Protocol::Strict => bulb_force_n > limit || has_blow,
        }
    }
}

/// The context of a task, with bulbs that do not move.
fn at_rest<'a>(task: Task, thresholds: &'a Thresholds, geometry: &'a Geometry) -> Context<'a> {
    Context::at_rest((task.spec().special.fresh_drop_m)(thresholds), thresholds, geometry)
}

fn evaluate(gate: &Gate, protocol: Protocol, row: &Row, cx: &Context<'_>) -> Criteria {
    gate.evaluate(protocol, |criterion| (criterion.holds)(row, cx))
}

/// Number of published criteria as counted by a simulator that has already reset the scene, but not the contact forces.
fn count_after_reset(first: &Row, last: &Row, cx: &Context<'_>, gate: &Gate) -> u32 {
    let mut reset = first.clone();
    for measure in errand::HAND_FORCE {
        reset.force_mut(measure).copy_from_slice(last.force(measure));
    }
    evaluate(gate, Protocol::Published, &reset, cx).count()
}
