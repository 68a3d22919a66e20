//! A peer that says exactly what a test tells it to.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_access::{Channel, Greeting, Label, Secrets, Side, SignedReply};
use fiatlux_proto::keys::{ServerKeys, SessionKeys};
use fiatlux_proto::v3::{
    Action, Notice, Observation, OpenReply, OpenRequest, Refusal, ResetReply, ResetRequest, SessionInfo, open_reply,
    reset_reply,
};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_tests::programs::{PATIENCE, connect};
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Joints of the robot.
pub const JOINTS: usize = 53;

/// A request that a server accepts for the task.
pub fn request(task: &str) -> OpenRequest {
    OpenRequest { protocol: Some(PROTOCOL), policy: "raw".into(), task: task.into(), ..OpenRequest::default() }
}

/// All replies to a query; an error reply is a [`Refusal`].
pub fn ask<M: Message + Default>(link: &Session, key: &str, payload: Vec<u8>) -> Vec<Result<M, Refusal>> {
    ask_with(link, key, payload, None)
}

/// The same with an attachment.
pub fn ask_with<M: Message + Default>(
    link: &Session,
    key: &str,
    payload: Vec<u8>,
    attachment: Option<Vec<u8>>,
) -> Vec<Result<M, Refusal>> {
    let query = link.get(key).payload(payload).attachment(attachment).consolidation(ConsolidationMode::None);
    let replies = query.wait().unwrap();
    let read = |reply: Reply| match reply.result() {
        Ok(sample) => Ok(M::decode(&*sample.payload().to_bytes()).unwrap()),
        Err(error) => Err(Refusal::decode(&*error.payload().to_bytes()).unwrap()),
    };
    replies.iter().map(read).collect()
}

/// Sends bytes as an open request: a request that can be read gets a hello.
pub fn open(link: &Session, payload: Vec<u8>) -> Result<SessionInfo, Refusal> {
    open_with_keys(link, payload).map(|(info, _)| info)
}

fn open_with_keys(link: &Session, payload: Vec<u8>) -> Result<(SessionInfo, Option<Secrets>), Refusal> {
    let greeting = Greeting::new(&link.zid().to_string(), None).unwrap();
    let request = fiatlux_proto::decode::<OpenRequest>(&payload, usize::MAX);
    let payload = match request {
        Ok(request) => OpenRequest { hello: Some(greeting.hello()), ..request }.encode_to_vec(),
        Err(_) => payload,
    };
    let mut replies = ask::<OpenReply>(link, &ServerKeys::new("test").open(), payload.clone());
    assert_eq!(replies.len(), 1, "one answer to each request");
    let OpenReply { reply, welcome } = replies.remove(0).unwrap();
    match reply.unwrap() {
        open_reply::Reply::Session(info) => {
            let content = info.encode_to_vec();
            let said = SignedReply { request: &payload, server: "test", id: &info.session, content: &content };
            let verified = greeting.verify(said, &welcome.unwrap(), None).unwrap();
            let secrets = greeting.agree(&verified).unwrap();
            Ok((info, Some(secrets)))
        }
        open_reply::Reply::Refusal(refusal) => Err(refusal),
    }
}

/// A session that sends and receives raw messages.
pub struct Raw {
    pub link: Session,
    pub keys: SessionKeys,
    channel: Arc<Mutex<Channel>>,
    observations: Receiver<Observation>,
    notices: Receiver<Notice>,
    _token: LivelinessToken,
}

impl Raw {
    /// Opens a session on the server at that port, and resets it to episode 0.
    pub fn open(port: u16, request: &OpenRequest) -> Self {
        let link = connect(port);
        let (info, secrets) = open_with_keys(&link, request.encode_to_vec()).unwrap();
        let channel = Arc::new(Mutex::new(Channel::new(&secrets.unwrap(), Side::Client).unwrap()));
        let keys = ServerKeys::new("test").session(&info.session);
        let observations = subscribe(&link, keys.observation(), &channel);
        let notices = subscribe(&link, keys.notice(), &channel);
        let token = link.liveliness().declare_token(keys.client()).wait().unwrap();
        let raw = Self { link, keys, channel, observations, notices, _token: token };
        let reset = raw.ask::<ResetReply>(&raw.keys.reset(), ResetRequest { episode: 0 }.encode_to_vec());
        assert!(matches!(reset.unwrap().reply, Some(reset_reply::Reply::Observation(_))));
        raw
    }

    /// Asks on a key of the session.
    pub fn ask<M: Message + Default>(&self, key: &str, payload: Vec<u8>) -> Result<M, Refusal> {
        let label = key.rsplit('/').next().unwrap();
        let attachment = self.channel.lock().unwrap().seal(Label::Message(label), &payload).to_vec();
        let number = u64::from_le_bytes(attachment[..8].try_into().unwrap());
        let query = self.link.get(key).payload(payload).attachment(attachment);
        for reply in query.consolidation(ConsolidationMode::None).wait().unwrap() {
            let Ok(sample) = reply.result() else { continue };
            let payload = sample.payload().to_bytes();
            let attachment = sample.attachment().unwrap().to_bytes();
            let opens =
                |label| self.channel.lock().unwrap().open(Label::Reply(label, number), &payload, &attachment).is_ok();
            if opens(label) {
                return Ok(M::decode(&*payload).unwrap());
            }
            if opens("refusal") {
                return Err(Refusal::decode(&*payload).unwrap());
            }
        }
        panic!("the server does not answer {key}")
    }

    /// Publishes bytes as an action. They are sent, whatever else is on the way.
    pub fn send(&self, payload: Vec<u8>) {
        let attachment = self.channel.lock().unwrap().seal(Label::Message("action"), &payload).to_vec();
        let put = self.link.put(self.keys.action(), payload).attachment(attachment);
        put.congestion_control(zenoh::qos::CongestionControl::Block).wait().unwrap();
    }

    /// Takes a step as the protocol has it.
    pub fn step(&self, step: u64) -> Observation {
        self.send(action(0, step).encode_to_vec());
        let observation = self.observations.recv_timeout(PATIENCE).unwrap();
        assert_eq!(observation.step, step + 1);
        observation
    }

    /// The next notice; fails when none comes.
    pub fn notice(&self) -> Notice {
        self.notices.recv_timeout(PATIENCE).unwrap()
    }

    /// All notices until none has come for that time.
    pub fn notices_until_quiet(&self, quiet: Duration) -> Vec<Notice> {
        std::iter::from_fn(|| self.notices.recv_timeout(quiet).ok()).collect()
    }

    /// Nothing was observed that was not asked for.
    pub fn is_quiet(&self) -> bool {
        self.observations.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout)
    }
}

/// An action that the server accepts: zeros for all joints.
pub fn action(episode: u64, step: u64) -> Action {
    Action { episode, step, action: vec![0.0; JOINTS], ..Action::default() }
}

/// Bytes without a pattern, always the same ones.
pub fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    (0..length).map(|_| next()).collect()
}

fn subscribe<M: Message + Default + 'static>(link: &Session, key: String, keys: &Arc<Mutex<Channel>>) -> Receiver<M> {
    let (sender, receiver) = channel();
    let (keys, label) = (Arc::clone(keys), key.rsplit('/').next().unwrap().to_owned());
    let callback = move |sample: Sample| {
        let (payload, attachment) = (sample.payload().to_bytes(), sample.attachment().unwrap().to_bytes());
        if keys.lock().unwrap().open(Label::Message(&label), &payload, &attachment).is_ok() {
            drop(sender.send(M::decode(&*payload).unwrap()));
        }
    };
    link.declare_subscriber(key).callback(callback).background().wait().unwrap();
    receiver
}
