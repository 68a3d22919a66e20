//! Rewards, term by term.
//!
//! A term pays value x weight x 0.02 s in each control step. Gate progress is paid unscaled.

use fiatlux_judge::{Cause, Causes, Verdict};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::judge::Judge;
use crate::parts::JointGroups;
use crate::row::Row;
use crate::spec::RewardSpec;
use crate::task::Task;
use crate::terms::motion;
use crate::terms::term::{Kind, Ledger, LedgerState, Term, TermSpec, View};

/// Weight of a success in training.
const SUCCESS: f64 = 500.0;
/// Weight of a failure in training.
const FAILURE: f64 = -200.0;
/// Weight of the sway in training on a subtask.
const COM_SWAY: f64 = -0.5;
/// Charged wherever failures are.
const DIVERGED: TermSpec = TermSpec::new("diverged", FAILURE, Kind::Condition(Cause::Diverged));

/// Which reward a subtask pays; `replace` and `climb` have one only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// Pays gate progress alone, as the benchmark scores it.
    Benchmark,
    /// Gate progress and shaping.
    Training,
}

/// Pays for the rows of one episode. Runs next to a [`Judge`], whose verdict it reads.
///
/// Numbers that are not finite pay nothing: a potential counts them as 0, a record ignores them, and a value drops out. A row
/// that diverged pays its failures alone.
#[derive(Debug, Clone)]
pub struct Rewards {
    ledgers: Vec<Ledger>,
    terms: Vec<Term>,
    joints: JointGroups,
    /// The last row; row 0 for good where no term looks at the one before.
    before: Option<Box<Row>>,
    looks_back: bool,
}

/// State of a reward's terms in an episode, for snapshots.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RewardsState(Vec<LedgerState>);

impl Rewards {
    /// The reward of the judge's task for a robot with these joints.
    pub fn new(judge: &Judge, variant: Variant, joints: JointGroups) -> Self {
        let specs = specs(judge.task(), judge.ends_on(), variant);
        let terms = specs.iter().map(Term::unpaid).collect();
        let looks_back = specs.iter().any(|spec| matches!(spec.kind, Kind::Rate(_)));
        Self { ledgers: specs.into_iter().map(Ledger::new).collect(), terms, joints, before: None, looks_back }
    }

    /// Starts over with row 0, after the judge has.
    pub fn start(&mut self, judge: &Judge, row: &Row) {
        let context = judge.context();
        for (ledger, term) in self.ledgers.iter_mut().zip(&mut self.terms) {
            *term = Term::unpaid(ledger.spec());
            ledger.start(row, &context);
        }
        self.look_back_at(row);
    }

    fn look_back_at(&mut self, row: &Row) {
        match &mut self.before {
            Some(before) => before.as_mut().clone_from(row),
            None => self.before = Some(Box::new(row.clone())),
        }
    }

    /// Pays for the next row, after the judge has judged it. Rows after the episode's end must not be given: they would be
    /// paid.
    pub fn advance(&mut self, judge: &Judge, row: &Row) -> &[Term] {
        let (context, verdict): (Context<'_>, &Verdict) = (judge.context(), judge.verdict());
        if let Some(before) = &mut self.before {
            let view = View { before, row, context: &context, joints: &self.joints, verdict };
            let diverged = verdict.conditions.contains(Cause::Diverged);
            for (ledger, term) in self.ledgers.iter_mut().zip(&mut self.terms) {
                if diverged && !matches!(ledger.spec().kind, Kind::Condition(_)) {
                    *term = Term::unpaid(ledger.spec());
                } else {
                    ledger.advance(&view, term);
                }
            }
            if self.looks_back {
                before.as_mut().clone_from(row);
            }
        }
        &self.terms
    }

    /// The state, from which [`Rewards::set_state`] continues exactly.
    pub fn state(&self) -> RewardsState {
        RewardsState(self.ledgers.iter().map(Ledger::state).collect())
    }

    /// Continues at a row from a state of the same terms, none of which then counts as paid. Returns false, and changes
    /// nothing, if the state has another number of terms.
    #[must_use]
    pub fn set_state(&mut self, RewardsState(states): RewardsState, row: &Row) -> bool {
        let fits = states.len() == self.ledgers.len();
        if fits {
            for ((ledger, term), state) in self.ledgers.iter_mut().zip(&mut self.terms).zip(states) {
                ledger.set_state(state);
                *term = Term::unpaid(ledger.spec());
            }
            self.look_back_at(row);
        }
        fits
    }

    /// The terms as last paid.
    pub fn terms(&self) -> &[Term] {
        &self.terms
    }

    /// Sum of what the last row paid.
    pub fn reward(&self) -> f64 {
        self.terms.iter().map(|term| term.reward).sum()
    }
}

/// The terms of a task's reward; failures are charged where they end the episode.
pub(crate) fn specs(task: Task, ends_on: Causes, variant: Variant) -> Vec<TermSpec> {
    match (task.spec().reward, variant) {
        (RewardSpec::Own { terms, com_sway }, _) => [terms, &[DIVERGED], &motion::terms(com_sway)].concat(),
        (RewardSpec::Subtask { .. }, Variant::Benchmark) => vec![TermSpec::GATE_PROGRESS],
        (RewardSpec::Subtask { hints }, Variant::Training) => training(hints, ends_on),
    }
}

/// Gate progress, success, failures that end the episode, the task's hints and motion.
fn training(hints: &[TermSpec], ends_on: Causes) -> Vec<TermSpec> {
    let mut terms = vec![TermSpec::GATE_PROGRESS];
    terms.push(TermSpec::new("success_bonus", SUCCESS, Kind::Condition(Cause::Success)));
    let failures = ends_on.iter().filter_map(|cause| Some((cause, failure_name(cause)?)));
    terms.extend(failures.map(|(cause, name)| TermSpec::new(name, FAILURE, Kind::Condition(cause))));
    terms.extend(hints);
    terms.extend(motion::terms(COM_SWAY));
    terms
}

/// Name of the term that charges a failure; `None` for what is none.
fn failure_name(cause: Cause) -> Option<&'static str> {
    match cause {
        Cause::Diverged => Some(DIVERGED.name),
        Cause::Fall => Some("robot_fall"),
        Cause::Tip => Some("ladder_tipped"),
        Cause::Crush => Some("bulb_crushed"),
        Cause::Drop => Some("bulb_dropped"),
        Cause::Unseated => Some("bulb_unseated"),
        Cause::Impact => Some("bulb_impact"),
        Cause::Success | Cause::TimeOut => None,
    }
}
