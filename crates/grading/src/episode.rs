//! Grades one episode from its rows, without reading files.

use fiatlux_access::{PublicKey, Signer, signer_of};
use fiatlux_proto::{ABORTED, PROTOCOL, STOPPED, is_compatible, v3};
use fiatlux_rules::{
    JudgeOptions, Judges, Protocol, Rewards, Row, RowDigest, Summary, Task, ThresholdError, Thresholds,
};
use fiatlux_wire::{
    WireError, end_message, header_digest, joint_groups_of, judgement_message, read_geometry, read_identity, reward_of,
};
use thiserror::Error;

use crate::Series;
use crate::conditions::is_take;
use crate::flaw::{Difference, Flaw, RowSums, first_difference};
use crate::parts::Parts;
use crate::request::{contradiction, unplayable};
use crate::results::PartRow;
use crate::series::SeriesBuilder;

#[derive(Debug, Error)]
pub enum HeaderError {
    #[error(
        "the bag is of protocol {found}, this scorer reads {PROTOCOL}; grade it with the scorer of its own version, or \
         record the episode again"
    )]
    Protocol { found: v3::Version },
    /// A later minor version may bind header fields that this version does not know.
    #[error(
        "the bag is of protocol {found}, this scorer reads up to {PROTOCOL}; grade it with a scorer of its version"
    )]
    Newer { found: v3::Version },
    #[error("the threshold cannot be set")]
    Threshold(#[from] ThresholdError),
    #[error("cannot read the header; the bag may come from another version")]
    Wire(#[from] WireError),
    #[error("the bag's digest has the layout {0}, this scorer knows {known}; use the scorer of that version", known = fiatlux_rules::manifest().layout)]
    Layout(String),
}

#[derive(Debug, Clone)]
pub struct GradedEpisode {
    /// Verdict of the published judge, from the rows alone.
    pub summary: Summary,
    /// Verdict of the strict judge; `None` for an episode that was played by protocol `published`.
    pub strict: Option<Summary>,
    /// Cause of the end by the published rules of this grading; else the recorded cause.
    pub end: String,
    /// All end conditions that its last published row met.
    pub causes: Vec<String>,
    pub thresholds: Thresholds,
    /// SHA-256 chain over its rows, hexadecimal.
    pub digest: String,
    /// SHA-256 chain over its rows alone, whatever its header says.
    pub rows_digest: String,
    /// Number of judged steps in which all criteria of the gate held.
    pub steps_in_gate: u64,
    pub series: Series,
    /// Subtasks that a relay played, in their order; empty for other policies.
    pub parts: Vec<PartRow>,
    pub notes: Vec<String>,
    /// Key of the server that signed the result.
    pub signer: Option<PublicKey>,
    /// The reason why it is not scored; `None` if it is scored.
    pub flaw: Option<Flaw>,
}

#[derive(Debug)]
pub struct Grader {
    judges: Judges,
    rewards: Rewards,
    digest: RowDigest,
    rows: RowDigest,
    /// A contradiction within the header.
    header_flaw: Option<Flaw>,
    /// A contradiction between its request and the header.
    contradiction: Option<Difference>,
    /// The reason why no server plays its request.
    unplayable: Option<String>,
    header_digest: String,
    is_lockstep: bool,
    is_take: bool,
    sums: RowSums,
    row_flaw: Option<Flaw>,
    recorder: SeriesBuilder,
    parts: Parts,
    next_step: u64,
    gap: Option<String>,
    steps_in_gate: u64,
    rejudged: bool,
}

impl Grader {
    /// Starts an episode with this header; `set` replaces thresholds of the header, as `key=value`.
    pub fn new(header: &v3::EpisodeHeader, set: &[String], published_counting: bool) -> Result<Self, HeaderError> {
        let protocol = header.protocol.unwrap_or_default();
        if !is_compatible(&protocol) {
            return Err(HeaderError::Protocol { found: protocol });
        }
        if protocol.minor > PROTOCOL.minor {
            return Err(HeaderError::Newer { found: protocol });
        }
        if !header.digest_layout.is_empty() && header.digest_layout != fiatlux_rules::manifest().layout {
            return Err(HeaderError::Layout(header.digest_layout.clone()));
        }
        let identity = read_identity(header)?;
        let digest = identity.digest();
        let (found, said) = (digest.hex(), header.digest_context.clone());
        let header_flaw = (!said.eq_ignore_ascii_case(&found)).then_some(Flaw::Identity { found, said });
        let mut thresholds = identity.thresholds;
        set.iter().try_for_each(|assignment| thresholds.set(assignment))?;
        let geometry = read_geometry(&header.geometry)?;
        let options = JudgeOptions { end_on: Some(identity.ends_on), published_counting };
        let judges = Judges::new(identity.protocol, identity.task, &thresholds, &geometry, options);
        let parts = Parts::new(identity.protocol, thresholds.clone(), geometry.clone());
        Ok(Self {
            parts,
            rewards: Rewards::new(judges.in_force(), reward_of(header)?, joint_groups_of(header)?),
            judges,
            digest,
            rows: crate::rows::chain(),
            header_flaw,
            contradiction: contradiction(header),
            unplayable: unplayable(header),
            header_digest: header_digest(header),
            is_lockstep: header.mode() == v3::Mode::Lockstep,
            is_take: is_take(header),
            sums: RowSums::default(),
            row_flaw: None,
            recorder: SeriesBuilder::default(),
            next_step: 0,
            gap: None,
            steps_in_gate: 0,
            rejudged: !set.is_empty() || published_counting,
        })
    }

    /// Takes the subtask that the action in answer to the next row belongs to, where a relay says so.
    pub fn play(&mut self, task: Option<Task>) {
        self.parts.play(task);
    }

    /// Takes the next row; a gap before it becomes a flaw.
    pub fn push(&mut self, row: &Row) {
        if row.step != self.next_step && self.gap.is_none() {
            self.gap = Some(format!("row {} follows row {}", row.step, self.next_step as i128 - 1));
        }
        self.next_step = row.step.saturating_add(1);
        self.digest.push(row);
        self.rows.push(row);
        self.sums.push(row);
        self.parts.push(row);
        if row.step == 0 {
            self.judges.start(row);
            self.rewards.start(self.judges.in_force(), row);
        } else if self.judges.in_force().verdict().end.is_none() {
            let counts = self.judges.of(Protocol::Published).verdict().end.is_none();
            self.judges.advance(row);
            self.rewards.advance(self.judges.in_force(), row);
            self.sums.reward += self.rewards.reward();
            let published = self.judges.of(Protocol::Published).verdict();
            self.steps_in_gate += u64::from(counts && published.criteria.all());
        } else {
            return;
        }
        let judge = self.judges.in_force();
        self.recorder.push(judge.hand_force_n(), &judge.verdict().criteria);
    }

    /// Stands for the next row if that row cannot be read. No row may follow.
    pub fn refuse(&mut self, step: u64, error: &WireError) {
        self.row_flaw.get_or_insert_with(|| Flaw::Row { step, problem: error.to_string() });
    }

    /// Ends the grading, and compares the rows with the recorded result.
    pub fn finish(self, result: Option<&v3::EpisodeResult>) -> GradedEpisode {
        let judge = self.judges.of(Protocol::Published);
        let summary = judge.summary();
        let strict = (self.judges.protocol() == Protocol::Strict).then(|| self.judges.of(Protocol::Strict));
        let digest = self.digest.hex();
        let recorded = result.and_then(|result| result.end.as_ref());
        let signer = result.map_or(Signer::Nobody, signer_of);
        let flaw = self.flaw(result, signer, &digest);
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
        if summary.reached_working_height && summary.task.spec().special.notes_working_height {
            notes.push("the pelvis reached working height".into());
        }
        if strict.is_some_and(|judge| judge.verdict().leapt) {
            notes.push("the robot leapt or dropped, which strict does not allow".into());
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
        GradedEpisode {
            thresholds: judge.thresholds().clone(),
            strict: strict.map(|judge| judge.summary()),
            series: self.recorder.finish(criteria),
            parts: self.parts.finish(),
            steps_in_gate: self.steps_in_gate,
            summary,
            end,
            causes,
            digest,
            rows_digest: self.rows.hex(),
            notes,
            signer: signer.key(),
            flaw,
        }
    }

    /// Ends the grading of an episode with this number of actions and without its rows, which others compare; returns the key of the
    /// server that signed its result.
    ///
    /// # Errors
    /// The first contradiction between header, result and signature.
    pub fn finish_without_rows(
        self,
        result: Option<&v3::EpisodeResult>,
        actions: u64,
    ) -> Result<Option<PublicKey>, Flaw> {
        let signer = result.map_or(Signer::Nobody, signer_of);
        let Some((result, end)) = result.and_then(|result| Some((result, result.end.as_ref()?))) else {
            return Err(Flaw::Unended);
        };
        match self.stated_flaw(result, end, signer) {
            Some(flaw) => Err(flaw),
            None if actions != end.steps => {
                Err(Flaw::Gap(format!("found {actions} actions; the result claims {} steps", end.steps)))
            }
            None if [&result.published, &result.strict]
                .into_iter()
                .flatten()
                .any(|one| !one.control_effort.is_finite()) =>
            {
                Err(Flaw::NotFinite)
            }
            None => Ok(signer.key()),
        }
    }

    fn flaw(&self, result: Option<&v3::EpisodeResult>, signer: Signer, digest: &str) -> Option<Flaw> {
        let recorded = result.and_then(|result| Some((result, result.end.as_ref()?)));
        let Some((result, end)) = recorded else { return self.row_flaw.clone().or(Some(Flaw::Unended)) };
        if let Some(flaw) = self.stated_flaw(result, end, signer) {
            return Some(flaw);
        }
        if let Some(gap) = &self.gap {
            return Some(Flaw::Gap(format!("rows are missing: {gap}")));
        }
        if self.next_step != end.steps.saturating_add(1) {
            let have = self.next_step;
            return Some(Flaw::Gap(format!("found {have} rows; the result claims {} steps", end.steps)));
        }
        if !end.digest.eq_ignore_ascii_case(digest) {
            return Some(Flaw::Altered { rows: digest.into(), result: end.digest.clone() });
        }
        if !self.judges.in_force().summary().control_effort.is_finite() {
            return Some(Flaw::NotFinite);
        }
        if self.rejudged { None } else { self.result_flaw(result, digest) }
    }

    /// A contradiction within header, result and signature, whatever the rows.
    fn stated_flaw(&self, result: &v3::EpisodeResult, end: &v3::EpisodeEnd, signer: Signer) -> Option<Flaw> {
        // Only the operator of a take ends an episode where its rows do not.
        if end.cause == ABORTED || (end.cause == STOPPED && !self.is_take) {
            return Some(Flaw::Aborted);
        }
        if result.header_digest.is_empty() {
            return Some(Flaw::Unbound);
        }
        if self.header_flaw.is_some() || self.row_flaw.is_some() {
            return self.header_flaw.clone().or(self.row_flaw.clone());
        }
        if !result.header_digest.eq_ignore_ascii_case(&self.header_digest) {
            return Some(Flaw::Header { header: self.header_digest.clone(), result: result.header_digest.clone() });
        }
        if let Some(reason) = &self.unplayable {
            return Some(Flaw::Unplayable(reason.clone()));
        }
        if let Some(difference) = &self.contradiction {
            return Some(Flaw::Request(difference.clone()));
        }
        if signer == Signer::Mismatch {
            return Some(Flaw::Signature);
        }
        // Only the actions of a real-time episode show which of them came too late.
        (self.is_lockstep && result.missed_steps != 0).then(|| {
            Flaw::Result(Difference {
                field: "missed_steps".into(),
                found: "0".into(),
                recorded: result.missed_steps.to_string(),
            })
        })
    }

    /// The first number of the result that contradicts the rows.
    fn result_flaw(&self, recorded: &v3::EpisodeResult, digest: &str) -> Option<Flaw> {
        let judge = self.judges.in_force();
        let (cause, causes) = match judge.verdict().end {
            Some(end) => (end.cause().name(), end.causes.iter().map(|cause| cause.name().to_owned()).collect()),
            None => (if self.is_take { STOPPED } else { ABORTED }, Vec::new()),
        };
        let strict = (self.judges.protocol() == Protocol::Strict).then(|| self.judges.of(Protocol::Strict));
        let found = v3::EpisodeResult {
            end: Some(end_message(&judge.summary(), cause, causes, digest.into())),
            unconverged: self.sums.unconverged,
            steps_outside_box: self.sums.steps_outside_box,
            // The rows do not show which actions came too late: only the actions of a real-time episode do.
            missed_steps: if self.is_lockstep { 0 } else { recorded.missed_steps },
            total_reward: self.sums.reward,
            published: Some(judgement_message(self.judges.of(Protocol::Published))),
            strict: strict.map(judgement_message),
            header_digest: self.header_digest.clone(),
            signature: recorded.signature.clone(),
        };
        first_difference(&found, recorded).map(Flaw::Result)
    }
}
