//! State shared by all parts of a server, and the work of its workers.

use std::collections::BTreeMap;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use fiatlux_access::{Channel, Identity, RecorderKey, RowsKey, Side as End, Tokens};
use fiatlux_carrier::{BusyWait, Carrier, Publisher, Query};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{OpenReply, OpenRequest, Refusal, ServerInfo, SessionInfo, Welcome, open_reply};
use fiatlux_proto::{Bytes, Message, decode, limits, record_seq};
use fiatlux_session::Machine;
use fiatlux_session::server::{Input, Output, Timeouts};

use super::actor::{Actor, Asker, Session, Side, Wire};
use super::gate::Gate;
use super::guest::Guest;
use super::host::Simulation;
use super::links::{Links, RunJob};
use super::lock;
use super::networks::Networks;
use super::opens::{Begun, Digest, Opens};
use super::places::{CLAIM_TIME, NoPlace, Places};
use super::plan::{self, Plan};
use super::pool::{Answer, AnswerKind, Job, Queue, Timer};
use super::runs::{Runs, Seat};
use super::scenes::Scenes;
use crate::recorder::{BagEnd, BagReport};
use fiatlux_sensing::Sensors;

/// Largest number of inputs that a worker handles before other sessions get their turn, and the longest time for them.
const TURN: usize = 256;
const TURN_TIME: Duration = Duration::from_millis(20);
/// Most observations in a row that are not sent because the client has already sent the action that follows: half of what
/// a client may send ahead.
const MOST_SKIPPED: u32 = 8;
/// Largest number of replies that wait to be sent, and their size in bytes.
const MAX_ANSWERS: usize = 1024;
const MAX_ANSWER_BYTES: usize = 64 << 20;
/// Number of closed sessions to remember, whose clients may still ask.
const MAX_FORMER: usize = 256;
/// Number of sessions that may wait for their recorder, for each one that may be open.
const DRAINING_PER_OPEN: usize = 3;

pub(super) struct Shared {
    pub name: String,
    pub keys: ServerKeys,
    pub carrier: Carrier,
    pub timeouts: Timeouts,
    pub capacity: usize,
    pub scenes: Scenes,
    pub networks: Networks,
    pub info: ServerInfo,
    pub queue: Queue<Job>,
    /// A reply on a congested link waits for up to the time-out of its query, so separate threads send replies.
    pub answers: Queue<Answer>,
    pub timer: Timer,
    /// `None` without a folder to record into.
    pub runs: Option<Runs>,
    /// Requests to runs. They wait for the disk, so they have their own thread.
    pub run_requests: Queue<RunJob>,
    pub sessions: RwLock<BTreeMap<String, Arc<Actor>>>,
    /// Gates of closed sessions, oldest first: their clients are told that the session is over.
    pub former: Mutex<VecDeque<(String, Arc<Gate>)>>,
    /// The places of open sessions.
    pub places: Places,
    pub identity: Arc<Identity>,
    /// The server's identity if one was given, so that it outlives the process: it signs results.
    pub signer: Option<Arc<Identity>>,
    /// Who may open sessions; `None` if everybody may.
    pub tokens: Option<Tokens>,
    /// Key shared with recorders in other processes, with which records are sealed.
    pub recorder_key: Option<RecorderKey>,
    /// Key by which recorders know the tokens of its sessions; `None` without a recorder.
    pub token_key: Option<RecorderKey>,
    /// Requests that start something.
    pub opens: Opens,
    pub links: Links,
    /// Number of messages to sessions that were refused because they did not come from the client.
    pub refused: AtomicU64,
    pub closing: AtomicBool,
    /// Distinguishes the ids of sessions from those of an earlier server of the same name.
    pub id_prefix: String,
    pub next_id: AtomicU64,
    pub start: Instant,
}

impl Shared {
    pub fn now(&self) -> Duration {
        self.start.elapsed()
    }

    pub fn find(&self, id: &str) -> Option<Arc<Actor>> {
        let sessions = self.sessions.read().unwrap_or_else(PoisonError::into_inner);
        sessions.get(id).cloned()
    }

    pub fn all(&self) -> Vec<Arc<Actor>> {
        let sessions = self.sessions.read().unwrap_or_else(PoisonError::into_inner);
        sessions.values().cloned().collect()
    }

    /// Gives a session an input, and schedules the session.
    pub fn send(&self, actor: &Arc<Actor>, side: Side, input: Input<Asker>) {
        if actor.push(side, input) {
            self.queue.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// Runs sessions; the body of a worker's thread.
    pub fn work(&self) {
        let mut busy = BusyWait::default();
        while let Some(job) = self.queue.next_soon(&mut busy) {
            let done = catch_unwind(AssertUnwindSafe(|| match &job {
                Job::Run(actor) => self.run(actor),
                Job::Open(payload, attachment, digest) => self.open(payload, attachment, *digest),
                Job::Describe(query) => self.describe(query),
            }));
            if done.is_err()
                && let Job::Run(actor) = &job
            {
                tracing::error!(session = actor.id, "a session failed and is closed; please report this");
                self.give_up(actor);
            }
            if done.is_err()
                && let Job::Open(_, _, digest) = &job
            {
                tracing::error!("a request to open failed; please report this");
                self.opens.forget(digest);
            }
        }
    }

    fn run(&self, actor: &Arc<Actor>) {
        let mut session = lock(&actor.session);
        let wire = lock(&actor.wire);
        let mut done = wire.is_none();
        let mut parked = false;
        let begun = Instant::now();
        // The last observation, if it is not sent, and how many before it were not sent either.
        let mut skipped: Option<Bytes> = None;
        let mut in_a_row = 0;
        if actor.is_unclaimed(self.now()) {
            session.handle(Input::Terminate("nobody has claimed it"), self.now());
            while let Some(output) = session.poll() {
                done |= self.emit(actor, wire.as_ref(), output);
            }
        }
        for _ in 0..TURN {
            if begun.elapsed() > TURN_TIME {
                break;
            }
            let Some(input) = actor.take() else {
                if let Some(observation) = skipped.take() {
                    self.emit(actor, wire.as_ref(), Output::Observation(observation));
                }
                if let Some(at) = actor.wake_at(&session, self.now())
                    && actor.wakes_earlier(at)
                {
                    self.timer.set(at, actor);
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
                    Output::Observation(observation) if in_a_row < MOST_SKIPPED && actor.has_from_client() => {
                        (skipped, in_a_row) = (Some(observation), in_a_row + 1);
                        continue;
                    }
                    Output::Observation(_) => (skipped, in_a_row) = (None, 0),
                    _ => {}
                }
                done |= self.emit(actor, wire.as_ref(), output);
            }
        }
        if let Some(observation) = skipped {
            self.emit(actor, wire.as_ref(), Output::Observation(observation));
        }
        drop((session, wire));
        if done {
            self.remove(actor);
        } else if !parked {
            self.queue.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// Sends an output of a session; returns whether it was the last one.
    fn emit(&self, actor: &Actor, wire: Option<&Wire>, output: Output<Asker>) -> bool {
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
            Output::Reply(Asker::Recorder(query), message, replies) => {
                let replies = replies.into_iter().map(|record| sealed(actor, record)).collect();
                self.answer(query, AnswerKind::Replies(message, replies));
            }
            Output::Reply(Asker::Client(label, number), message, replies) => {
                replies.into_iter().take(1).for_each(|bytes| {
                    self.answer_client(&actor.gate, label, number, message, bytes);
                });
            }
            Output::Refuse(Asker::Recorder(query), bytes) => self.answer(query, AnswerKind::Refusal(bytes)),
            Output::Refuse(Asker::Client(_, number), bytes) => {
                self.answer_client(&actor.gate, "refusal", number, "Refusal", bytes);
            }
            Output::Closed => self.places.leave(&actor.id),
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
        let (waiting, bytes) = self.answers.fold((0, 0), |(count, bytes), answer| (count + 1, bytes + answer.bytes()));
        if waiting < MAX_ANSWERS && bytes < MAX_ANSWER_BYTES {
            self.answers.push(Answer { query, kind });
        }
    }

    /// Sends replies; the body of a thread.
    pub fn send_answers(&self) {
        while let Some(Answer { query, kind }) = self.answers.next() {
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
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        let removed = sessions.remove(&actor.id);
        drop(sessions);
        self.places.leave(&actor.id);
        actor.gate.forget_all();
        let mut former = lock(&self.former);
        if former.len() >= MAX_FORMER {
            former.pop_front();
        }
        former.push_back((actor.id.clone(), Arc::clone(&actor.gate)));
        drop(former);
        let wire = lock(&actor.wire).take();
        if let Some(attempt) = &actor.attempt {
            attempt.settle();
        }
        if removed.is_some() && wire.is_some() {
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
                self.emit(actor, wire.as_ref(), output);
            }
        }));
        self.remove(actor);
    }

    fn describe(&self, query: &Query) {
        let open_sessions = u32::try_from(self.places.count()).unwrap_or(u32::MAX);
        let info = ServerInfo { open_sessions, ..self.info.clone() };
        self.answer(
            query.clone(),
            AnswerKind::Own(self.keys.describe(), "ServerInfo", info.encode_to_vec().into(), None),
        );
    }

    fn open(&self, payload: &[u8], attachment: &[u8], digest: Digest) {
        let request = decode::<OpenRequest>(payload, limits::MAX_CLIENT_MESSAGE).map_err(|error| Refusal::from(&error));
        let hello = request.as_ref().ok().and_then(|request| request.hello.clone());
        let opened = request.and_then(|request| {
            plan::check_version(request.protocol.as_ref())?;
            let guest = self.admit(hello.as_ref(), request.protocol.as_ref(), payload, attachment)?;
            self.try_open(plan::check(&OpenRequest { hello: None, ..request })?, None, &guest)
        });
        let answer = match opened {
            Ok((info, welcome)) => OpenReply { reply: Some(open_reply::Reply::Session(info)), welcome: Some(welcome) },
            Err(refusal) => {
                tracing::info!(refusal.message, "open refused");
                let welcome = self.sign(hello.as_ref(), payload, &refusal);
                OpenReply { reply: Some(open_reply::Reply::Refusal(refusal)), welcome }
            }
        };
        let bytes = answer.encode_to_vec().into();
        self.answer_all(digest, &self.keys.open(), Begun { message: "OpenReply", bytes, attachment: None });
    }

    /// Answers a request that starts something, and all copies of it.
    pub fn answer_all(&self, digest: Digest, key: &str, begun: Begun) {
        for query in self.opens.answer(digest, begun.clone()) {
            let Begun { message, bytes, attachment } = begun.clone();
            self.answer(query, AnswerKind::Own(key.into(), message, bytes, attachment));
        }
    }

    /// Opens a session for a guest, and returns the welcome for it.
    pub fn try_open(
        &self,
        mut plan: Plan,
        seat: Option<&Seat>,
        guest: &Guest<'_>,
    ) -> Result<(SessionInfo, Welcome), Refusal> {
        if plan.request.replay {
            plan.recorded = false;
        } else if self.runs.is_some() {
            plan.recorded = true;
        } else if plan.recorded && self.token_key.is_none() {
            let message = "this server has no recorder; start it with --record DIR, or with --recorder-key FILE and a \
                           recorder that has the same key, or leave `recorded` out";
            return Err(Refusal::new(Code::Value, "recorded", message));
        }
        if self.closing.load(Ordering::Relaxed) {
            return Err(Refusal::new(Code::Closed, "", "the server shuts down; open a session on another one"));
        }
        let sessions = self.sessions.read().unwrap_or_else(PoisonError::into_inner).len();
        if sessions > self.capacity * DRAINING_PER_OPEN {
            let message =
                "the server is busy: too many closed sessions still wait for their recorder; try again in 10 s";
            return Err(Refusal::new(Code::Busy, "", message));
        }
        let id = format!("{}-{}", self.id_prefix, self.next_id.fetch_add(1, Ordering::Relaxed));
        let is_claimed = |id: &str| self.find(id).is_some_and(|actor| actor.gate.is_claimed());
        let place = self.places.take(&id, &guest.peer, guest.limit, is_claimed, self.now());
        let leaves = place.map_err(|why| Refusal::new(Code::Busy, "", no_place(why, self.capacity)))?;
        if let Some(actor) = leaves.and_then(|id| self.find(&id)) {
            self.send(
                &actor,
                Side::Server,
                Input::Terminate("nobody has claimed it, and another session needs its place"),
            );
        }
        let opened = self.open_reserved(plan, seat, guest, &id);
        if opened.is_err() {
            self.places.leave(&id);
        }
        opened
    }

    fn open_reserved(
        &self,
        plan: Plan,
        seat: Option<&Seat>,
        guest: &Guest<'_>,
        id: &str,
    ) -> Result<(SessionInfo, Welcome), Refusal> {
        let gains = self.scenes.robot(plan.hands).gains(plan.gains);
        let built = self.scenes.get(plan.hands, plan.episode(0).scene(gains));
        let built = built.map_err(|error| plan.does_not_start("seed", &error))?;
        let keys = self.keys.session(id);
        let network =
            plan.sensors.all().meets(Sensors::WITH_FEATURES).then(|| self.networks.get(&plan.request.weights));
        let network = network.transpose()?;
        let is_replay = plan.request.replay;
        let is_sealed = is_replay || self.recorder_key.is_some();
        // A replay has no token, so no recorder follows it.
        let mut tokens = if is_replay { Vec::new() } else { vec![keys.live()] };
        if let Some(key) = self.token_key.as_ref().filter(|_| !is_replay) {
            let rows = RowsKey::of_recorder(key, &self.name, id);
            let rows = rows.map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
            tokens.push(keys.truth_live(&rows.token()));
        }
        let wire = Wire::declare(&self.carrier, &keys, is_sealed, &tokens)
            .map_err(|error| Refusal::new(Code::Busy, "", format!("the session's keys are refused: {error}")))?;
        let (task, seed, policy) = (plan.task, plan.seed, plan.request.policy.clone());
        let now = self.now();
        let recorded = plan.recorded;
        let attempt = seat.zip(plan.ticket.as_ref()).map(|(seat, ticket)| seat.begin(id, ticket)).transpose()?;
        let simulation = Simulation::new(&self.name, id, plan, built, network);
        let simulation = simulation.of_run(attempt.clone()).signed_by(self.signer.clone());
        let info = simulation.info();
        let session = Session::new(simulation, info, recorded, self.timeouts, now);
        let info = session.info().clone();
        let (welcome, secrets) = guest.welcome(&self.identity, &self.name, id, &info.encode_to_vec())?;
        let rows = match &self.recorder_key {
            _ if is_replay => Some(RowsKey::of_opener(&secrets)),
            Some(key) => Some(RowsKey::of_recorder(key, &self.name, id)),
            None => None,
        };
        let rows = rows.transpose().map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let channel = Channel::new(&secrets, End::Server);
        let channel = channel.map_err(|error| Refusal::new(Code::Value, "hello", error.to_string()))?;
        let mut actor = Actor::new(id.into(), session, wire, Gate::new(channel), self.now() + CLAIM_TIME);
        (actor.attempt, actor.rows, actor.is_replay) = (attempt, rows, is_replay);
        let actor = Arc::new(actor);
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        sessions.insert(id.into(), Arc::clone(&actor));
        drop(sessions);
        // The first check of a session sets its timer.
        let ends = !self.places.has(id);
        self.send(
            &actor,
            Side::Server,
            if ends { Input::Terminate("another session needs its place") } else { Input::Tick },
        );
        tracing::info!(session = id, %task, seed, policy, "opened a session");
        Ok((info, welcome))
    }

    /// Takes in a report of the server's own recorder on a bag.
    pub fn take_bag(&self, report: &BagReport) {
        let path = report.path.display();
        match &report.end {
            BagEnd::Whole(_) => tracing::info!(bag = %path, "finished a bag"),
            BagEnd::Cut(reason) => tracing::error!(bag = %path, reason, "a bag is cut"),
        }
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
        if !is_kept && let Some(actor) = self.find(session) {
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

fn no_place(why: NoPlace, capacity: usize) -> String {
    match why {
        NoPlace::Full => format!(
            "the server is busy: its places, {capacity}, are all taken; close a session, try again later, or \
             start it with a larger --capacity"
        ),
        NoPlace::Kept => format!(
            "the server is busy: half of its {capacity} places are reserved for clients that have none; close a session, try \
             again later, or start it with a larger --capacity"
        ),
        NoPlace::Limit(limit) => format!(
            "the token allows {limit} sessions, and that many are open; close one, or ask the server's owner for more"
        ),
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
