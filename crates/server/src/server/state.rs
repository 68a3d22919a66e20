//! State shared by all parts of a server, and the work of its workers.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use fiatlux_carrier::{BusyWait, Carrier, Publisher, Query};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Refusal, ServerInfo};
use fiatlux_proto::{Bytes, record_seq};
use fiatlux_session::Machine;
use fiatlux_session::server::{Input, Output, Timeouts};

use super::actor::{Actor, ReplyTo, Side, Wire, WireState};
use super::counts::{Counts, Tally};
use super::credentials::Credentials;
use super::gate::Gate;
use super::links::{Links, RunJob};
use super::lock;
use super::networks::Networks;
use super::opens::Opens;
use super::pool::{Answer, AnswerKind, Job, Queue, Timer};
use super::runs::Runs;
use super::scenes::Scenes;
use super::sessions::Sessions;
use crate::recorder::{BagEnd, BagReport};

/// Largest number of inputs that a worker handles before other sessions get their turn, and the longest time for them.
const TURN: usize = 256;
const TURN_TIME: Duration = Duration::from_millis(20);
/// Most observations in a row that are not sent because the client has already sent the action that follows: half of what
/// a client may send ahead.
const MAX_SKIPPED: u32 = 8;
/// Largest number of replies that wait to be sent, and their size in bytes.
const MAX_ANSWERS: usize = 1024;
const MAX_ANSWER_BYTES: usize = 64 << 20;

pub(super) struct ServerState {
    pub name: String,
    pub keys: ServerKeys,
    pub carrier: Carrier,
    pub timeouts: Timeouts,
    pub scenes: Scenes,
    pub networks: Networks,
    pub info: ServerInfo,
    pub queues: Queues,
    /// `None` without a folder to record into.
    pub runs: Option<Runs>,
    pub sessions: Sessions,
    pub credentials: Credentials,
    /// Requests that start something.
    pub opens: Opens,
    pub links: Links,
    /// Number of messages to sessions that were refused because they did not come from the client.
    pub refused: AtomicU64,
    pub tally: Tally,
    pub closing: AtomicBool,
    pub start: Instant,
}

/// Work for the server's threads.
#[derive(Default)]
pub(super) struct Queues {
    pub jobs: Queue<Job>,
    /// A reply on a congested link waits for up to the time-out of its query, so separate threads send replies.
    pub answers: Queue<Answer>,
    pub timer: Timer,
    /// Requests to runs. They wait for the disk, so they have their own thread.
    pub runs: Queue<RunJob>,
}

impl Queues {
    pub fn stop(&self) {
        self.jobs.stop();
        self.answers.stop();
        self.runs.stop();
        self.timer.stop();
    }
}

impl ServerState {
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    /// The server's figures now.
    pub fn counts(&self) -> Counts {
        let total = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let open = self.sessions.all();
        Counts {
            open_sessions: self.sessions.places.count(),
            capacity: self.sessions.capacity,
            sessions: total(&self.tally.sessions),
            records: total(&self.tally.records) + open.iter().map(|actor| total(&actor.next_seq)).sum::<u64>(),
            refused_messages: total(&self.refused),
            bags: total(&self.tally.bags),
            cut_bags: total(&self.tally.cut_bags),
        }
    }

    /// Gives a session an input, and schedules the session.
    pub fn send(&self, actor: &Arc<Actor>, side: Side, input: Input<ReplyTo>) {
        if actor.push(side, input) {
            self.queues.jobs.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// Gives a session an action. A client in this process waits for its observation: its own thread steps the session, since
    /// to wake a worker and then the client again takes longer than most of what a step has to do besides its physics.
    pub fn send_action(&self, actor: &Arc<Actor>, input: Input<ReplyTo>) {
        if !self.carrier.delivers_in_place() {
            self.send(actor, Side::Client, input);
        } else if actor.push(Side::Client, input) {
            self.run_guarded(actor);
        }
    }

    /// Runs sessions; the body of a worker's thread.
    pub fn work(&self) {
        let mut busy = BusyWait::default();
        while let Some(job) = self.queues.jobs.next_soon(&mut busy) {
            match &job {
                Job::Run(actor) => self.run_guarded(actor),
                Job::Open(payload, attachment, digest) => {
                    let open = AssertUnwindSafe(|| self.open(payload, attachment, *digest));
                    if catch_unwind(open).is_err() {
                        tracing::error!("a request to open failed; please report this");
                        self.opens.forget(digest);
                    }
                }
                // What it cannot describe is not answered.
                Job::Describe(query) => drop(catch_unwind(AssertUnwindSafe(|| self.describe(query)))),
            }
        }
    }

    /// Runs a session, and closes it if it panics.
    fn run_guarded(&self, actor: &Arc<Actor>) {
        if catch_unwind(AssertUnwindSafe(|| self.run(actor))).is_err() {
            tracing::error!(session = actor.id, "a session failed and is closed; please report this");
            self.give_up(actor);
        }
    }

    fn run(&self, actor: &Arc<Actor>) {
        let mut session = lock(&actor.session);
        let mut wire = lock(&actor.wire);
        let mut done = wire.is_closed();
        let mut parked = false;
        let begun = Instant::now();
        // The last observation, if it is not sent, and how many before it were not sent either.
        let mut skipped: Option<Bytes> = None;
        let mut in_a_row = 0;
        let ends = match &*wire {
            _ if actor.is_unclaimed(self.now()) => Some("nobody has claimed it"),
            WireState::Unclaimed if actor.gate.is_claimed() => match self.declare(actor) {
                Ok(declared) => {
                    *wire = WireState::Declared(declared);
                    None
                }
                Err(error) => {
                    tracing::error!(session = actor.id, %error, "cannot declare a session's keys; is the link still open?");
                    Some("the server's link refuses its keys")
                }
            },
            _ => None,
        };
        if let Some(why) = ends {
            session.handle(Input::Terminate(why), self.now());
            while let Some(output) = session.poll() {
                done |= self.emit(actor, wire.declared(), output);
            }
        }
        for _ in 0..TURN {
            if begun.elapsed() > TURN_TIME {
                break;
            }
            let Some(input) = actor.take() else {
                if let Some(observation) = skipped.take() {
                    self.emit(actor, wire.declared(), Output::Observation(observation));
                }
                if let Some(at) = actor.wake_at(&session, self.now())
                    && actor.wakes_earlier(at)
                {
                    self.queues.timer.set(at, actor);
                }
                // An answer that arrived meanwhile, as from a client in the same process, is handled at once.
                parked = !done && actor.park();
                if done || parked {
                    break;
                }
                continue;
            };
            session.handle(input, self.now());
            while let Some(output) = session.poll() {
                match output {
                    Output::Observation(observation) if in_a_row < MAX_SKIPPED && actor.has_from_client() => {
                        (skipped, in_a_row) = (Some(observation), in_a_row + 1);
                        continue;
                    }
                    Output::Observation(_) => (skipped, in_a_row) = (None, 0),
                    _ => {}
                }
                done |= self.emit(actor, wire.declared(), output);
            }
        }
        if let Some(observation) = skipped {
            self.emit(actor, wire.declared(), Output::Observation(observation));
        }
        drop((session, wire));
        if done {
            self.remove(actor);
        } else if !parked {
            self.queues.jobs.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// Sends an output of a session; returns whether it was the last one.
    fn emit(&self, actor: &Actor, wire: Option<&Wire>, output: Output<ReplyTo>) -> bool {
        let put = |publish: fn(&Wire) -> &Publisher, label: Option<&str>, bytes: Bytes| {
            let Some(wire) = wire else { return };
            let attachment = label.map(|label| actor.gate.seal(label, &bytes).to_vec()).unwrap_or_default();
            if let Err(error) = publish(wire).put(bytes, attachment) {
                tracing::debug!(%error, "a message is lost");
            }
        };
        match output {
            Output::Observation(bytes) => put(|wire| &wire.observation, Some("observation"), bytes),
            Output::Notice(bytes) => put(|wire| &wire.notice, Some("notice"), bytes),
            Output::StepRecord(bytes) => {
                actor.next_seq.store(record_seq(&bytes).saturating_add(1), Ordering::Relaxed);
                if wire.is_some_and(Wire::has_follower) {
                    put(|wire| &wire.truth, None, sealed(actor, bytes));
                }
            }
            Output::Reply(ReplyTo::Recorder(query), message, replies) => {
                let replies = replies.into_iter().map(|record| sealed(actor, record)).collect();
                self.answer(query, AnswerKind::Replies(message, replies));
            }
            Output::Reply(ReplyTo::Client(label, number), message, replies) => {
                replies.into_iter().take(1).for_each(|bytes| {
                    self.answer_client(&actor.gate, label, number, message, bytes);
                });
            }
            Output::Refuse(ReplyTo::Recorder(query), bytes) => self.answer(query, AnswerKind::Refusal(bytes)),
            Output::Refuse(ReplyTo::Client(_, number), bytes) => {
                self.answer_client(&actor.gate, "refusal", number, "Refusal", bytes);
            }
            Output::Closed => self.sessions.places.leave(&actor.id),
            Output::Done => return true,
        }
        false
    }

    /// Answers a query of a session's client, and all copies of it.
    pub fn answer_client(&self, gate: &Gate, label: &str, number: u64, message: &'static str, bytes: Bytes) {
        let (sealed, queries) = gate.answer(label, number, message, bytes);
        for query in queries {
            let key = query.key.clone();
            self.answer(query, AnswerKind::Own(key, message, sealed.bytes.clone(), Some(sealed.attachment)));
        }
    }

    /// Queues replies; those over the limit are dropped: the client asks again.
    pub fn answer(&self, query: Query, kind: AnswerKind) {
        let (waiting, bytes) =
            self.queues.answers.fold((0, 0), |(count, bytes), answer| (count + 1, bytes + answer.bytes()));
        if waiting < MAX_ANSWERS && bytes < MAX_ANSWER_BYTES {
            self.queues.answers.push(Answer { query, kind });
        }
    }

    /// Sends replies; the body of a thread.
    pub fn send_answers(&self) {
        while let Some(Answer { query, kind }) = self.queues.answers.next() {
            match kind {
                AnswerKind::Replies(message, replies) => {
                    replies.into_iter().for_each(|bytes| reply(&query, message, bytes));
                }
                AnswerKind::Own(key, message, bytes, attachment) => {
                    reply_on(&key, &query, message, bytes, attachment.map(|bytes| bytes.to_vec()).unwrap_or_default());
                }
                AnswerKind::Refusal(bytes) => refuse(&query, bytes),
            }
        }
    }

    fn remove(&self, actor: &Actor) {
        let was_open = self.sessions.remove(actor);
        if was_open {
            self.tally.records.fetch_add(actor.next_seq.load(Ordering::Relaxed), Ordering::Relaxed);
        }
        let wire = lock(&actor.wire).close();
        if let Some(attempt) = &actor.attempt {
            attempt.settle();
        }
        if was_open && !wire.is_closed() {
            tracing::info!(session = actor.id, "session is over");
        }
    }

    /// Closes a session that panicked, as far as possible.
    fn give_up(&self, actor: &Actor) {
        // The same failure may occur again; the session is removed in any case.
        let _ = catch_unwind(AssertUnwindSafe(|| {
            let (mut session, wire) = (lock(&actor.session), lock(&actor.wire));
            session.handle(Input::Terminate("the server failed in this session"), self.now());
            while let Some(output) = session.poll() {
                self.emit(actor, wire.declared(), output);
            }
        }));
        self.remove(actor);
    }

    pub fn take_bag(&self, report: &BagReport) {
        let path = report.path.display();
        match &report.end {
            BagEnd::Whole(_) => tracing::info!(bag = %path, "finished a bag"),
            BagEnd::Cut(reason) => tracing::error!(bag = %path, reason, "a bag is cut"),
        }
        let count = if matches!(report.end, BagEnd::Whole(_)) { &self.tally.bags } else { &self.tally.cut_bags };
        count.fetch_add(1, Ordering::Relaxed);
        let (Some(runs), Some(ticket)) = (&self.runs, &report.header.run) else { return };
        let session = &report.header.session;
        let Some(attempt) = runs.attempt_of(ticket, session) else {
            return tracing::warn!(bag = %path, "the attempt of this bag has already ended; the bag does not count");
        };
        let is_kept = match &report.end {
            BagEnd::Whole(result) => attempt.bag_is_whole(&report.path, result),
            BagEnd::Cut(reason) => {
                attempt.bag_is_lost(reason);
                false
            }
        };
        if !is_kept && let Some(actor) = self.sessions.find(session) {
            self.send(
                &actor,
                Side::Server,
                Input::Terminate("its recording is lost; free some space on the server's disk"),
            );
        }
    }
}

/// Seals a record if it can leave the process.
fn sealed(actor: &Actor, record: Bytes) -> Bytes {
    match &actor.rows {
        Some(rows) => rows.seal(record_seq(&record), &record).into(),
        None => record,
    }
}

/// Refuses a query for several servers: every one of them would carry it out.
pub(super) fn names_one_server(query: &Query, key: &str) -> Result<(), Refusal> {
    if query.key == key {
        return Ok(());
    }
    let message =
        format!("the query must name one server: use {key}, or the key of another server that describe lists");
    Err(Refusal::new(Code::Value, "", message))
}

pub(super) fn reply(query: &Query, message: &str, bytes: Bytes) {
    reply_on(&query.key, query, message, bytes, Vec::new());
}

fn reply_on(key: &str, query: &Query, message: &str, bytes: Bytes, attachment: Vec<u8>) {
    if let Err(error) = query.reply(key, message, bytes, attachment) {
        tracing::debug!(%error, key = query.key, "a reply is lost");
    }
}

/// Answers a query with a [`Refusal`] as an error.
pub(super) fn refuse(query: &Query, bytes: Bytes) {
    if let Err(error) = query.refuse("Refusal", bytes) {
        tracing::debug!(%error, key = query.key, "a refusal is lost");
    }
}
