//! The conditions that hold in a row, and the verdicts of both judges on the episode.

use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_rules::{Judge, JudgeOptions, Judges, Protocol, Row, Task};
use fiatlux_wire::{WireError, read_geometry, read_identity};
use serde::Serialize;

/// Flags of a row: bit `i` is criterion `i` of [`Conditions::criteria`]; the bits below come after them.
pub mod flag {
    pub const OLD_SEATED: u32 = 1 << 16;
    pub const FRESH_SEATED: u32 = 1 << 17;
    /// The published gate has fired in this row or earlier.
    pub const PUBLISHED: u32 = 1 << 18;
    /// The strict gate has fired in this row or earlier.
    pub const STRICT: u32 = 1 << 19;
    /// A bulb was broken in this row or earlier, by the judge in force.
    pub const BROKEN: u32 = 1 << 20;
    /// A bulb was dropped in this row or earlier.
    pub const DROPPED: u32 = 1 << 21;
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CriterionName {
    pub name: &'static str,
    /// Also a criterion of the published gate; if not, only of the strict gate.
    pub published: bool,
}

/// Criteria and windows of the task's gates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Conditions {
    /// Criteria of the strict gate, starting with those of the published one.
    pub criteria: Vec<CriterionName>,
    /// Number of consecutive rows for which all published criteria must hold.
    pub published_window: u32,
    /// Number of consecutive rows for which all criteria must hold, for the strict gate.
    pub strict_window: u32,
    /// Judge that was in force when the episode was played: `strict` or `published`.
    pub in_force: &'static str,
    /// Contact force on a hand body above which a bulb breaks, N.
    pub fragility_n: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ruling {
    /// Name of the judge: `strict` or `published`.
    pub protocol: &'static str,
    /// Cause of the end; `None` if the rows stop before it.
    pub end: Option<&'static str>,
    pub causes: Vec<&'static str>,
    pub success: bool,
    pub steps: u64,
    pub progress: f64,
    pub broken: bool,
    pub dropped: bool,
    /// Largest contact force of a bulb on a hand body, N.
    pub peak_hand_force_n: f64,
}

/// Judges rows by the rules that the header names.
#[derive(Debug)]
pub(crate) struct RowJudge {
    judges: Judges,
    task: Task,
    started: bool,
}

impl RowJudge {
    /// Prepares to judge an episode with this header.
    ///
    /// # Errors
    /// [`WireError`] if this version cannot judge it: its rows can still be shown.
    pub fn new(header: &EpisodeHeader) -> Result<Self, WireError> {
        let identity = read_identity(header)?;
        let geometry = read_geometry(&header.geometry)?;
        let options = JudgeOptions { end_on: Some(identity.ends_on), published_counting: false };
        let judges = Judges::new(identity.protocol, identity.task, &identity.thresholds, &geometry, options);
        Ok(Self { judges, task: identity.task, started: false })
    }

    /// Judges the next row, and returns its [`flag`]s.
    pub fn push(&mut self, row: &Row) -> u32 {
        if self.started {
            self.judges.advance(row);
        } else {
            self.judges.start(row);
            self.started = true;
        }
        let [published, strict] = Protocol::ALL.map(|protocol| self.judges.of(protocol).verdict());
        let criteria = strict.criteria.as_slice().iter().enumerate();
        let held = criteria.fold(0, |flags, (index, held)| flags | u32::from(*held) << index);
        let now = self.judges.in_force().verdict();
        let flags = [
            (published.success, flag::PUBLISHED),
            (strict.success, flag::STRICT),
            (now.broken, flag::BROKEN),
            (now.dropped, flag::DROPPED),
        ];
        flags.iter().filter(|(is, _)| *is).fold(held, |flags, (_, bit)| flags | bit)
    }

    pub fn conditions(&self) -> Conditions {
        let gate = &self.task.spec().gate;
        let published = gate.criteria.len();
        let criteria = gate.criteria_of(Protocol::Strict).enumerate();
        Conditions {
            criteria: criteria
                .map(|(index, criterion)| CriterionName { name: criterion.name, published: index < published })
                .collect(),
            published_window: gate.window(Protocol::Published),
            strict_window: gate.window(Protocol::Strict),
            in_force: self.judges.protocol().name(),
            fragility_n: self.judges.in_force().thresholds().fragility_n,
        }
    }

    /// The verdicts so far: published first, and strict if the episode was played by it.
    pub fn rulings(&self) -> Vec<Ruling> {
        let strict = (self.judges.protocol() == Protocol::Strict).then_some(Protocol::Strict);
        strict.into_iter().chain([Protocol::Published]).map(|protocol| ruling(self.judges.of(protocol))).collect()
    }
}

fn ruling(judge: &Judge) -> Ruling {
    let summary = judge.summary();
    Ruling {
        protocol: judge.protocol().name(),
        end: summary.end.map(|end| end.cause().name()),
        causes: summary.end.map_or_else(Vec::new, |end| end.causes.iter().map(|cause| cause.name()).collect()),
        success: summary.success,
        steps: summary.steps,
        progress: summary.gate_progress,
        broken: summary.broken,
        dropped: summary.dropped,
        peak_hand_force_n: summary.peak_hand_force_n,
    }
}
