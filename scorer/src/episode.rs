//! One episode graded from its rows. No file is read here.

use std::collections::BTreeMap;

use fiatlux_proto::v3::Judgement;
use fiatlux_proto::{ABORTED, PROTOCOL, is_compatible, v3};
use fiatlux_rules::{
    Cause, Causes, JudgeOptions, Judges, Protocol, Row, RowDigest, Summary, Task, ThresholdError, Thresholds,
    UnknownProtocol,
};
use fiatlux_wire::{WireError, judgement_message, read_geometry};
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
    /// The protocol.
    #[error("the header's episode_protocol is unknown; the bag may come from another version")]
    Rulebook(#[from] UnknownProtocol),
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
    /// What the published judge says, by the rows alone.
    pub summary: Summary,
    /// What the strict judge says; `None` for an episode that was played by protocol `published`.
    pub strict: Option<Summary>,
    /// What ended it by the published rules of this grading, else as recorded.
    pub end: String,
    /// All conditions that its last published row met and that could end it.
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
    judges: Judges,
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
        let protocol: Protocol = header.episode_protocol.parse()?;
        let options = JudgeOptions { end_on: own_choice.then_some(ends), published_counting };
        let digest = RowDigest::from_hex(&header.digest_context).ok_or(HeaderError::Context)?;
        Ok(Self {
            judges: Judges::new(protocol, task, &thresholds, &geometry, options),
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
            self.judges.start(row);
        } else if self.judges.in_force().verdict().end.is_none() {
            let counts = self.judges.of(Protocol::Published).verdict().end.is_none();
            self.judges.advance(row);
            let published = self.judges.of(Protocol::Published).verdict();
            self.steps_in_gate += u64::from(counts && published.criteria.all());
        } else {
            return;
        }
        let judge = self.judges.in_force();
        self.recorder.push(judge.hand_force_n(), &judge.verdict().criteria);
    }

    /// What the rows amount to, against the result that was recorded with them.
    pub fn finish(self, result: Option<&v3::EpisodeResult>) -> Graded {
        let judge = self.judges.of(Protocol::Published);
        let summary = judge.summary();
        let strict = (self.judges.protocol() == Protocol::Strict).then(|| self.judges.of(Protocol::Strict));
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
        if let (Some(result), false) = (result, self.rejudged) {
            let found = Some(judgement_message(judge));
            notes.extend(differences("published", found.as_ref(), result.published.as_ref()));
            let found = strict.map(judgement_message);
            notes.extend(differences("strict", found.as_ref(), result.strict.as_ref()));
        }
        if summary.reached_working_height && summary.task.spec().special.notes_working_height {
            notes.push("the pelvis reached working height".into());
        }
        if strict.is_some_and(|judge| judge.verdict().leapt) {
            notes.push("the robot leapt or dropped, which strict does not accept".into());
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
        let gate = &summary.task.spec().gate;
        let criteria = gate.criteria_of(self.judges.protocol()).map(|criterion| criterion.name).collect();
        Graded {
            thresholds: judge.thresholds().clone(),
            strict: strict.map(|judge| judge.summary()),
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
        (!self.judges.in_force().summary().control_effort.is_finite()).then_some(Flaw::NotFinite)
    }
}

/// Where a recorded judgement does not say what the rows say; the rows count.
fn differences(protocol: &str, rows: Option<&Judgement>, recorded: Option<&Judgement>) -> Vec<String> {
    let (rows, recorded) = match (rows, recorded) {
        (Some(rows), Some(recorded)) => (rows, recorded),
        (None, None) => return Vec::new(),
        (Some(_), None) => return vec![format!("its result says nothing by protocol {protocol}")],
        (None, Some(_)) => return vec![format!("its result says what it cannot know by protocol {protocol}")],
    };
    let yes_no = |value: bool| if value { "yes" } else { "no" }.to_owned();
    let fields = |j: &Judgement| {
        [
            ("success", yes_no(j.success)),
            ("broken", yes_no(j.broken)),
            ("dropped", yes_no(j.dropped)),
            ("leapt", yes_no(j.leapt)),
            ("gate progress", j.gate_progress.to_string()),
            ("end", j.causes.join("+")),
            ("steps", j.steps.to_string()),
            ("peak hand force", j.peak_hand_force_n.to_string()),
            ("control effort", j.control_effort.to_string()),
            ("criteria at the start", j.start_count.to_string()),
            ("most criteria", j.best_count.to_string()),
        ]
    };
    let pairs = fields(rows).into_iter().zip(fields(recorded));
    let differing = pairs.filter(|((_, rows), (_, recorded))| rows != recorded);
    differing
        .map(|((name, rows), (_, recorded))| {
            format!("{protocol} {name} is {rows} by its rows, its result says {recorded}")
        })
        .collect()
}
