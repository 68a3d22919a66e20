//! Shared by clients of raw messages: they say hello and seal as the protocol has it, and nothing else for their caller.

pub mod flood;
pub mod victim;

use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use fiatlux_access::{
    Channel, Greeting, Identity, Label, RowsKey, Secrets, Side, SignedReply, registration, run_identity,
};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    Observation, OpenReply, OpenRequest, Refusal, RunReply, RunRequest, RunStatus, SessionInfo, Welcome, open_reply,
    run_reply,
};
use fiatlux_proto::{Message, PROTOCOL};
use zenoh::bytes::ZBytes;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// For so long something is waited for, and after so long an action is sent again.
pub const LONG: Duration = Duration::from_secs(20);
const AGAIN: Duration = Duration::from_secs(1);

/// The keys of a session.
pub type Keys = Arc<Mutex<Channel>>;

pub fn channel_of(secrets: &Secrets) -> Keys {
    Arc::new(Mutex::new(Channel::new(secrets, Side::Client).unwrap()))
}

pub fn bytes_of(bytes: Option<&ZBytes>) -> Vec<u8> {
    bytes.map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default()
}

/// The messages that are published on a key from now on, whoever sends them.
pub fn subscribe<M: Message + Default + 'static>(zenoh: &Session, key: String) -> Receiver<M> {
    let (send, receive) = channel();
    let callback = move |sample: Sample| {
        let _ = send.send(M::decode(&*sample.payload().to_bytes()).unwrap());
    };
    zenoh.declare_subscriber(key).callback(callback).background().wait().unwrap();
    receive
}

/// Those that the session's server has sealed.
pub fn subscribe_sealed<M: Message + Default + 'static>(zenoh: &Session, key: String, keys: &Keys) -> Receiver<M> {
    let (send, receive) = channel();
    let (keys, label) = (Arc::clone(keys), key.rsplit('/').next().unwrap().to_owned());
    let callback = move |sample: Sample| {
        let (payload, attachment) = (sample.payload().to_bytes(), bytes_of(sample.attachment()));
        if keys.lock().unwrap().open(Label::Message(&label), &payload, &attachment).is_ok() {
            let _ = send.send(M::decode(&*payload).unwrap());
        }
    };
    zenoh.declare_subscriber(key).callback(callback).background().wait().unwrap();
    receive
}

/// The observation after a step. Its action is sent again as the protocol asks for: observations are lost until Zenoh knows who hears them.
pub fn answer(observations: &Receiver<Observation>, step: u64, act: impl Fn()) -> Observation {
    let began = Instant::now();
    loop {
        match observations.recv_timeout(AGAIN) {
            Ok(observation) if observation.step > step => return observation,
            Ok(_) => {}
            Err(error) => {
                assert!(began.elapsed() < LONG, "{error} after step {step}");
                act();
            }
        }
    }
}

/// Payload and attachment of a reply, or the refusal that an error reply has.
pub type Replied = Result<(Vec<u8>, Vec<u8>), Refusal>;

/// The replies to a query, with their attachments; errors are refusals.
pub fn replies(zenoh: &Session, key: &str, payload: Vec<u8>, attachment: Vec<u8>) -> Vec<Replied> {
    let query = zenoh.get(key).payload(payload).attachment(attachment).target(QueryTarget::All);
    let query = query.consolidation(ConsolidationMode::None);
    let read = |reply: zenoh::query::Reply| match reply.result() {
        Ok(sample) => Ok((sample.payload().to_bytes().into_owned(), bytes_of(sample.attachment()))),
        Err(error) => Err(Refusal::decode(&*error.payload().to_bytes()).unwrap()),
    };
    query.wait().unwrap().iter().map(read).collect()
}

/// Asks on a key of a session; the server's own answer, or its refusal.
pub fn ask_sealed<M: Message + Default>(
    zenoh: &Session,
    keys: &Keys,
    key: &str,
    payload: Vec<u8>,
) -> Option<Result<M, Refusal>> {
    let label = key.rsplit('/').next().unwrap();
    let attachment = keys.lock().unwrap().seal(Label::Message(label), &payload).to_vec();
    let number = u64::from_le_bytes(attachment[..8].try_into().unwrap());
    replies(zenoh, key, payload, attachment).into_iter().flatten().find_map(|(payload, attachment)| {
        let mut channel = keys.lock().unwrap();
        if channel.open(Label::Reply(label, number), &payload, &attachment).is_ok() {
            return Some(Ok(M::decode(&*payload).unwrap()));
        }
        let refused = channel.open(Label::Reply("refusal", number), &payload, &attachment).is_ok();
        refused.then(|| Err(Refusal::decode(&*payload).unwrap()))
    })
}

fn agree(
    greeting: Greeting,
    request: &[u8],
    server: &str,
    id: &str,
    content: &[u8],
    welcome: Option<&Welcome>,
) -> Secrets {
    let reply = SignedReply { request, server, id, content };
    let verified = greeting.verify(reply, welcome.expect("a welcome"), None).expect("it is signed");
    greeting.agree(&verified).unwrap()
}

/// Keys that open a session, besides the request.
pub fn greeting(zenoh: &Session) -> Greeting {
    Greeting::new(&zenoh.zid().to_string(), None).unwrap()
}

/// Opens a session, and gives what both sides know of it.
pub fn open_session(zenoh: &Session, server: &str, request: &OpenRequest) -> Result<(SessionInfo, Secrets), Refusal> {
    let greeting = greeting(zenoh);
    let request = OpenRequest { hello: Some(greeting.hello()), ..request.clone() }.encode_to_vec();
    // On a link that was flooded a moment ago a query can be lost; the same request is the same session.
    let ask = |_| replies(zenoh, &ServerKeys::new(server).open(), request.clone(), Vec::new());
    let mut answers = (0..3).map(ask).find(|answers| !answers.is_empty()).expect("an answer");
    assert_eq!(answers.len(), 1);
    let OpenReply { reply, welcome } = OpenReply::decode(&*answers.remove(0).unwrap().0).unwrap();
    match reply.unwrap() {
        open_reply::Reply::Session(info) => {
            let content = info.encode_to_vec();
            let secrets = agree(greeting, &request, server, &info.session, &content, welcome.as_ref());
            Ok((info, secrets))
        }
        open_reply::Reply::Refusal(refusal) => {
            let content = refusal.encode_to_vec();
            let _: Secrets = agree(greeting, &request, server, "", &content, welcome.as_ref());
            Err(refusal)
        }
    }
}

/// Opens the records of a session that is recorded by this key.
pub fn rows_key(key: &fiatlux_access::RecorderKey, info: &SessionInfo) -> RowsKey {
    RowsKey::of_recorder(key, &info.server, &info.session).unwrap()
}

/// A request to a run, by a client that has this secret and a new link for each request; with the secrets of a session.
pub fn ask_run(
    zenoh: &Session,
    server: &str,
    [run, secret]: [&str; 2],
    ask: Ask,
) -> (run_reply::Reply, Option<Secrets>) {
    let identity = run_identity(secret).unwrap();
    ask_run_as(zenoh, server, run, &identity, &identity.public().to_string(), ask)
}

/// The same by a client that names this public key.
pub fn ask_run_as(
    zenoh: &Session,
    server: &str,
    run: &str,
    identity: &Identity,
    key: &str,
    ask: Ask,
) -> (run_reply::Reply, Option<Secrets>) {
    let is_greeting = matches!(ask, Ask::Register(_) | Ask::Status(_));
    let first = if is_greeting { ask.clone() } else { Ask::Status(RunStatus {}) };
    let (reply, secrets) = greet_run(zenoh, server, run, identity, key, first);
    let run_reply::Reply::Run(info) = &reply else { return (reply, None) };
    if is_greeting {
        return (reply, None);
    }
    let mut link = Channel::new(&secrets.unwrap(), Side::Client).unwrap();
    let greeting = greeting(zenoh);
    let request = RunRequest {
        protocol: Some(PROTOCOL),
        run: run.into(),
        ask: Some(ask),
        hello: Some(greeting.hello()),
        link: info.link.clone(),
        ..RunRequest::default()
    };
    let request = request.encode_to_vec();
    let attachment = link.seal(Label::Message("run"), &request).to_vec();
    let mut answers = replies(zenoh, &ServerKeys::new(server).run(), request.clone(), attachment);
    let (payload, attachment) = answers.remove(0).unwrap();
    link.open(Label::Reply("run", 0), &payload, &attachment).unwrap();
    let RunReply { reply, welcome } = RunReply::decode(&*payload).unwrap();
    let reply = reply.unwrap();
    let secrets = match &reply {
        run_reply::Reply::Session(info) => {
            Some(agree(greeting, &request, server, &info.session, &info.encode_to_vec(), welcome.as_ref()))
        }
        _ => None,
    };
    (reply, secrets)
}

fn greet_run(
    zenoh: &Session,
    server: &str,
    run: &str,
    identity: &Identity,
    key: &str,
    ask: Ask,
) -> (run_reply::Reply, Option<Secrets>) {
    let greeting = greeting(zenoh);
    let request = RunRequest {
        protocol: Some(PROTOCOL),
        run: run.into(),
        key: key.into(),
        ask: Some(ask),
        hello: Some(greeting.hello()),
        ..RunRequest::default()
    };
    let request = request.encode_to_vec();
    let signature = identity.sign(&registration(server, &request)).to_vec();
    let mut answers = replies(zenoh, &ServerKeys::new(server).run(), request.clone(), signature);
    let RunReply { reply, welcome } = RunReply::decode(&*answers.remove(0).unwrap().0).unwrap();
    let reply = reply.unwrap();
    let (id, content) = match &reply {
        run_reply::Reply::Run(info) => (info.link.clone(), info.encode_to_vec()),
        run_reply::Reply::Refusal(refusal) => (String::new(), refusal.encode_to_vec()),
        run_reply::Reply::Session(_) => panic!("a session"),
    };
    let secrets = agree(greeting, &request, server, &id, &content, welcome.as_ref());
    (reply, Some(secrets))
}
