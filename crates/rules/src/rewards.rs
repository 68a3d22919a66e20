//! Rewards, term by term.
//!
//! A term pays value x weight x 0.02 s in each control step. Gate progress is paid unscaled.

mod climb;
mod motion;
mod replace;
mod term;
mod training;

use crate::{Context, Judge, Row, Task, Verdict};

pub use motion::ANKLE_LIMITS;
pub use term::Term;
use term::{Ledger, TermSpec, View};

/// Which reward a subtask pays; `replace` and `climb` have one only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// Gate progress alone.
    Benchmark,
    /// Gate progress and shaping.
    Training,
}

/// Pays for the rows of one episode. Runs beside a [`Judge`], whose verdict it reads.
///
/// What is not finite pays nothing: a potential counts it as 0, a record passes over it, and a value drops out.
#[derive(Debug, Clone)]
pub struct Rewards {
    ledgers: Vec<Ledger>,
    terms: Vec<Term>,
    before: Option<Box<Row>>,
}

impl Rewards {
    /// The reward of the judge's task.
    pub fn new(judge: &Judge, variant: Variant) -> Self {
        let specs = match (judge.task(), variant) {
            (Task::Replace, _) => replace::terms(),
            (Task::Climb, _) => climb::terms(),
            (_, Variant::Benchmark) => vec![TermSpec::GATE_PROGRESS],
            (task, Variant::Training) => training::terms(task, judge.ends_on()),
        };
        let terms = specs.iter().map(Term::unpaid).collect();
        Self { ledgers: specs.into_iter().map(Ledger::new).collect(), terms, before: None }
    }

    /// Starts over with row 0, after the judge has.
    pub fn start(&mut self, judge: &Judge, row: &Row) {
        let context = judge.context();
        for (ledger, term) in self.ledgers.iter_mut().zip(&mut self.terms) {
            *term = Term::unpaid(ledger.spec());
            ledger.start(row, &context);
        }
        self.before = Some(Box::new(row.clone()));
    }

    /// What the next row pays, after the judge has judged it. Show it no row after the episode's end: it would pay.
    pub fn advance(&mut self, judge: &Judge, row: &Row) -> &[Term] {
        let (context, verdict): (Context<'_>, &Verdict) = (judge.context(), judge.verdict());
        if let Some(before) = &mut self.before {
            let view = View { before, row, context: &context, verdict };
            for (ledger, term) in self.ledgers.iter_mut().zip(&mut self.terms) {
                ledger.advance(&view, term);
            }
            before.as_mut().clone_from(row);
        }
        &self.terms
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
