//! Judges and scores episodes, whatever the task: gates that hold for a window, a fold of measured rows into a verdict by the
//! published or the strict protocol, the end of an episode, digest chains, and scores over episodes.
//!
//! A rulebook measures its rows and says by [`RowFacts`] what they show; [`Fold`] does the rest:
//!
//! ```
//! use fiatlux_judge::{Cause, Causes, Fold, FoldRules, Gate, Protocol, RowFacts};
//!
//! // One criterion, which must hold for two rows: the door is open.
//! let gate = Gate { criteria: &["open"], sustain_steps: 2, strict: &[], strict_steps: 2, goals: 1 };
//! let protocol = Protocol::Published;
//! let ends_on = Causes::of(&[Cause::Success, Cause::TimeOut]);
//! let rules = FoldRules { protocol, gate: gate.size(protocol), ends_on, spoilt_by: Causes::NONE, published_counting: false };
//! let facts = |step, is_open| RowFacts { step, ..RowFacts::new(gate.evaluate(protocol, |_| is_open)) };
//!
//! let mut fold = Fold::new(rules);
//! fold.start(&facts(0, false));
//! fold.advance(&facts(1, true), || 0);
//! assert_eq!((fold.verdict().progress, fold.verdict().success), (1.0, false));
//! fold.advance(&facts(2, true), || 0);
//! assert_eq!(fold.verdict().end.map(|end| end.cause()), Some(Cause::Success));
//! ```
mod cause;
mod chain;
mod fold;
mod gate;
mod protocol;
mod scores;
mod verdict;

pub use cause::{Cause, Causes, UnknownCause};
pub use chain::DigestChain;
pub use fold::{Fold, FoldRules, FoldState, RowFacts};
pub use gate::{Criteria, Gate, GateSize, MAX_CRITERIA};
pub use protocol::{Protocol, UnknownProtocol};
pub use scores::{Benchmark, Episode, Rate, ScoredTask, SeedScore, Spread, SubtaskScore, Summary, wilson_interval};
pub use verdict::{End, Verdict};
