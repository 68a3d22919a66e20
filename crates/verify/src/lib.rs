//! Runs a recorded episode again on a server, and compares.
#![allow(missing_docs)] // Used in this repository alone.

mod records;
mod rows;
#[cfg(test)]
mod tests;

use std::fmt;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use fiatlux_access::PublicKey;
use fiatlux_bag::{Bag, BagError, Messages};
use fiatlux_carrier::{Carrier, CarrierError};
use fiatlux_client::{Access, Client, ClientError, Command, Policy, PolicyError, Replay, SessionFailure};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    EpisodeEnd, EpisodeHeader, EpisodeResult, Mode, Observation, OpenRequest, SessionInfo, State, StepRecord,
};
use fiatlux_proto::{Message, STOPPED, decode, plain};
use thiserror::Error;
use tracing::warn;

use fiatlux_grading::{Difference, check_bag, first_difference};
use records::Records;
use rows::first_row_difference;

/// An episode could not be verified. A difference is not an error: it is a [`Verification`].
#[derive(Debug, Error)]
pub enum VerifyError {
    #[error("the bag cannot be verified: {reason}")]
    Bag { reason: String },
    #[error("the bag cannot be read again")]
    Reread(#[from] BagError),
    #[error("the bag's actions cannot be read")]
    Actions(#[from] PolicyError),
    #[error("the episode could not be run again")]
    Client(#[from] ClientError),
    #[error("cannot follow the records of the second run")]
    Follow(#[source] CarrierError),
    #[error("record {next_seq} of the second run is lost, so it cannot be compared; run verify again")]
    Lost { next_seq: u64 },
}

impl VerifyError {
    /// True if the server has no room for a session now; it may have some soon.
    pub fn is_busy(&self) -> bool {
        matches!(self, Self::Client(ClientError::Refused { code: Code::Busy, .. }))
    }

    /// True if the bag is not at fault: the server is away, or accepts no session now. Another server may verify the
    /// bag, or this one later.
    pub fn is_of_server(&self) -> bool {
        match self {
            Self::Bag { .. } | Self::Reread(_) | Self::Actions(_) | Self::Lost { .. } => false,
            Self::Follow(_) => true,
            // A server that is silent, ends the session or is taken by another client says nothing about the bag.
            Self::Client(ClientError::Episode(failure)) => !matches!(
                failure,
                SessionFailure::Reset { .. } | SessionFailure::Command { .. } | SessionFailure::Action { .. }
            ),
            Self::Client(ClientError::Policy(_)) => false,
            // The same conditions would be refused again.
            Self::Client(ClientError::Refused { code, .. }) => {
                !matches!(code, Code::Malformed | Code::Unknown | Code::Value | Code::Start)
            }
            Self::Client(_) => true,
        }
    }
}

/// Outcome of a second run, compared with a bag.
#[derive(Debug, Clone, PartialEq)]
pub struct Verification {
    /// The episode in words: task, seed, index, policy and protocol.
    pub episode: String,
    /// The recorded end, confirmed by the rows.
    pub recorded: EpisodeEnd,
    /// Digest of the recorded header. Bags with the same digests of header and rows are copies of one episode.
    pub header_digest: String,
    /// Key of the server that signed the result; `None` if the bag is not signed.
    pub signer: Option<PublicKey>,
    /// The end of the second run; `None` if the bag has no action for its last steps.
    pub simulated: Option<EpisodeEnd>,
    /// The first field of the header that differs, which means another model, scene, room or rulebook.
    pub header: Option<Difference>,
    /// Step of the first row that differs, and the first number in it that does.
    pub row: Option<(u64, Difference)>,
    pub result: Option<Difference>,
}

impl Verification {
    /// True if all numbers of all rows are equal to the last bit, as are the verdict and every field of the header that
    /// a second run can reproduce.
    pub fn is_equal(&self) -> bool {
        let is_same = |simulated: &EpisodeEnd| *simulated == self.recorded;
        let no_difference = self.header.is_none() && self.row.is_none() && self.result.is_none();
        no_difference && self.simulated.as_ref().is_some_and(is_same)
    }
}

impl fmt::Display for Verification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_equal() {
            return writeln!(f, "equal: {}: {}", plain(&self.episode), in_words(&self.recorded));
        }
        let simulated = self.simulated.as_ref().map_or("did not end: the bag has no more actions".into(), in_words);
        writeln!(
            f,
            "different: {}\n  recorded   {}\n  simulated  {simulated}",
            plain(&self.episode),
            in_words(&self.recorded)
        )?;
        let row = self.row.as_ref().map(|(step, difference)| (format!("row {step}"), difference));
        let header = self.header.as_ref().map(|difference| ("header".to_owned(), difference));
        let result = self.result.as_ref().map(|difference| ("result".to_owned(), difference));
        for (what, Difference { field, found, recorded }) in [header, row, result].into_iter().flatten() {
            writeln!(f, "  {what}: {field} is {recorded} in the bag, {found} in the second run")?;
        }
        let remedy = "compare the server's version and model digest with the bag's header";
        writeln!(f, "The same build gives the same bytes: {remedy}.")
    }
}

fn in_words(end: &EpisodeEnd) -> String {
    let EpisodeEnd { digest, steps, cause, gate_progress, .. } = end;
    let succeeds = end.success && cause != "success";
    let flags = [("success", succeeds), ("broken", end.broken), ("dropped", end.dropped)];
    let flags: String = flags.into_iter().filter(|(_, is)| *is).map(|(what, _)| format!(", {what}")).collect();
    let (cause, digest) = (plain(cause), plain(digest));
    format!("{steps} steps, {cause}, progress {gate_progress:.2}{flags}, digest {digest}")
}

/// Compares the records of the second run with the bag.
struct Comparison<'a> {
    header: &'a EpisodeHeader,
    result: &'a EpisodeResult,
    /// The recorded rows, where they are compared one by one.
    states: Option<Messages<'a, State>>,
    header_difference: Option<Difference>,
    row_difference: Option<(u64, Difference)>,
    result_difference: Option<Difference>,
    simulated_end: Option<EpisodeEnd>,
    has_header: bool,
    has_result: bool,
    records: u64,
    rows: FetchedRecords,
}

impl<'a> Comparison<'a> {
    fn new(bag: &'a Bag, result: &'a EpisodeResult, rows: FetchedRecords) -> Self {
        Self {
            rows,
            header: bag.header(),
            result,
            states: (rows == FetchedRecords::All).then(|| bag.states()),
            header_difference: None,
            row_difference: None,
            result_difference: None,
            simulated_end: None,
            has_header: false,
            has_result: false,
            records: 0,
        }
    }

    fn take(&mut self, record: StepRecord) -> Result<(), BagError> {
        self.records += 1;
        if let Some(mut header) = record.header {
            self.has_header = true;
            // `digest_context` follows from other fields, which say more.
            let digest_context = std::mem::replace(&mut header.digest_context, self.header.digest_context.clone());
            self.header_difference = first_difference(&comparable(header, self.header), self.header)
                .or_else(|| first_difference(&EpisodeHeader { digest_context, ..self.header.clone() }, self.header));
        }
        if self.rows == FetchedRecords::All && self.row_difference.is_none() && !record.state.is_empty() {
            self.row_difference = self.row(record.step, &record.state)?.map(|difference| (record.step, difference));
        }
        if let Some(result) = record.result {
            self.has_result = true;
            self.simulated_end.clone_from(&result.end);
            // The second run cannot reproduce these: the header's digest, steps missed in real time, and the server's
            // signature.
            let EpisodeResult { header_digest, missed_steps, signature, .. } = self.result.clone();
            let result = EpisodeResult { header_digest, missed_steps, signature, ..result };
            self.result_difference = first_difference(&result, self.result);
        }
        Ok(())
    }

    fn row(&mut self, step: u64, simulated: &[u8]) -> Result<Option<Difference>, BagError> {
        let Some(recorded) = self.states.as_mut().and_then(Iterator::next).transpose()? else {
            return Ok(Some(Difference { field: "the row".into(), found: "there".into(), recorded: "missing".into() }));
        };
        if recorded.encode_to_vec() == simulated {
            return Ok(None);
        }
        let unreadable = |error: fiatlux_proto::DecodeError| {
            warn!(step, %error, "a row of the second run cannot be read; the server may have another version");
            Difference { field: "the row".into(), found: "unreadable".into(), recorded: "a row".into() }
        };
        Ok(match decode::<State>(simulated, MAX_SERVER_MESSAGE) {
            Ok(simulated) => first_row_difference(&simulated, &recorded, self.header),
            Err(error) => Some(unreadable(error)),
        })
    }

    /// True if header and result of the second run have arrived.
    fn is_complete(&self) -> bool {
        self.has_header && self.has_result
    }
}

/// A header of the second run, with recorded values for the fields that may differ: names of this run, and fields that
/// change no row. The bag's `header_digest` protects those.
fn comparable(simulated: EpisodeHeader, recorded: &EpisodeHeader) -> EpisodeHeader {
    let randomization = recorded.randomization.map(|recorded| {
        let simulated = simulated.randomization.unwrap_or_default();
        fiatlux_proto::v3::Randomization { exact_sensors: recorded.exact_sensors, ..simulated }
    });
    EpisodeHeader {
        protocol: recorded.protocol,
        version: recorded.version.clone(),
        server: recorded.server.clone(),
        session: recorded.session.clone(),
        policy: recorded.policy.clone(),
        mode: recorded.mode,
        // In lockstep, which the second run is in, no command expires.
        command_timeout_s: recorded.command_timeout_s,
        sensors: recorded.sensors.clone(),
        image_width: recorded.image_width,
        image_height: recorded.image_height,
        weights: recorded.weights.clone(),
        meshes: recorded.meshes.clone(),
        request: recorded.request.clone(),
        run: recorded.run.clone(),
        // Takes of before 3.11 do not say that a person drove them.
        source: if recorded.protocol.is_some_and(|played| (played.major, played.minor) < (3, 11)) {
            recorded.source
        } else {
            simulated.source
        },
        randomization,
        ..simulated
    }
}

/// Opens a session under a bag's conditions, sends its actions again and compares header, rows and result with the
/// bag's. The bag must first pass the checks of [`grade`](fiatlux_grading::grade). `link` reaches the server; `server`
/// is its name, which may be omitted if there is only one. `progress` receives the steps done and the steps in all;
/// setting `stop` ends the run.
pub fn verify(
    path: &Path,
    link: &Carrier,
    server: Option<&str>,
    access: &Access,
    progress: &mut dyn FnMut(u64, u64),
    stop: &AtomicBool,
) -> Result<Verification, VerifyError> {
    let wrong = |reason: String| VerifyError::Bag { reason };
    // The bag is graded while it is played: one core here, one at the server.
    std::thread::scope(|scope| {
        let grading = scope.spawn(|| check_bag(path));
        let played = play_again(path, link, server, access, &wrong, progress, stop);
        let signer = grading.join().map_err(|_| wrong("a grading thread ended early".into()))?.map_err(wrong)?;
        Ok(Verification { signer, ..played? })
    })
}

/// A second run, compared with the bag's rows; its signature is not compared.
fn play_again(
    path: &Path,
    link: &Carrier,
    server: Option<&str>,
    access: &Access,
    wrong: &dyn Fn(String) -> VerifyError,
    progress: &mut dyn FnMut(u64, u64),
    stop: &AtomicBool,
) -> Result<Verification, VerifyError> {
    let bag = Bag::open(path)?;
    let ended = bag.result().and_then(|result| Some((result, result.end.clone()?)));
    let (result, recorded) = ended.ok_or_else(|| wrong("the recording has no result".into()))?;
    check_mode(&bag, wrong)?;
    let mut run_again = |rows| {
        let recorded = recorded.clone();
        SecondRun { path, bag: &bag, result, recorded, link, server, access, rows }.play(progress, stop)
    };
    // The digest covers all rows, so rows are compared one by one only if it differs, or if the first or last record
    // can no longer be fetched. A thin bag has none: its digest says all.
    match run_again(FetchedRecords::FirstAndLast) {
        done if bag.is_thin() => done,
        Ok(whole) if whole.simulated.as_ref().is_some_and(|end| end.digest == whole.recorded.digest) => Ok(whole),
        Ok(_) | Err(VerifyError::Lost { .. }) => run_again(FetchedRecords::All),
        Err(error) => Err(error),
    }
}

/// Selects the records of a second run that are fetched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FetchedRecords {
    /// The two that carry the header and the result.
    FirstAndLast,
    All,
}

/// Plays nothing: its episode begins, which ends the one before.
struct Nobody;

impl Policy for Nobody {
    fn name(&self) -> String {
        "nobody".into()
    }

    fn reset(&mut self, _: &SessionInfo, _: &Observation) -> Result<(), PolicyError> {
        Err(PolicyError::not_reset("nobody"))
    }

    fn act(&mut self, _: &Observation) -> Result<Command, PolicyError> {
        Err(PolicyError::not_reset("nobody"))
    }
}

/// A recorded episode that is being played again.
struct SecondRun<'a> {
    path: &'a Path,
    bag: &'a Bag,
    result: &'a EpisodeResult,
    recorded: EpisodeEnd,
    link: &'a Carrier,
    server: Option<&'a str>,
    access: &'a Access,
    rows: FetchedRecords,
}

impl SecondRun<'_> {
    fn play(self, progress: &mut dyn FnMut(u64, u64), stop: &AtomicBool) -> Result<Verification, VerifyError> {
        let Self { path, bag, result, recorded, link, server, access, rows } = self;
        let mut replay = Replay::open(path)?;
        // Sensors change no row, and some take long.
        let request = OpenRequest { sensors: vec!["last_action".into()], weights: String::new(), ..replay.request() };
        // Only this client needs the records.
        let request = OpenRequest { replay: true, recorded: false, ..request };
        let mut client = Client::open_with(link, server, request, access)?;
        let keys = ServerKeys::new(&client.info().server).session(&client.info().session);
        let key = client.take_rows_key().ok_or(VerifyError::Lost { next_seq: 0 })?;
        let mut records = Records::of(link, keys, key, rows == FetchedRecords::All).map_err(VerifyError::Follow)?;
        let mut comparison = Comparison::new(bag, result, rows);
        let mut reread = Ok(());
        let mut on_step = |step| {
            if rows == FetchedRecords::FirstAndLast && step == 0 {
                // The server keeps it for a while.
                reread = records.get(0).map_or(Ok(()), |record| comparison.take(record));
            }
            while let (Ok(()), Some(record)) = (&reread, records.next()) {
                reread = comparison.take(record);
            }
            progress(step, recorded.steps);
        };
        let run = client.run_episode(bag.header().episode, &mut replay, &mut on_step, stop);
        reread?;
        let is_stopped =
            recorded.cause == STOPPED && matches!(run, Err(ClientError::Policy(PolicyError::Ended { .. })));
        if is_stopped {
            // As its operator did: another episode ends it.
            let ended = client.run_episode(bag.header().episode.wrapping_add(1), &mut Nobody, &mut |_| (), stop);
            debug_assert!(ended.is_err(), "nobody plays");
        }
        let simulated = match run {
            Ok(end) => Some(end),
            // The second run did not end where the recorded one did.
            Err(ClientError::Policy(PolicyError::Ended { .. })) => None,
            Err(error) => return Err(error.into()),
        };
        // The end of a take that was stopped is a record after its last row.
        let steps = simulated.as_ref().map_or(recorded.steps, |end| end.steps) + u64::from(is_stopped);
        match rows {
            FetchedRecords::FirstAndLast => {
                let last = records.get(steps).ok_or(VerifyError::Lost { next_seq: steps })?;
                comparison.take(last)?;
            }
            FetchedRecords::All => {
                while comparison.records <= steps {
                    let record = records.wait().ok_or(VerifyError::Lost { next_seq: comparison.records })?;
                    comparison.take(record)?;
                }
            }
        }
        let simulated = if is_stopped { comparison.simulated_end.take() } else { simulated };
        if simulated.is_some() && !comparison.is_complete() {
            return Err(VerifyError::Lost { next_seq: comparison.records });
        }
        if let Err(error) = client.close() {
            // The comparison is complete; the server ends the session by itself.
            warn!("the session could not be closed: {error}");
        }
        let EpisodeHeader { task, seed, episode, policy, episode_protocol, .. } = bag.header();
        Ok(Verification {
            episode: format!("{task} seed {seed}, episode {episode}, policy {policy}, {episode_protocol} protocol"),
            header_digest: result.header_digest.clone(),
            recorded,
            signer: None,
            simulated,
            header: comparison.header_difference,
            row: comparison.row_difference,
            result: comparison.result_difference,
        })
    }
}

/// Actions can be held or late only in real time, and there every action takes a time.
fn check_mode(bag: &Bag, wrong: &dyn Fn(String) -> VerifyError) -> Result<(), VerifyError> {
    let is_real_time = bag.header().mode() == Mode::RealTime;
    let mut is_timed = false;
    for (step, action) in (1..).zip(bag.actions()) {
        let action: fiatlux_proto::v3::ActionRecord = action?;
        if action.held || action.lateness_s != 0.0 {
            is_timed = true;
            if is_real_time {
                continue;
            }
            let step: u64 = step;
            return Err(wrong(format!("its header says lockstep, but the action of step {step} is one of real time")));
        }
    }
    if is_real_time && !is_timed {
        return Err(wrong("its header says real time, but no action took a time or was held, as in lockstep".into()));
    }
    Ok(())
}
