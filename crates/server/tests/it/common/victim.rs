//! A client whose session strangers reach for, and what they hear.

use std::sync::mpsc::{Receiver, channel};

use fiatlux_access::{Label, Secrets};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::keys::{ServerKeys, SessionKeys};
use fiatlux_proto::v3::{
    Action, CloseReply, CloseRequest, EpisodeEnd, Notice, Observation, OpenRequest, ResetReply, ResetRequest,
    SessionInfo, reset_reply,
};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_server::{Server, ServerOptions};
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::Locality;
use zenoh::{Session, Wait};

use super::{Keys, answer, ask_sealed, bytes_of, channel_of, open_session, subscribe_sealed};

pub const JOINTS: usize = 53;

/// A server, and the links of a client and of a stranger to it. What a stranger forges reaches the client, as through a router
/// without rules.
pub fn network(options: ServerOptions) -> (Server, Session, Session) {
    let (server, client, stranger, _) = linked(options, None);
    (server, client, stranger)
}

/// A link of a client.
pub fn connect(endpoint: &str) -> Session {
    let args = CarrierArgs { connect: vec![endpoint.to_owned()], ..CarrierArgs::default() };
    args.open(Role::Client).unwrap().session().clone()
}

/// As [`network`], with the server's endpoint; where it `serves` a name, its link drops forgeries, as that of `sim-server` does.
pub fn linked(options: ServerOptions, serves: Option<String>) -> (Server, Session, Session, String) {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let listens = CarrierArgs { listen: vec![endpoint.clone()], serves, ..CarrierArgs::default() };
    let listens = listens.open(Role::Server).unwrap().session().clone();
    let server = Server::start(fiatlux_link::carrier(&listens), options).unwrap();
    (server, connect(&endpoint), connect(&endpoint), endpoint)
}

pub fn options() -> ServerOptions {
    ServerOptions { name: "test".into(), workers: 2, ..ServerOptions::default() }
}

pub fn request() -> OpenRequest {
    OpenRequest { protocol: Some(PROTOCOL), task: "S07".into(), seed: 1, ..OpenRequest::default() }
}

pub fn action(step: u64) -> Vec<u8> {
    let numbers = (0..JOINTS).map(|joint| 0.3 * (step as f64 * 0.1 + joint as f64).sin()).collect();
    Action { step, action: numbers, ..Action::default() }.encode_to_vec()
}

pub struct Victim {
    pub link: Session,
    pub keys: SessionKeys,
    pub sealing: Keys,
    pub observations: Receiver<Observation>,
    pub notices: Receiver<Notice>,
    _token: LivelinessToken,
}

impl Victim {
    pub fn open(link: &Session) -> Self {
        Self::open_with(link, &request())
    }

    pub fn open_with(link: &Session, request: &OpenRequest) -> Self {
        let (info, secrets) = open_session(link, "test", request).unwrap();
        Self::enter(link, &info, &secrets)
    }

    pub fn enter(link: &Session, info: &SessionInfo, secrets: &Secrets) -> Self {
        let keys = ServerKeys::new("test").session(&info.session);
        let sealing = channel_of(secrets);
        let token = link.liveliness().declare_token(keys.client()).wait().unwrap();
        let observations = subscribe_sealed(link, keys.observation(), &sealing);
        let notices = subscribe_sealed(link, keys.notice(), &sealing);
        Self { link: link.clone(), keys, sealing, observations, notices, _token: token }
    }

    pub fn reset(&self) {
        let bytes = ResetRequest { episode: 0 }.encode_to_vec();
        let reply: ResetReply = ask_sealed(&self.link, &self.sealing, &self.keys.reset(), bytes).unwrap().unwrap();
        assert!(matches!(reply.reply, Some(reset_reply::Reply::Observation(_))), "{reply:?}");
    }

    /// Sends an action; returns what was sent.
    pub fn act(&self, step: u64) -> (Vec<u8>, Vec<u8>) {
        let bytes = action(step);
        let attachment = self.sealing.lock().unwrap().seal(Label::Message("action"), &bytes).to_vec();
        self.link.put(self.keys.action(), bytes.clone()).attachment(attachment.clone()).wait().unwrap();
        (bytes, attachment)
    }

    /// Plays to the end; `disturb` is called before each step.
    pub fn play(&self, disturb: impl Fn(u64)) -> EpisodeEnd {
        self.reset();
        for step in 0.. {
            disturb(step);
            self.act(step);
            let observation = answer(&self.observations, step, || drop(self.act(step)));
            assert_eq!(observation.step, step + 1);
            if let Some(end) = observation.end {
                return end;
            }
        }
        unreachable!()
    }

    pub fn close(&self) {
        let reply: CloseReply =
            ask_sealed(&self.link, &self.sealing, &self.keys.close(), CloseRequest {}.encode_to_vec())
                .unwrap()
                .unwrap();
        assert_eq!(reply, CloseReply::default());
    }
}

/// Key, payload and attachment of a message.
pub type Heard = (String, Vec<u8>, Vec<u8>);

/// All that a peer can see of what others say on a network.
pub fn overhear(link: &Session) -> Receiver<Heard> {
    let (sender, heard) = channel();
    let callback = move |sample: zenoh::sample::Sample| {
        let attachment = bytes_of(sample.attachment());
        let _ = sender.send((sample.key_expr().to_string(), sample.payload().to_bytes().into_owned(), attachment));
    };
    let subscriber = link.declare_subscriber("**").allowed_origin(Locality::Remote).callback(callback);
    subscriber.background().wait().unwrap();
    heard
}
