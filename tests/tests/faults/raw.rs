//! A peer that says exactly what a test tells it to.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

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

/// A valid request.
pub fn request(task: &str) -> OpenRequest {
    OpenRequest { protocol: Some(PROTOCOL), policy: "raw".into(), task: task.into(), ..OpenRequest::default() }
}

/// All replies to a query; an error reply is a [`Refusal`].
pub fn ask<M: Message + Default>(link: &Session, key: &str, payload: Vec<u8>) -> Vec<Result<M, Refusal>> {
    let replies = link.get(key).payload(payload).consolidation(ConsolidationMode::None).wait().unwrap();
    let read = |reply: Reply| match reply.result() {
        Ok(sample) => Ok(M::decode(&*sample.payload().to_bytes()).unwrap()),
        Err(error) => Err(Refusal::decode(&*error.payload().to_bytes()).unwrap()),
    };
    replies.iter().map(read).collect()
}

/// Sends bytes as an open request.
pub fn open(link: &Session, payload: Vec<u8>) -> Result<SessionInfo, Refusal> {
    let mut replies = ask::<OpenReply>(link, &ServerKeys::new("test").open(), payload);
    assert_eq!(replies.len(), 1, "one answer to each request");
    match replies.remove(0).unwrap().reply.unwrap() {
        open_reply::Reply::Session(session) => Ok(session),
        open_reply::Reply::Refusal(refusal) => Err(refusal),
    }
}

/// A session.
pub struct Raw {
    pub link: Session,
    pub keys: SessionKeys,
    observations: Receiver<Observation>,
    notices: Receiver<Notice>,
    _token: LivelinessToken,
}

impl Raw {
    /// Opens a session on the server at that port, and resets it to episode 0.
    pub fn open(port: u16, request: &OpenRequest) -> Self {
        let link = connect(port);
        let info = open(&link, request.encode_to_vec()).unwrap();
        let keys = ServerKeys::new("test").session(&info.session);
        let observations = subscribe(&link, keys.observation());
        let notices = subscribe(&link, keys.notice());
        let token = link.liveliness().declare_token(keys.client()).wait().unwrap();
        let reset = ask::<ResetReply>(&link, &keys.reset(), ResetRequest { episode: 0 }.encode_to_vec()).remove(0);
        assert!(matches!(reset.unwrap().reply, Some(reset_reply::Reply::Observation(_))));
        Self { link, keys, observations, notices, _token: token }
    }

    /// Publishes bytes as an action. They are sent, whatever else is on the way.
    pub fn send(&self, payload: Vec<u8>) {
        let put = self.link.put(self.keys.action(), payload);
        put.congestion_control(zenoh::qos::CongestionControl::Block).wait().unwrap();
    }

    /// Takes a step as the protocol has it.
    pub fn step(&self, step: u64) -> Observation {
        self.send(action(0, step).encode_to_vec());
        let observation = self.observations.recv_timeout(PATIENCE).unwrap();
        assert_eq!(observation.step, step + 1);
        observation
    }

    /// The next notice.
    pub fn notice(&self) -> Notice {
        self.notices.recv_timeout(PATIENCE).unwrap()
    }

    /// All notices until none has come for so long.
    pub fn notices_until_quiet(&self, quiet: Duration) -> Vec<Notice> {
        std::iter::from_fn(|| self.notices.recv_timeout(quiet).ok()).collect()
    }

    /// Nothing was observed that was not asked for.
    pub fn is_quiet(&self) -> bool {
        self.observations.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout)
    }
}

/// A valid action.
pub fn action(episode: u64, step: u64) -> Action {
    Action { episode, step, action: vec![0.0; JOINTS], joint_target: Vec::new() }
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

fn subscribe<M: Message + Default + 'static>(link: &Session, key: String) -> Receiver<M> {
    let (sender, receiver) = channel();
    let callback = move |sample: Sample| drop(sender.send(M::decode(&*sample.payload().to_bytes()).unwrap()));
    link.declare_subscriber(key).callback(callback).background().wait().unwrap();
    receiver
}
