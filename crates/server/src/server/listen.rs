//! Receives messages: a callback checks each one and puts it into an inbox or a queue.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use fiatlux_carrier::{Message as Sample, Query, Reach};
use fiatlux_proto::keys::{self, ServerKeys};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    CloseReply, LookReply, OpenReply, Refusal, ResetReply, RunReply, RunRequest, StepRecordAck, look_reply, open_reply,
    reset_reply, run_reply,
};
use fiatlux_proto::{Bytes, Message, PROTOCOL, decode, limits};
use fiatlux_session::server::Input;

use super::actor::{Actor, ReplyTo, Side};
use super::gate::{Gate, QueryCheck, Sealed};
use super::links::RunJob;
use super::lock;
use super::opens::{Begun, OpenCheck, Opens};
use super::pool::{AnswerKind, Job};
use super::run_requests::no_link;
use super::shell::{Server, ServerError, refused};
use super::state::{ServerState, names_one_server, refuse, reply};

/// Largest number of waiting requests to open or describe; more are refused.
const MAX_REQUESTS: usize = 256;

/// Largest message whose sender is looked up; beyond it nobody is told.
const MAX_CHECKED: usize = limits::MAX_SERVER_MESSAGE;

impl Server {
    /// Declares everything that the server answers and receives.
    pub(super) fn listen(&mut self) -> Result<(), ServerError> {
        let keys = &self.shared.keys;
        let any = keys.session("*");
        let (describe, open, run) = (keys.describe(), keys.open(), keys.run());
        // Only a recorder with the key, or one in this process, may say what is on disk.
        let acks_from =
            if self.shared.credentials.recorder_key.is_none() { Reach::ThisProcess } else { Reach::Everywhere };
        let jobs = |shared: &ServerState| {
            shared.queues.jobs.fold(0, |count, job| count + usize::from(!matches!(job, Job::Run(_))))
        };
        self.serve(describe, limits::MAX_CLIENT_MESSAGE, jobs, |shared, query| {
            shared.queues.jobs.push(Job::Describe(query));
        })?;
        self.serve(open, limits::MAX_CLIENT_MESSAGE, jobs, take_open)?;
        let requests = |shared: &ServerState| shared.queues.runs.fold(0, |count, _| count + 1);
        self.serve(run, limits::MAX_RUN_REQUEST, requests, take_run)?;
        self.subscribe(any.action(), Reach::Everywhere, take_action)?;
        self.subscribe(any.truth_ack(), acks_from, take_ack)?;
        self.serve_session(any.reset(), "reset", Input::Reset)?;
        self.serve_session(any.close(), "close", Input::Close)?;
        self.serve_session(any.observation(), "observation", |_, asker| Input::Observation(asker))?;
        self.serve_session(any.look(), "look", Input::Look)?;
        self.serve_records(any.truth_rows())?;
        self.watch_clients(any.client())?;
        let legacy = ServerKeys::legacy(&self.shared.name);
        self.refuse_legacy(legacy.open())?;
        self.refuse_legacy(legacy.describe())
    }

    /// Answers clients of older versions, which would otherwise wait in vain.
    fn refuse_legacy(&mut self, key: String) -> Result<(), ServerError> {
        let message = format!("this server speaks protocol {PROTOCOL} alone; update the client to that version");
        self.declare_queryable(Reach::Everywhere, key, move |query| reject(&query, Code::Version, "protocol", &message))
    }

    /// Subscribes to messages for any session.
    fn subscribe(
        &mut self,
        key: String,
        from: Reach,
        take: fn(&ServerState, &Arc<Actor>, &Sample),
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |sample: Sample| {
            if let Some(actor) = session_of(&shared, &sample.key) {
                take(&shared, &actor, &sample);
            }
        };
        let subscription = self.shared.carrier.subscribe(&key, from, callback);
        self.endpoints.push(subscription.map_err(refused(key))?);
        Ok(())
    }

    /// Answers queries of any session's client on the key with this ending.
    fn serve_session(
        &mut self,
        key: String,
        label: &'static str,
        input: fn(Bytes, ReplyTo) -> Input<ReplyTo>,
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |query: Query| {
            let bytes = query.payload.clone();
            let Some(actor) = session_of(&shared, query.key.as_str()) else {
                return tell_it_is_over(&shared, label, &bytes, query);
            };
            if bytes.len() > MAX_CHECKED {
                return;
            }
            match actor.gate.ask(label, &bytes, query) {
                QueryCheck::New(number) => {
                    see(&shared, &actor);
                    if bytes.len() > limits::MAX_CLIENT_MESSAGE {
                        let refusal = Refusal::new(Code::Malformed, "", too_large(limits::MAX_CLIENT_MESSAGE));
                        return answer_refusal(&shared, &actor.gate, label, number, refusal);
                    }
                    shared.send(&actor, Side::Client, input(bytes, ReplyTo::Client(label, number)));
                }
                QueryCheck::Again(sealed, query) => answer_again(&shared, *sealed, query),
                QueryCheck::Nothing | QueryCheck::Foreign(_) => tell_of_refused(&shared, &actor),
            }
        };
        self.declare_queryable(Reach::Everywhere, key, callback)
    }

    /// Answers requests for records, for those who prove that they have the key; without a key records stay in this
    /// process.
    fn serve_records(&mut self, key: String) -> Result<(), ServerError> {
        for from in [Reach::ThisProcess, Reach::OtherProcesses] {
            let shared = Arc::clone(&self.shared);
            let callback = move |query: Query| {
                let Some(actor) = session_of(&shared, query.key.as_str()) else {
                    return reject(&query, Code::Closed, "", "there is no such session; open one");
                };
                if query.payload.len() > limits::MAX_CLIENT_MESSAGE {
                    return reject(&query, Code::Malformed, "", &too_large(limits::MAX_CLIENT_MESSAGE));
                }
                let bytes = query.payload.clone();
                let may = match &actor.rows {
                    Some(rows) => rows.is_proved("rows", &bytes, &query.attachment),
                    None => from == Reach::ThisProcess,
                };
                if !may {
                    let message = "only the server's recorders get records; give recorder and server the same \
                                   --recorder-key FILE, or read the server's bags";
                    return reject(&query, Code::Closed, "", message);
                }
                shared.send(&actor, Side::Recorder, Input::StepRecords(bytes, ReplyTo::Recorder(query)));
            };
            self.declare_queryable(from, key.clone(), callback)?;
        }
        Ok(())
    }

    /// Answers queries to the server of at most `largest` bytes: `waiting` counts those already queued, `push` queues another one.
    fn serve(
        &mut self,
        key: String,
        largest: usize,
        waiting: fn(&ServerState) -> usize,
        push: fn(&ServerState, Query),
    ) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |query: Query| {
            if query.payload.len() > largest {
                reject(&query, Code::Malformed, "", &too_large(largest));
            } else if waiting(&shared) >= MAX_REQUESTS {
                reject(&query, Code::Busy, "", "too many requests wait; try again later");
            } else {
                push(&shared, query);
            }
        };
        self.declare_queryable(Reach::Everywhere, key, callback)
    }

    fn declare_queryable(
        &mut self,
        from: Reach,
        key: String,
        callback: impl Fn(Query) + Send + Sync + 'static,
    ) -> Result<(), ServerError> {
        let queryable = self.shared.carrier.serve(&key, from, callback);
        self.endpoints.push(queryable.map_err(refused(key))?);
        Ok(())
    }

    fn watch_clients(&mut self, key: String) -> Result<(), ServerError> {
        let shared = Arc::clone(&self.shared);
        let callback = move |key: &str, seen: bool| {
            if let Some(actor) = session_of(&shared, key) {
                actor.token_gone.store(!seen, Ordering::Relaxed);
                shared.send(&actor, Side::Server, if seen { Input::ClientSeen } else { Input::ClientGone });
            }
        };
        let tokens = self.shared.carrier.watch_tokens(&key, callback);
        self.endpoints.push(tokens.map_err(refused(key))?);
        Ok(())
    }
}

fn session_of(shared: &ServerState, key: &str) -> Option<Arc<Actor>> {
    let (_, _, id) = keys::SessionKeys::of(key)?;
    shared.sessions.find(id)
}

fn take_open(shared: &ServerState, query: Query) {
    let key = shared.keys.open();
    if let Err(refusal) = names_one_server(&query, &key) {
        return reject_on(shared, key, query, "open", refusal);
    }
    let (payload, attachment) = parts(&query);
    let digest = Opens::digest(&payload, &attachment);
    match shared.opens.take(digest, query) {
        OpenCheck::New => shared.queues.jobs.push(Job::Open(payload, attachment, digest)),
        OpenCheck::Again(begun, query) => begin_again(shared, &key, *begun, query),
        OpenCheck::Joined => {}
    }
}

fn take_run(shared: &ServerState, query: Query) {
    let key = shared.keys.run();
    let (payload, attachment) = parts(&query);
    let request = names_one_server(&query, &key)
        .and_then(|()| decode::<RunRequest>(&payload, limits::MAX_RUN_REQUEST).map_err(|error| Refusal::from(&error)));
    let request = match request {
        Ok(request) => Box::new(request),
        Err(refusal) => return reject_on(shared, key, query, "run", refusal),
    };
    if request.link.is_empty() {
        let digest = Opens::digest(&payload, &attachment);
        match shared.opens.take(digest, query) {
            OpenCheck::New => shared.queues.runs.push(RunJob::Greeting(request, payload, attachment, digest)),
            OpenCheck::Again(begun, query) => begin_again(shared, &key, *begun, query),
            OpenCheck::Joined => {}
        }
        return;
    }
    let Some(link) = shared.links.get(&request.link) else { return reject_with(&query, no_link()) };
    match link.gate.ask("run", &payload, query) {
        QueryCheck::New(number) => shared.queues.runs.push(RunJob::Ask(request, payload, link, number)),
        QueryCheck::Again(sealed, query) => answer_again(shared, *sealed, query),
        QueryCheck::Nothing | QueryCheck::Foreign(_) => {}
    }
}

fn take_action(shared: &ServerState, actor: &Arc<Actor>, sample: &Sample) {
    let bytes = sample.payload.clone();
    if bytes.len() > MAX_CHECKED || !actor.gate.takes("action", &bytes, &sample.attachment) {
        return tell_of_refused(shared, actor);
    }
    see(shared, actor);
    let length = bytes.len();
    let is_small = length <= limits::MAX_CLIENT_MESSAGE;
    shared.send_action(actor, if is_small { Input::Action(bytes) } else { Input::TooLarge(length) });
}

/// Only an acknowledgement that goes further than earlier ones, or says that another episode is lost, is news; anybody can
/// resend an old one.
fn take_ack(shared: &ServerState, actor: &Arc<Actor>, sample: &Sample) {
    let bytes = sample.payload.clone();
    if bytes.len() > limits::MAX_CLIENT_MESSAGE || actor.is_replay {
        return tracing::debug!(session = actor.id, length = bytes.len(), "dropping an acknowledgement");
    }
    if let Some(rows) = &actor.rows {
        let Ok(ack) = decode::<StepRecordAck>(&bytes, limits::MAX_CLIENT_MESSAGE) else { return };
        if !rows.is_proved("ack", &bytes, &sample.attachment) || ack.next_seq > actor.next_seq.load(Ordering::Relaxed) {
            return;
        }
        let lost = (!ack.problem.is_empty()).then_some(ack.lost_episode);
        let mut acknowledged = lock(&actor.acknowledged);
        if acknowledged.is_some_and(|(next_seq, before)| ack.next_seq <= next_seq && lost <= before) {
            return;
        }
        let before = acknowledged.and_then(|(_, before)| before);
        *acknowledged = Some((ack.next_seq, lost.max(before)));
    }
    shared.send(actor, Side::Recorder, Input::Ack(bytes));
}

/// Notes that the client has shown that it exists, whatever became of its token.
fn see(shared: &ServerState, actor: &Arc<Actor>) {
    if actor.shows_up() {
        shared.send(actor, Side::Server, Input::ClientSeen);
    }
}

fn tell_of_refused(shared: &ServerState, actor: &Actor) {
    shared.refused.fetch_add(1, Ordering::Relaxed);
    if let Some(count) = actor.gate.refused(shared.now()) {
        tracing::warn!(session = actor.id, count, "dropping messages that are not of the session's client");
    }
}

fn answer_again(shared: &ServerState, sealed: Sealed, query: Query) {
    let key = query.key.clone();
    let Sealed { message, bytes, attachment } = sealed;
    shared.answer(query, AnswerKind::Own(key, message, bytes, Some(attachment)));
}

fn begin_again(shared: &ServerState, key: &str, begun: Begun, query: Query) {
    let Begun { message, bytes, attachment } = begun;
    shared.answer(query, AnswerKind::Own(key.into(), message, bytes, attachment));
}

/// Answers a query to a session that is not open: its former client gets a sealed answer, others get one on a
/// best-effort basis.
fn tell_it_is_over(shared: &ServerState, label: &'static str, bytes: &[u8], query: Query) {
    let refusal = Refusal::new(Code::Closed, "", "there is no such session; open one");
    let former = keys::SessionKeys::of(query.key.as_str()).and_then(|(_, _, id)| shared.sessions.former(id));
    let Some(gate) = former.filter(|_| bytes.len() <= MAX_CHECKED) else { return reject_with(&query, refusal) };
    match gate.ask(label, bytes, query) {
        QueryCheck::New(number) => answer_refusal(shared, &gate, label, number, refusal),
        QueryCheck::Again(sealed, query) => answer_again(shared, *sealed, query),
        QueryCheck::Foreign(query) => reject_with(&query, refusal),
        QueryCheck::Nothing => {}
    }
}

fn answer_refusal(shared: &ServerState, gate: &Gate, label: &'static str, number: u64, refusal: Refusal) {
    let (message, bytes) = in_form(label, refusal);
    // If a reply has no form for a refusal, the reply itself is one.
    let label = if message == "Refusal" { "refusal" } else { label };
    shared.answer_client(gate, label, number, message, bytes);
}

fn parts(query: &Query) -> (Bytes, Vec<u8>) {
    (query.payload.clone(), query.attachment.to_vec())
}

/// Sends a refusal on the server's own key: of several replies with one key, a query for all servers may keep only the
/// last.
fn reject_on(shared: &ServerState, key: String, query: Query, label: &str, refusal: Refusal) {
    let (message, bytes) = in_form(label, refusal);
    shared.answer(query, AnswerKind::Own(key, message, bytes, None));
}

/// Sends a refusal that is not signed.
fn reject(query: &Query, code: Code, field: &str, message: &str) {
    reject_with(query, Refusal::new(code, field, message));
}

fn reject_with(query: &Query, refusal: Refusal) {
    let label = query.key.as_str().rsplit('/').next().unwrap_or_default().to_owned();
    match in_form(&label, refusal) {
        ("Refusal", bytes) => refuse(query, bytes),
        (message, bytes) => reply(query, message, bytes),
    }
}

fn too_large(largest: usize) -> String {
    format!(
        "the request is larger than {largest} bytes; name consecutive seeds as ranges and leave out what is not needed, or make \
         several runs, each with its own part of the seeds"
    )
}

/// A refusal in the form that the query's key calls for, with the name of its message.
fn in_form(label: &str, refused: Refusal) -> (&'static str, Bytes) {
    match label {
        "open" => {
            let answer = OpenReply { reply: Some(open_reply::Reply::Refusal(refused)), welcome: None };
            ("OpenReply", answer.encode_to_vec().into())
        }
        "run" => {
            let answer = RunReply { reply: Some(run_reply::Reply::Refusal(refused)), welcome: None };
            ("RunReply", answer.encode_to_vec().into())
        }
        "reset" => {
            let answer = ResetReply { reply: Some(reset_reply::Reply::Refusal(refused)) };
            ("ResetReply", answer.encode_to_vec().into())
        }
        "look" => {
            let answer = LookReply { reply: Some(look_reply::Reply::Refusal(refused)) };
            ("LookReply", answer.encode_to_vec().into())
        }
        "close" => {
            let answer = CloseReply { refusal: Some(refused) };
            ("CloseReply", answer.encode_to_vec().into())
        }
        _ => ("Refusal", refused.encode_to_vec().into()),
    }
}
