//! What all parts of a server share, and what its workers do with it.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    OpenReply, Refusal, RunFinish, RunReply, RunRequest, RunStatus, ServerInfo, SessionInfo, open_reply, run_reply,
    run_request,
};
use fiatlux_proto::{Bytes, Message, decode, encoding, limits};
use fiatlux_session::Machine;
use fiatlux_session::server::{Input, Output, Timeouts};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;
use zenoh::{Session as Zenoh, Wait};

use super::actor::{Actor, Session, Side, Wire};
use super::host::Simulation;
use super::lock;
use super::networks::Networks;
use super::plan::{self, Plan};
use super::pool::{Answer, AnswerKind, Job, Queue, Timer};
use super::runs::{Runs, Seat};
use super::scenes::Scenes;
use crate::recorder::{BagEnd, BagReport};
use fiatlux_sensing::Sensors;

/// Inputs that a worker gives a session before others get their turn, and how long they may take.
const TURN: usize = 256;
const TURN_TIME: Duration = Duration::from_millis(20);
/// Queries whose replies wait to be sent, and the bytes of these replies.
const MAX_ANSWERS: usize = 1024;
const MAX_ANSWER_BYTES: usize = 64 << 20;
/// Sessions that may wait for their recorder, for each one that may be open.
const DRAINING_PER_OPEN: usize = 3;

pub(super) struct Shared {
    pub name: String,
    pub keys: ServerKeys,
    pub zenoh: Zenoh,
    pub timeouts: Timeouts,
    pub capacity: usize,
    pub scenes: Scenes,
    pub networks: Networks,
    pub info: ServerInfo,
    pub queue: Queue<Job>,
    /// A reply waits as long as its query says where the way to the client is full, so workers leave them to another thread.
    pub answers: Queue<Answer>,
    pub timer: Timer,
    /// None without a folder to record into.
    pub runs: Option<Runs>,
    /// Requests to runs. They wait for the disk, so they have a thread of their own.
    pub run_requests: Queue<Query>,
    pub sessions: RwLock<BTreeMap<String, Arc<Actor>>>,
    /// Sessions that clients have.
    pub open: AtomicUsize,
    pub closing: AtomicBool,
    /// Makes the ids of sessions differ from those of an earlier server of the same name.
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

    /// Gives a session an input, and a worker the session.
    pub fn send(&self, actor: &Arc<Actor>, side: Side, input: Input<Query>) {
        if actor.push(side, input) {
            self.queue.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// What a worker's thread does.
    pub fn work(&self) {
        while let Some(job) = self.queue.next() {
            let done = catch_unwind(AssertUnwindSafe(|| match &job {
                Job::Run(actor) => self.run(actor),
                Job::Open(query) => self.open(query),
                Job::Describe(query) => self.describe(query),
            }));
            if done.is_err()
                && let Job::Run(actor) = &job
            {
                tracing::error!(session = actor.id, "a session failed and is closed; please report this");
                self.give_up(actor);
            }
        }
    }

    fn run(&self, actor: &Arc<Actor>) {
        let mut session = lock(&actor.session);
        let wire = lock(&actor.wire);
        let mut done = wire.is_none();
        let mut parked = false;
        let begun = Instant::now();
        for _ in 0..TURN {
            if begun.elapsed() > TURN_TIME {
                break;
            }
            let Some(input) = actor.take() else {
                if let Some(at) = session.wake_at()
                    && actor.wakes_earlier(at)
                {
                    self.timer.set(at, actor);
                }
                // An answer that came meanwhile, as from a client in the same process, is taken at once.
                parked = !done && actor.park();
                if done || parked {
                    break;
                }
                continue;
            };
            session.handle(input, self.now());
            while let Some(output) = session.poll() {
                done |= self.emit(wire.as_ref(), output);
            }
        }
        drop((session, wire));
        if done {
            self.remove(actor);
        } else if !parked {
            self.queue.push(Job::Run(Arc::clone(actor)));
        }
    }

    /// Sends what a session has to say; returns whether that was the last of it.
    fn emit(&self, wire: Option<&Wire>, output: Output<Query>) -> bool {
        let put = |publish: fn(&Wire) -> &zenoh::pubsub::Publisher<'static>, bytes: Bytes| {
            if let Some(Err(error)) = wire.map(|wire| publish(wire).put(bytes).wait()) {
                tracing::debug!(%error, "a message is lost");
            }
        };
        match output {
            Output::Observation(bytes) => put(|wire| &wire.observation, bytes),
            Output::Notice(bytes) => put(|wire| &wire.notice, bytes),
            Output::StepRecord(bytes) => put(|wire| &wire.truth, bytes),
            Output::Reply(query, message, replies) => self.answer(query, AnswerKind::Replies(message, replies)),
            Output::Refuse(query, bytes) => self.answer(query, AnswerKind::Refusal(bytes)),
            Output::Closed => {
                self.open.fetch_sub(1, Ordering::Relaxed);
            }
            Output::Done => return true,
        }
        false
    }

    /// Replies over the limit are dropped: their client asks again.
    fn answer(&self, query: Query, kind: AnswerKind) {
        let (waiting, bytes) = self.answers.fold((0, 0), |(count, bytes), answer| (count + 1, bytes + answer.bytes()));
        if waiting < MAX_ANSWERS && bytes < MAX_ANSWER_BYTES {
            self.answers.push(Answer { query, kind });
        }
    }

    /// What the thread does that sends replies.
    pub fn send_answers(&self) {
        while let Some(Answer { query, kind }) = self.answers.next() {
            match kind {
                AnswerKind::Replies(message, replies) => {
                    replies.into_iter().for_each(|bytes| reply(&query, message, bytes));
                }
                AnswerKind::Refusal(bytes) => refuse(&query, bytes),
            }
        }
    }

    fn remove(&self, actor: &Actor) {
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        let removed = sessions.remove(&actor.id);
        drop(sessions);
        let wire = lock(&actor.wire).take();
        if let Some(attempt) = &actor.attempt {
            attempt.settle();
        }
        if removed.is_some() && wire.is_some() {
            tracing::info!(session = actor.id, "session is over");
        }
    }

    /// Closes a session that panicked, as far as it still can.
    fn give_up(&self, actor: &Actor) {
        let mut closed = false;
        let told = catch_unwind(AssertUnwindSafe(|| {
            let (mut session, wire) = (lock(&actor.session), lock(&actor.wire));
            session.handle(Input::Terminate("the server failed in this session"), self.now());
            while let Some(output) = session.poll() {
                closed |= matches!(output, Output::Closed);
                self.emit(wire.as_ref(), output);
            }
        }));
        // Closing fails only where the session was open; its slot is free again.
        if told.is_err() && !closed {
            self.open.fetch_sub(1, Ordering::Relaxed);
        }
        self.remove(actor);
    }

    fn describe(&self, query: &Query) {
        let open_sessions = u32::try_from(self.open.load(Ordering::Relaxed)).unwrap_or(u32::MAX);
        let info = ServerInfo { open_sessions, ..self.info.clone() };
        self.answer(query.clone(), AnswerKind::Replies("ServerInfo", vec![info.encode_to_vec().into()]));
    }

    fn open(&self, query: &Query) {
        let bytes = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
        let answer = match plan::read(&bytes).and_then(|plan| self.try_open(plan, None)) {
            Ok(session) => open_reply::Reply::Session(session),
            Err(refusal) => {
                tracing::info!(refusal.message, "open refused");
                open_reply::Reply::Refusal(refusal)
            }
        };
        let answer = OpenReply { reply: Some(answer) }.encode_to_vec().into();
        self.answer(query.clone(), AnswerKind::Replies("OpenReply", vec![answer]));
    }

    fn try_open(&self, mut plan: Plan, seat: Option<&Seat>) -> Result<SessionInfo, Refusal> {
        plan.recorded |= self.runs.is_some();
        if self.closing.load(Ordering::Relaxed) {
            return Err(Refusal::new(Code::Closed, "", "the server shuts down; open a session on another one"));
        }
        let capacity = self.capacity;
        let sessions = self.sessions.read().unwrap_or_else(PoisonError::into_inner).len();
        let reserve = |open: usize| (open < capacity && sessions <= capacity * DRAINING_PER_OPEN).then_some(open + 1);
        if self.open.fetch_update(Ordering::Relaxed, Ordering::Relaxed, reserve).is_err() {
            let message = if self.open.load(Ordering::Relaxed) < capacity {
                "the server is busy: too many closed sessions still wait for their recorder; try again in 10 s".into()
            } else {
                format!(
                    "the server is busy: as many sessions are open as it has room for, {capacity}; close one, try again \
                     later, or start it with a larger --capacity"
                )
            };
            return Err(Refusal::new(Code::Busy, "", message));
        }
        let opened = self.open_reserved(plan, seat);
        if opened.is_err() {
            self.open.fetch_sub(1, Ordering::Relaxed);
        }
        opened
    }

    fn open_reserved(&self, plan: Plan, seat: Option<&Seat>) -> Result<SessionInfo, Refusal> {
        let gains = self.scenes.robot(plan.hands).gains(plan.gains);
        let built = self.scenes.get(plan.hands, plan.episode(0).scene(gains));
        let built = built.map_err(|error| plan.does_not_start("seed", &error))?;
        let id = format!("{}-{}", self.id_prefix, self.next_id.fetch_add(1, Ordering::Relaxed));
        let keys = self.keys.session(&id);
        let network =
            plan.sensors.all().meets(Sensors::WITH_FEATURES).then(|| self.networks.get(&plan.request.weights));
        let network = network.transpose()?;
        let wire = Wire::declare(&self.zenoh, &keys, seat.is_some())
            .map_err(|error| Refusal::new(Code::Busy, "", format!("Zenoh refuses the session's keys: {error}")))?;
        let (task, seed, policy) = (plan.task, plan.seed, plan.request.policy.clone());
        let now = self.now();
        let recorded = plan.recorded;
        let attempt = seat.zip(plan.ticket.as_ref()).map(|(seat, ticket)| seat.begin(&id, ticket)).transpose()?;
        let simulation = Simulation::new(&self.name, &id, plan, built, network).of_run(attempt.clone());
        let info = simulation.info();
        let session = Session::new(simulation, info, recorded, self.timeouts, now);
        let info = session.info().clone();
        let wake_at = session.wake_at();
        let actor = Arc::new(Actor::new(id.clone(), session, wire, attempt));
        let mut sessions = self.sessions.write().unwrap_or_else(PoisonError::into_inner);
        sessions.insert(id.clone(), Arc::clone(&actor));
        drop(sessions);
        if let Some(at) = wake_at
            && actor.wakes_earlier(at)
        {
            self.timer.set(at, &actor);
        }
        tracing::info!(session = id, %task, seed, policy, "session is open");
        Ok(info)
    }
}

impl Shared {
    /// What the thread does that serves runs.
    pub fn serve_runs(&self) {
        while let Some(query) = self.run_requests.next() {
            let bytes = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
            let answer = catch_unwind(AssertUnwindSafe(|| self.run_request(&bytes))).unwrap_or_else(|_| {
                tracing::error!("a request to a run failed; please report this");
                Err(Refusal::new(Code::Busy, "", "the server failed in this request; see its log"))
            });
            let answer = answer.unwrap_or_else(|refusal| {
                tracing::info!(refusal.field, refusal.message, "request to a run refused");
                run_reply::Reply::Refusal(refusal)
            });
            let answer = RunReply { reply: Some(answer) }.encode_to_vec().into();
            self.answer(query, AnswerKind::Replies("RunReply", vec![answer]));
        }
    }

    fn run_request(&self, bytes: &[u8]) -> Result<run_reply::Reply, Refusal> {
        let RunRequest { protocol, run, key, ask } =
            decode(bytes, limits::MAX_CLIENT_MESSAGE).map_err(|error| Refusal::from(&error))?;
        plan::check_version(protocol.as_ref())?;
        let runs = self.runs.as_ref().ok_or_else(|| {
            let message = "this server keeps no runs; start it with --record DIR, or use another one";
            Refusal::new(Code::Unknown, "run", message)
        })?;
        let ask = ask.ok_or_else(|| {
            Refusal::new(Code::Value, "ask", "the request asks for nothing; use register, status, open or finish")
        })?;
        let run = match &ask {
            run_request::Ask::Register(spec) => runs.register(&run, &key, spec.clone())?,
            _ => runs.find(&run, &key)?,
        };
        match ask {
            run_request::Ask::Open(index) => {
                let (plan, seat) = run.plan(index)?;
                return self.try_open(plan, Some(&seat)).map(run_reply::Reply::Session);
            }
            run_request::Ask::Finish(RunFinish {}) => run.finish()?,
            run_request::Ask::Register(_) | run_request::Ask::Status(RunStatus {}) => {}
        }
        Ok(run_reply::Reply::Run(run.info()))
    }

    /// What the server's own recorder says of a bag.
    pub fn take_bag(&self, report: &BagReport) {
        let path = report.path.display();
        match &report.end {
            BagEnd::Whole(_) => tracing::info!(bag = %path, "a bag is whole"),
            BagEnd::Cut(reason) => tracing::error!(bag = %path, reason, "a bag is cut"),
        }
        let (Some(runs), Some(ticket)) = (&self.runs, &report.header.run) else { return };
        let session = &report.header.session;
        let Some(attempt) = runs.attempt_of(ticket, session) else {
            return tracing::warn!(bag = %path, "the attempt that this bag is of has ended already; it does not count");
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

/// Answers a query.
pub(super) fn reply(query: &Query, message: &str, bytes: Bytes) {
    let sent = query.reply(query.key_expr().clone(), bytes).encoding(Encoding::from(encoding(message))).wait();
    if let Err(error) = sent {
        tracing::debug!(%error, key = %query.key_expr(), "a reply is lost");
    }
}

/// Answers a query with a [`Refusal`] as an error.
pub(super) fn refuse(query: &Query, bytes: Bytes) {
    if let Err(error) = query.reply_err(bytes).encoding(Encoding::from(encoding("Refusal"))).wait() {
        tracing::debug!(%error, key = %query.key_expr(), "a refusal is lost");
    }
}
