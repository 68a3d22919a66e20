//! One episode graded from its rows. No file is read here.

use std::collections::BTreeMap;

use fiatlux_proto::{ABORTED, PROTOCOL, is_compatible, v3};
use fiatlux_rules::{Cause, Causes, Judge, JudgeOptions, Row, RowDigest, Summary, Task, ThresholdError, Thresholds};
use fiatlux_wire::{WireError, read_geometry};
use thiserror::Error;

use crate::Series;
use crate::series::Recorder;

/// Why an episode cannot be graded from its header.
#[derive(Debug, Error)]
pub enum HeaderError {
    /// Another major version of the protocol.
    #[error(
        "the bag is of protocol {found}, this scorer reads {PROTOCOL}; grade it with the scorer of its own version, or \
         record the episode again"
    )]
    Protocol {
        /// Version of the bag.
        found: v3::Version,
    },
    /// The task.
    #[error("the header's task is unknown; the bag may come from another version")]
    Task(#[from] fiatlux_rules::UnknownTask),
    /// The thresholds.
    #[error("the header's thresholds cannot be taken; the bag may come from another version")]
    Threshold(#[from] ThresholdError),
    /// The conditions that end it.
    #[error("the header's end conditions are unknown; the bag may come from another version")]
    Cause(#[from] fiatlux_rules::UnknownCause),
    /// The scene's constants.
    #[error("cannot read the header; the bag may come from another version")]
    Wire(#[from] WireError),
    /// The start of the digest chain.
    #[error("digest_context in the header is not 64 hexadecimal digits; the bag may come from another version")]
    Context,
    /// Rows that this version digests in another way.
    #[error("the bag's digest has the layout {0}, this scorer knows {known}; use the scorer of that version", known = fiatlux_rules::ROW_LAYOUT)]
    Layout(String),
}

/// Why an episode is listed, but not scored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Flaw {
    /// It was stopped before its end.
    Aborted,
    /// It has no result.
    Unended,
    /// Its rows do not follow each other, or do not reach its end.
    Gap(String),
    /// Its rows are not those that the result was made of.
    Altered {
        /// Digest of its rows.
        rows: String,
        /// Digest in its result.
        result: String,
    },
    /// A row has a number that is not finite.
    NotFinite,
}

impl std::fmt::Display for Flaw {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let short = |digest: &str| digest.chars().take(12).collect::<String>();
        match self {
            Flaw::Aborted => f.write_str("aborted: the episode was stopped before its end"),
            Flaw::Unended => f.write_str("the recording has no result"),
            Flaw::Gap(what) => f.write_str(what),
            Flaw::Altered { rows, result } => {
                let (rows, result) = (short(rows), short(result));
                write!(f, "the bag's numbers were changed: its rows have digest {rows}, its result says {result}")
            }
            Flaw::NotFinite => f.write_str("a row has a number that is not finite"),
        }
    }
}

/// What the rows of an episode say.
#[derive(Debug, Clone)]
pub struct Graded {
    /// By the rows alone.
    pub summary: Summary,
    /// What ended it: by this grading's rules, else as recorded.
    pub end: String,
    /// All conditions that the last judged row met and that could end it.
    pub causes: Vec<String>,
    /// Thresholds that it was judged by.
    pub thresholds: Thresholds,
    /// SHA-256 chain over its rows, hexadecimal.
    pub digest: String,
    /// Steps, of those judged, in which all criteria of the gate held.
    pub steps_in_gate: u64,
    /// Its figure.
    pub series: Series,
    /// What a reader should know about it.
    pub notes: Vec<String>,
    /// Why it is not scored; `None` where it is.
    pub flaw: Option<Flaw>,
}

/// Grades one episode, row by row.
#[derive(Debug)]
pub struct Grader {
    judge: Judge,
    digest: RowDigest,
    recorder: Recorder,
    next_step: u64,
    gap: Option<String>,
    steps_in_gate: u64,
    rejudged: bool,
}

impl Grader {
    /// For an episode with this header; `set` are thresholds in place of the header's, as `key=value`.
    ///
    /// # Errors
    /// [`HeaderError`] where the header names what this version does not know.
    pub fn new(header: &v3::EpisodeHeader, set: &[String], published_counting: bool) -> Result<Self, HeaderError> {
        let protocol = header.protocol.unwrap_or_default();
        if !is_compatible(&protocol) {
            return Err(HeaderError::Protocol { found: protocol });
        }
        let task: Task = header.task.parse()?;
        if !header.digest_layout.is_empty() && header.digest_layout != fiatlux_rules::ROW_LAYOUT {
            return Err(HeaderError::Layout(header.digest_layout.clone()));
        }
        let mut thresholds = Thresholds::default();
        let recorded: BTreeMap<_, _> = header.thresholds.iter().collect();
        for assignment in recorded.into_iter().map(|(key, value)| format!("{key}={value}")) {
            thresholds.set(&assignment)?;
        }
        set.iter().try_for_each(|assignment| thresholds.set(assignment))?;
        let geometry = read_geometry(&header.geometry)?;
        let ends = header.end_on.iter().map(|name| name.parse::<Cause>()).collect::<Result<Causes, _>>()?;
        let own_choice = header.end_on_overridden || !header.end_on.is_empty();
        let options = JudgeOptions { end_on: own_choice.then_some(ends), published_counting };
        let digest = RowDigest::from_hex(&header.digest_context).ok_or(HeaderError::Context)?;
        Ok(Self {
            judge: Judge::new(task, thresholds, geometry, options),
            digest,
            recorder: Recorder::default(),
            next_step: 0,
            gap: None,
            steps_in_gate: 0,
            rejudged: !set.is_empty() || published_counting,
        })
    }

    /// Takes the next row.
    pub fn push(&mut self, row: &Row) {
        if row.step != self.next_step && self.gap.is_none() {
            self.gap = Some(format!("row {} follows row {}", row.step, self.next_step as i128 - 1));
        }
        self.next_step = row.step.saturating_add(1);
        self.digest.push(row);
        if row.step == 0 {
            let verdict = *self.judge.start(row);
            self.recorder.push(row, &verdict.criteria);
        } else if self.judge.verdict().end.is_none() {
            let verdict = *self.judge.advance(row);
            self.steps_in_gate += u64::from(verdict.criteria.all());
            self.recorder.push(row, &verdict.criteria);
        }
    }

    /// What the rows amount to, against the result that was recorded with them.
    pub fn finish(self, result: Option<&v3::EpisodeResult>) -> Graded {
        let summary = self.judge.summary();
        let digest = self.digest.hex();
        let recorded = result.and_then(|result| result.end.as_ref());
        let flaw = self.flaw(recorded, &digest);
        let mut notes = Vec::new();
        let (end, causes) = match (&summary.end, recorded) {
            (Some(end), _) => {
                (end.cause().name().to_owned(), end.causes.iter().map(|cause| cause.name().to_owned()).collect())
            }
            (None, Some(recorded)) => {
                if flaw.is_none() {
                    notes.push(format!("recorded until '{}', which does not end it here", recorded.cause));
                }
                (recorded.cause.clone(), recorded.causes.clone())
            }
            (None, None) => ("cut".to_owned(), Vec::new()),
        };
        if let (Some(recorded), false) = (recorded, self.rejudged) {
            notes.extend(differences(&summary, recorded));
        }
        if summary.reached_working_height && summary.task.spec().special.notes_working_height {
            notes.push("the pelvis reached working height".into());
        }
        if let Some(result) = result {
            let counts = [
                (result.unconverged, "physics steps did not converge"),
                (result.missed_steps, "steps had no action in time"),
                (result.steps_outside_box, "actions left the box [-1, 1]"),
            ];
            notes.extend(
                counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")),
            );
        }
        let criteria = summary.task.spec().gate.criteria.iter().map(|criterion| criterion.name).collect();
        Graded {
            thresholds: self.judge.thresholds().clone(),
            series: self.recorder.finish(criteria),
            steps_in_gate: self.steps_in_gate,
            summary,
            end,
            causes,
            digest,
            notes,
            flaw,
        }
    }

    fn flaw(&self, end: Option<&v3::EpisodeEnd>, digest: &str) -> Option<Flaw> {
        let Some(end) = end else { return Some(Flaw::Unended) };
        if end.cause == ABORTED {
            return Some(Flaw::Aborted);
        }
        if let Some(gap) = &self.gap {
            return Some(Flaw::Gap(format!("rows are missing: {gap}")));
        }
        if self.next_step != end.steps.saturating_add(1) {
            let have = self.next_step;
            return Some(Flaw::Gap(format!("{have} rows are there, the result speaks of {} steps", end.steps)));
        }
        if !end.digest.eq_ignore_ascii_case(digest) {
            return Some(Flaw::Altered { rows: digest.into(), result: end.digest.clone() });
        }
        (!self.judge.summary().control_effort.is_finite()).then_some(Flaw::NotFinite)
    }
}

/// Where the recorded end does not say what the rows say; the rows count.
fn differences(summary: &Summary, end: &v3::EpisodeEnd) -> Vec<String> {
    let yes_no = |value: bool| if value { "yes" } else { "no" }.to_owned();
    let fields = [
        ("success", yes_no(summary.success), yes_no(end.success)),
        ("broken", yes_no(summary.broken), yes_no(end.broken)),
        ("dropped", yes_no(summary.dropped), yes_no(end.dropped)),
        ("gate progress", summary.gate_progress.to_string(), end.gate_progress.to_string()),
    ];
    let differing = fields.into_iter().filter(|(_, rows, recorded)| rows != recorded);
    differing
        .map(|(name, rows, recorded)| format!("{name} is {rows} by its rows, its result says {recorded}"))
        .collect()
}
