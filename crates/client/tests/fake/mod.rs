//! A small server that counts instead of simulating.

use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use fiatlux_access::{Channel, Identity, Label, Side, SignedReply, welcome};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{
    Action, CloseReply, EpisodeEnd, Image, Joint, LookReply, LookRequest, Mode, Observation, ObservationTerm,
    OpenReply, OpenRequest, Refusal, ResetReply, ResetRequest, ServerInfo, SessionInfo, TaskInfo, Verdict, look_reply,
    open_reply, reset_reply,
};
use fiatlux_proto::{Message, PROTOCOL, decode};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Steps of an episode.
pub const HORIZON: u64 = 200;

/// Digest of every episode.
pub const DIGEST: &str = "00ff";

/// A server's session and a client's, over TCP, and the endpoint.
pub fn tcp() -> ([Session; 2], String) {
    let socket = TcpListener::bind("127.0.0.1:0").expect("binds");
    let endpoints = vec![format!("tcp/{}", socket.local_addr().expect("is bound"))];
    drop(socket);
    let server = CarrierArgs { listen: endpoints.clone(), ..CarrierArgs::default() }
        .open(Role::Server)
        .expect("listens")
        .session()
        .clone();
    let client = CarrierArgs { connect: endpoints.clone(), ..CarrierArgs::default() }
        .open(Role::Client)
        .expect("connects")
        .session()
        .clone();
    ([server, client], endpoints.concat())
}

/// Serves one session, whose id is `1`.
pub struct FakeServer {
    pub steps: Arc<AtomicU64>,
    pub closed: Arc<AtomicBool>,
    /// Number of sessions that it closes before they are used.
    #[allow(dead_code, reason = "the tests of the program share this server, and nothing is crowded out there")]
    pub evictions: Arc<AtomicU64>,
    _alive: LivelinessToken,
    _queryables: Vec<Queryable<()>>,
    _actions: Subscriber<()>,
}

impl FakeServer {
    /// One of `lose` actions is ignored; 0 for none.
    pub fn new(link: &Session, name: &str, lose: u64) -> Self {
        let keys = ServerKeys::new(name);
        let session = keys.session("1");
        let (steps, episode, received) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)), AtomicU64::new(0));
        let present = {
            let (steps, episode) = (Arc::clone(&steps), Arc::clone(&episode));
            move || observation(episode.load(Ordering::Relaxed), steps.load(Ordering::Relaxed))
        };
        let info = ServerInfo { protocol: Some(PROTOCOL), server: name.into(), ..ServerInfo::default() };
        let server = name.to_owned();
        let sealing: Sealing = Arc::default();
        let (identity, opened) = (Identity::generate().expect("a key"), Arc::clone(&sealing));
        let open = move |bytes: &[u8]| {
            let request: OpenRequest = decode(bytes, 1 << 16).expect("a request");
            let hello = request.hello.clone().expect("a hello");
            let unknown = request.sensors.iter().find(|sensor| sensor.name == "smell");
            let reply = if let Some(sensor) = unknown {
                let message = format!("sensor '{}' does not exist; ask for camera", sensor.name);
                open_reply::Reply::Refusal(Refusal { field: "sensors".into(), message, ..Refusal::default() })
            } else if request.task == "S99" {
                let message = "there is no S99; use S01".into();
                open_reply::Reply::Refusal(Refusal { field: "task".into(), message, ..Refusal::default() })
            } else {
                open_reply::Reply::Session(SessionInfo {
                    seed: request.seed,
                    sensors: request.sensors,
                    ..session_info(&server)
                })
            };
            let (id, content) = match &reply {
                open_reply::Reply::Session(info) => ("1", info.encode_to_vec()),
                open_reply::Reply::Refusal(refusal) => ("", refusal.encode_to_vec()),
            };
            let said = SignedReply { request: bytes, server: &server, id, content: &content };
            let (welcome, secrets) = welcome(&identity, &hello, said).expect("a hello");
            *opened.lock().expect("a lock") = Some(Channel::new(&secrets, Side::Server).expect("keys"));
            OpenReply { reply: Some(reply), welcome: Some(welcome) }.encode_to_vec()
        };
        let reset = {
            let (steps, episode, present) = (Arc::clone(&steps), Arc::clone(&episode), present.clone());
            move |bytes: &[u8]| {
                let request: ResetRequest = decode(bytes, 1 << 16).expect("a request");
                steps.store(0, Ordering::Relaxed);
                episode.store(request.episode, Ordering::Relaxed);
                ResetReply { reply: Some(reset_reply::Reply::Observation(present())) }.encode_to_vec()
            }
        };
        let closed = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&closed);
        let close = move |_: &[u8]| {
            flag.store(true, Ordering::Relaxed);
            CloseReply::default().encode_to_vec()
        };
        let evictions = Arc::new(AtomicU64::new(0));
        let left = Arc::clone(&evictions);
        let (last, seen) = (present.clone(), present.clone());
        let last = move |_: &[u8]| {
            let evicts = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok();
            let gone =
                Refusal { code: Code::Closed.into(), message: "there is no such session".into(), ..Refusal::default() };
            if evicts { Err(gone) } else { Ok(last().encode_to_vec()) }
        };
        let look = move |bytes: &[u8]| {
            let request: LookRequest = decode(bytes, 1 << 16).expect("a request");
            let lidar = if request.sensors.iter().any(|name| name == "lidar") { vec![1.5; 5760] } else { Vec::new() };
            let seen = Observation { lidar, verdict: None, camera: None, ..seen() };
            LookReply { reply: Some(look_reply::Reply::Observation(seen)) }.encode_to_vec()
        };
        let queryables = vec![
            queryable(link, keys.describe(), move |_| info.encode_to_vec()),
            queryable(link, keys.open(), open),
            sealed(link, session.reset(), &sealing, move |bytes| Ok(reset(bytes))),
            sealed(link, session.observation(), &sealing, last),
            sealed(link, session.look(), &sealing, move |bytes| Ok(look(bytes))),
            sealed(link, session.close(), &sealing, move |bytes| Ok(close(bytes))),
        ];
        let publisher = link.declare_publisher(session.observation()).express(true).wait().expect("declares");
        let counted = Arc::clone(&steps);
        let act = move |sample: zenoh::sample::Sample| {
            let bytes = sample.payload().to_bytes();
            let attachment = sample.attachment().map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default();
            with(&sealing, |channel| channel.open(Label::Message("action"), &bytes, &attachment)).expect("sealed");
            let action: Action = decode(&bytes, 1 << 16).expect("an action");
            if lose > 0 && received.fetch_add(1, Ordering::Relaxed) % lose == lose - 1 {
                return;
            }
            let step = counted.load(Ordering::Relaxed);
            // Earlier ones come again where the client has waited for too long.
            assert!(action.step <= step, "action {} at step {step}", action.step);
            counted.fetch_max(action.step + 1, Ordering::Relaxed);
            let bytes = present().encode_to_vec();
            let attachment = with(&sealing, |channel| channel.seal(Label::Message("observation"), &bytes));
            publisher.put(bytes).attachment(attachment.to_vec()).wait().expect("publishes");
        };
        Self {
            steps,
            closed,
            evictions,
            _alive: link.liveliness().declare_token(keys.alive()).wait().expect("declares"),
            _queryables: queryables,
            _actions: link.declare_subscriber(session.action()).callback(act).wait().expect("declares"),
        }
    }
}

/// The keys of the session, once it is open.
type Sealing = Arc<Mutex<Option<Channel>>>;

fn sealed(
    link: &Session,
    key: String,
    sealing: &Sealing,
    answer: impl Fn(&[u8]) -> Result<Vec<u8>, Refusal> + Send + Sync + 'static,
) -> Queryable<()> {
    let (sealing, label) = (Arc::clone(sealing), key.rsplit('/').next().expect("a part").to_owned());
    let reply = move |query: Query| {
        let bytes = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        let attachment = query.attachment().map(|bytes| bytes.to_bytes().into_owned()).unwrap_or_default();
        let number = with(&sealing, |channel| channel.open(Label::Message(&label), &bytes, &attachment));
        let Ok(number) = number else { return };
        let (label, answer) = match answer(&bytes) {
            Ok(answer) => (label.as_str(), answer),
            Err(refusal) => ("refusal", refusal.encode_to_vec()),
        };
        let attachment = with(&sealing, |channel| channel.seal(Label::Reply(label, number), &answer));
        query.reply(query.key_expr().clone(), answer).attachment(attachment.to_vec()).wait().expect("replies");
    };
    link.declare_queryable(key).callback(reply).wait().expect("declares")
}

fn with<T>(sealing: &Sealing, act: impl FnOnce(&mut Channel) -> T) -> T {
    act(sealing.lock().expect("a lock").as_mut().expect("an open session"))
}

fn queryable(link: &Session, key: String, answer: impl Fn(&[u8]) -> Vec<u8> + Send + Sync + 'static) -> Queryable<()> {
    let reply = move |query: Query| {
        let bytes = query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default();
        query.reply(query.key_expr().clone(), answer(&bytes)).wait().expect("replies");
    };
    link.declare_queryable(key).callback(reply).wait().expect("declares")
}

fn session_info(server: &str) -> SessionInfo {
    SessionInfo {
        episode_protocol: "strict".into(),
        protocol: Some(PROTOCOL),
        server: server.into(),
        session: "1".into(),
        mode: Mode::Lockstep.into(),
        task: Some(TaskInfo {
            task: "S01".into(),
            horizon_steps: HORIZON,
            criteria: vec!["standing".into()],
            ..TaskInfo::default()
        }),
        terms: vec![
            term("camera", "camera.rgb", &[16, 16, 3]),
            term("lidar", "lidar", &[32, 180]),
            term("verdict", "verdict.criteria", &[1]),
        ],
        image_width: 16,
        image_height: 16,
        joints: vec![Joint::default(); 2],
        resend_s: 0.02,
        grace_s: Duration::from_secs(5).as_secs_f64(),
        control_dt: 0.02,
        action_scale: 0.5,
        ..SessionInfo::default()
    }
}

fn term(sensor: &str, field: &str, shape: &[u32]) -> ObservationTerm {
    ObservationTerm { sensor: sensor.into(), field: field.into(), shape: shape.into(), ..ObservationTerm::default() }
}

fn observation(episode: u64, step: u64) -> Observation {
    let end = EpisodeEnd { cause: "time-out".into(), steps: step, digest: DIGEST.into(), ..EpisodeEnd::default() };
    let camera = step.is_multiple_of(5).then(|| Image { width: 16, height: 16, rgb: vec![100; 768] });
    let verdict = Some(Verdict { criteria: vec![true], ..Verdict::default() });
    Observation { episode, step, camera, verdict, end: (step == HORIZON).then_some(end), ..Observation::default() }
}
