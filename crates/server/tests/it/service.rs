//! A server and a client of raw messages in one process: what the protocol promises, over a real Zenoh session.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use crate::common::{Keys, LONG, answer, ask_sealed, channel_of, open_session, rows_key, subscribe, subscribe_sealed};
use fiatlux_access::{Label, RecorderKey, RowsKey};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::keys::{ServerKeys, SessionKeys};
use fiatlux_proto::v3::{
    Action, CloseReply, CloseRequest, Notice, Observation, OpenReply, OpenRequest, PropScale, Randomization, Refusal,
    ResetReply, ResetRequest, ServerInfo, SessionInfo, State, StepRecord, StepRecordAck, StepRecordRequest,
    WholeBodyCommand, notice, open_reply, refusal, reset_reply,
};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{RobotLayout, Row, RowDigest, Task};
use fiatlux_server::{RecordsTo, Server, ServerError, ServerOptions};
use fiatlux_wire::{header_digest, read_identity, read_row};
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
use zenoh::liveliness::LivelinessToken;
use zenoh::query::ConsolidationMode;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// The G1 with Inspire hands.
const LAYOUT: RobotLayout = RobotLayout { joints: 53, hand_bodies_per_side: 17 };
const JOINTS: usize = LAYOUT.joints;

fn start(options: ServerOptions) -> (Session, Server) {
    let zenoh = fiatlux_link::Link::embedded().unwrap().session().clone();
    let server = Server::start(fiatlux_link::carrier(&zenoh), options).unwrap();
    (zenoh, server)
}

fn options() -> ServerOptions {
    ServerOptions { name: "test".into(), workers: 1, ..ServerOptions::default() }
}

fn query<M: Message + Default>(zenoh: &Session, key: String, request: &impl Message) -> Vec<M> {
    let replies = zenoh.get(key).payload(request.encode_to_vec()).consolidation(ConsolidationMode::None);
    let replies = replies.wait().unwrap();
    let decode = |sample: &Sample| M::decode(&*sample.payload().to_bytes()).unwrap();
    replies.iter().map(|reply| decode(reply.result().unwrap())).collect()
}

fn open(zenoh: &Session, request: &OpenRequest) -> Result<SessionInfo, (refusal::Code, String)> {
    open_session(zenoh, "test", request).map(|(info, _)| info).map_err(|refusal| (refusal.code(), refusal.message))
}

fn request(task: &str) -> OpenRequest {
    OpenRequest { protocol: Some(PROTOCOL), task: task.into(), seed: 1, ..OpenRequest::default() }
}

/// A client that sends exactly the given messages.
struct Client {
    zenoh: Session,
    info: SessionInfo,
    keys: SessionKeys,
    sealing: Keys,
    /// Where records are sealed.
    rows: Option<RowsKey>,
    observations: Receiver<Observation>,
    notices: Receiver<Notice>,
    token: Option<LivelinessToken>,
}

impl Client {
    fn open(zenoh: &Session, request: &OpenRequest) -> Self {
        let (info, secrets) = open_session(zenoh, "test", request).unwrap();
        let keys = ServerKeys::new("test").session(&info.session);
        let sealing = channel_of(&secrets);
        let token = Some(zenoh.liveliness().declare_token(keys.client()).wait().unwrap());
        let observations = subscribe_sealed(zenoh, keys.observation(), &sealing);
        let notices = subscribe_sealed(zenoh, keys.notice(), &sealing);
        let client = Self { zenoh: zenoh.clone(), info, keys, sealing, rows: None, observations, notices, token };
        // A session that nobody claims is closed.
        assert!(client.ask::<Observation>(client.keys.observation(), Vec::new()).is_err(), "no episode runs");
        client
    }

    fn ask<M: Message + Default>(&self, key: String, payload: Vec<u8>) -> Result<M, Refusal> {
        ask_sealed(&self.zenoh, &self.sealing, &key, payload).expect("the server answers")
    }

    fn reset(&self, episode: u64) -> Result<Observation, refusal::Code> {
        let reply: ResetReply = self.ask(self.keys.reset(), ResetRequest { episode }.encode_to_vec()).unwrap();
        match reply.reply.unwrap() {
            reset_reply::Reply::Observation(observation) => Ok(observation),
            reset_reply::Reply::Refusal(refusal) => Err(refusal.code()),
        }
    }

    fn close(&self) -> CloseReply {
        self.ask(self.keys.close(), Vec::new()).unwrap()
    }

    fn send(&self, bytes: Vec<u8>) {
        let attachment = self.sealing.lock().unwrap().seal(Label::Message("action"), &bytes).to_vec();
        self.zenoh.put(self.keys.action(), bytes).attachment(attachment).wait().unwrap();
    }

    fn act(&self, episode: u64, step: u64) {
        self.send(Action { episode, step, action: action(step).to_vec(), ..Action::default() }.encode_to_vec());
    }

    fn step(&self, episode: u64, step: u64) -> Observation {
        self.act(episode, step);
        answer(&self.observations, step, || self.act(episode, step))
    }

    fn next(&self) -> Observation {
        self.observations.recv_timeout(LONG).unwrap()
    }

    fn is_quiet(&self) -> bool {
        self.observations.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout)
    }

    fn notice(&self) -> notice::Code {
        self.notices.recv_timeout(LONG).unwrap().code()
    }

    fn truths(&self, from_seq: u64, count: u64) -> Vec<StepRecord> {
        let request = StepRecordRequest { from_seq, count };
        let Some(rows) = &self.rows else { return query(&self.zenoh, self.keys.truth_rows(), &request) };
        let request = request.encode_to_vec();
        let proof = rows.prove("rows", &request).to_vec();
        let sealed = crate::common::replies(&self.zenoh, &self.keys.truth_rows(), request, proof);
        let open = |sealed: Vec<u8>| StepRecord::decode(&*rows.open(&sealed).unwrap()).unwrap();
        sealed.into_iter().map(|reply| open(reply.unwrap().0)).collect()
    }
}

fn action(step: u64) -> [f64; JOINTS] {
    std::array::from_fn(|joint| 0.3 * (step as f64 * 0.1 + joint as f64).sin())
}

/// The rows that those actions lead to, and their digest, without a service.
fn alone(task: Task, seed: u64, episode: u64, steps: u64) -> (Vec<Row>, String) {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::default());
    let spec = EpisodeSpec::new(task, seed, episode);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap());
    let mut episode = Episode::start(scene, &spec).unwrap();
    let mut rows = vec![episode.row().clone()];
    for step in 0..steps {
        if episode.step(&action(step)).is_err() {
            break;
        }
        rows.push(episode.row().clone());
    }
    (rows, episode.digest().hex())
}

/// Lost, doubled and broken messages cost time, never a wrong step: the rows are those of an episode without a service.
#[test]
fn an_episode_survives_a_bad_client() {
    let (zenoh, server) = start(options());
    let client = Client::open(&zenoh, &request("S05"));
    let live: Receiver<StepRecord> = subscribe(&zenoh, client.keys.truth_row());
    assert_eq!(client.info.joints.len(), JOINTS);
    let first = client.reset(4).unwrap();
    assert_eq!((first.episode, first.step, first.last_action.len()), (4, 0, JOINTS));
    assert_eq!(client.reset(4).unwrap(), first, "asked again");
    let mut refused = 0;
    let mut step = 0;
    let last = loop {
        match step % 10 {
            // Garbage, an unknown field, and numbers that cannot be.
            1 => client.send(vec![0xff; 40]),
            2 => {
                let good = Action { episode: 4, step, ..Action::default() }.encode_to_vec();
                client.send([good, vec![0x78, 1]].concat());
            }
            3 => client
                .send(Action { episode: 4, step, action: vec![f64::NAN; JOINTS], ..Action::default() }.encode_to_vec()),
            4 => client.send(Action { episode: 4, step, action: vec![0.0; 52], ..Action::default() }.encode_to_vec()),
            5 => client.act(3, step),
            6 => client.act(4, step + 1),
            7 => client.send(vec![0; 100_000]),
            // The observation was lost: the action before it again.
            8 => {
                client.act(4, step - 1);
                assert_eq!(client.next().step, step);
            }
            _ => {}
        }
        refused += u64::from((1..8).contains(&(step % 10)));
        let observation = client.step(4, step);
        step += 1;
        assert_eq!((observation.episode, observation.step), (4, step));
        if step == 100 || observation.end.is_some() {
            break observation;
        }
    };
    assert!(step > 40 && client.is_quiet(), "{step}");
    let (rows, digest) = alone(Task::S05, 1, 4, step);
    if let Some(end) = &last.end {
        assert_eq!(end.digest, digest);
    }
    let noticed: u64 = client.notices.try_iter().map(|notice| notice.count).sum();
    assert!(noticed <= refused && noticed >= refused.min(10), "{noticed} of {refused}");

    let truths = client.truths(0, 128);
    assert_eq!(truths.len() as u64, step + 1);
    // They are published beside the answers: the last may arrive after it was asked for.
    let heard: Vec<_> = truths.iter().map(|_| live.recv_timeout(LONG).unwrap()).collect();
    assert_eq!(heard, truths);
    assert!(live.try_iter().next().is_none(), "no row twice");
    let header = truths[0].header.as_ref().unwrap();
    assert_eq!((header.task.as_str(), header.seed, header.episode), ("S05", 1, 4));
    for (seq, (truth, row)) in truths.iter().zip(&rows).enumerate() {
        assert_eq!(truth.seq, seq as u64);
        assert_eq!(read_row(&State::decode(&*truth.state).unwrap(), LAYOUT).unwrap(), *row);
    }
    let events: usize = truths.iter().map(|truth| truth.events.len()).sum();
    assert!(events as u64 >= refused, "refused actions are recorded");

    assert_eq!(client.close(), CloseReply::default());
    assert!(client.close().refusal.is_some(), "closed already");
    assert_eq!(client.reset(5), Err(refusal::Code::Closed));
    if last.end.is_none() {
        let aborted = client.truths(step + 1, 1).remove(0);
        let end = aborted.result.unwrap().end.unwrap();
        assert_eq!((end.cause.as_str(), end.steps, end.digest), ("aborted", step, digest));
    }
    let next_seq = client.truths(0, 1)[0].seq + 1000;
    let ack = |next_seq| StepRecordAck { recorder: "r".into(), next_seq, ..StepRecordAck::default() }.encode_to_vec();
    zenoh.put(client.keys.truth_ack(), ack(next_seq)).wait().unwrap();
    assert_eq!(client.truths(0, 1).len(), 1, "nobody has what does not exist");
    let end = step + 1 + u64::from(last.end.is_none());
    zenoh.put(client.keys.truth_ack(), ack(end)).wait().unwrap();
    assert!(server.shutdown(LONG), "all is recorded");
}

/// The digest of the last observation is that of the rows in the truths, and of an episode without a service.
#[test]
fn an_episode_that_ends_says_how() {
    let (zenoh, server) = start(options());
    let client = Client::open(&zenoh, &OpenRequest { sensors: vec!["last_action".into()], ..request("S07") });
    client.reset(0).unwrap();
    let mut truths = Vec::new();
    let mut step = 0;
    let last = loop {
        let observation = client.step(0, step);
        assert!(observation.proprioception.is_none() && observation.hand_contact_force.is_empty());
        step += 1;
        if observation.end.is_some() {
            break observation;
        }
    };
    client.act(0, step);
    assert_eq!(client.notice(), notice::Code::Step, "no action follows the end");
    while (truths.len() as u64) < step + 1 {
        truths.extend(client.truths(truths.len() as u64, 50));
    }
    let end = last.end.unwrap();
    let result = truths.last().unwrap().result.clone().unwrap();
    assert_eq!((end.cause.as_str(), end.steps, result.end), ("fall", step, Some(end.clone())));
    let (_, digest) = alone(Task::S07, 1, 0, step);
    assert_eq!(end.digest, digest);
    // The chain can be made again from what is recorded alone, apart from its start.
    let header = truths[0].header.clone().unwrap();
    assert_ne!(header.digest_context, RowDigest::new(b"").hex());
    // And that start of the header; the result says which header it goes with.
    assert_eq!(read_identity(&header).unwrap().digest().hex(), header.digest_context);
    assert_eq!(truths.last().unwrap().result.as_ref().unwrap().header_digest, header_digest(&header));
    drop(server);
}

/// Whatever a session asks for that rows depend on, its header alone gives the start of the digest chain.
#[test]
fn a_header_gives_the_start_of_the_chain() {
    let (zenoh, server) = start(options());
    let random = |change: fn(&mut Randomization)| {
        let mut random = Randomization::default();
        change(&mut random);
        Some(random)
    };
    let socket = Some(PropScale { socket: 1.05, ladder_z: 1.1, ..PropScale::default() });
    let requests = [
        request("S01"),
        request("replace"),
        OpenRequest { randomization: random(|random| random.fixed_layout = true), ..request("S02") },
        OpenRequest { randomization: random(|random| random.fixed_start = true), ..request("S03") },
        OpenRequest { randomization: random(|random| random.fixed_hand_friction = true), ..request("S04") },
        OpenRequest { randomization: random(|random| random.prop_scale = true), ..request("S05") },
        OpenRequest { prop_scale: socket, ..request("S01") },
        OpenRequest { end_on: vec!["tip".into()], reward: "training".into(), ..request("S06") },
        OpenRequest {
            thresholds: [("fragility_n".into(), 30.5), ("grip_bodies".into(), 3.0)].into(),
            ..request("S07")
        },
        OpenRequest { episode_protocol: "published".into(), ..request("S08") },
        OpenRequest { robot: "g1_bare".into(), ..request("S01") },
        OpenRequest { gains: "sonic".into(), ..request("S01") },
    ];
    for request in requests {
        let client = Client::open(&zenoh, &request);
        client.reset(3).unwrap();
        let header = client.truths(0, 1).remove(0).header.unwrap();
        let identity = read_identity(&header).unwrap();
        assert_eq!(identity.digest().hex(), header.digest_context, "{request:?}");
        assert_eq!((identity.episode, identity.drives.len()), (3, header.joint_names.len()));
        assert!(identity.drives.iter().all(|drive| drive.armature > 0.0), "{request:?}");
        client.close();
    }
    drop(server);
}

#[test]
fn a_server_says_what_it_is_and_refuses_what_it_is_not() {
    let (zenoh, server) = start(ServerOptions { capacity: 1, ..options() });
    let info: ServerInfo = query(&zenoh, ServerKeys::new("test").describe(), &CloseRequest {}).remove(0);
    assert_eq!((info.tasks.len(), info.capacity, info.open_sessions), (14, 1, 0));
    assert!(
        matches!(Server::start(fiatlux_link::carrier(&zenoh), options()), Err(ServerError::Taken(name)) if name == "test")
    );
    assert!(matches!(open(&zenoh, &request("S13")), Err((refusal::Code::Unknown, _))));
    let client = Client::open(&zenoh, &request("S01"));
    let (code, message) = open(&zenoh, &request("S01")).unwrap_err();
    assert!(code == refusal::Code::Busy && message.contains("its places, 1, are all taken"), "{message}");
    client.close();
    assert!(open(&zenoh, &request("S01")).is_ok(), "its place is free");
    assert_eq!(query::<ResetReply>(&zenoh, ServerKeys::new("test").session("x").reset(), &CloseRequest {}).len(), 1);
    server.shutdown(Duration::from_millis(100));
}

/// A server with meshes of the robot names them to clients and recorders; with a folder that holds none it does not start.
#[test]
fn meshes_of_the_robot_are_named() {
    let folder = std::env::temp_dir().join(format!("fiatlux-service-meshes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let options = || ServerOptions { meshes: Some(folder.clone()), ..options() };
    let (zenoh, server) = start(ServerOptions { meshes: None, ..options() });
    let refused = Server::start(fiatlux_link::carrier(&zenoh), ServerOptions { name: "other".into(), ..options() });
    assert!(matches!(refused, Err(ServerError::Meshes(_))));
    assert_eq!(Client::open(&zenoh, &request("S07")).info.meshes, "");
    server.shutdown(Duration::ZERO);

    // Head, number of triangles, normal, corners, attribute.
    let corners = [0.0_f32, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0].map(f32::to_le_bytes);
    let file = [&[0; 80][..], &[1, 0, 0, 0], &[0; 12], corners.as_flattened(), &[0; 2]].concat();
    std::fs::write(folder.join("left_knee_link.STL"), file).unwrap();
    let (zenoh, server) = start(options());
    let client = Client::open(&zenoh, &request("S07"));
    client.reset(0).unwrap();
    let header = client.truths(0, 1).remove(0).header.unwrap();
    assert!(header.meshes.starts_with("meshes:") && header.meshes == client.info.meshes, "{}", header.meshes);
    server.shutdown(Duration::ZERO);
    std::fs::remove_dir_all(folder).unwrap();
}

/// The same bytes over a network as in one process, and a client that vanishes is noticed.
#[test]
fn an_episode_over_tcp() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
    let listens = CarrierArgs { listen: endpoint.clone(), ..CarrierArgs::default() }
        .open(Role::Server)
        .unwrap()
        .session()
        .clone();
    let key = RecorderKey::generate().unwrap();
    let records_to = RecordsTo::Recorders(key.clone());
    let options = ServerOptions { grace: Duration::from_millis(100), records_to, ..options() };
    let server = Server::start(fiatlux_link::carrier(&listens), options).unwrap();
    let connects =
        CarrierArgs { connect: endpoint, ..CarrierArgs::default() }.open(Role::Client).unwrap().session().clone();
    let mut client = Client::open(&connects, &request("S05"));
    client.rows = Some(rows_key(&key, &client.info));
    client.reset(0).unwrap();
    for step in 0..40 {
        assert_eq!(client.step(0, step).step, step + 1);
    }
    let (rows, _) = alone(Task::S05, 1, 0, 40);
    let truth = client.truths(40, 1).remove(0);
    assert_eq!(read_row(&State::decode(&*truth.state).unwrap(), LAYOUT).unwrap(), rows[40]);
    connects.close().wait().unwrap();
    let until = std::time::Instant::now() + LONG;
    while server.open_sessions() > 0 && std::time::Instant::now() < until {
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(server.open_sessions(), 0);
}

/// A client that goes loses its session and nobody else's.
#[test]
fn a_client_that_is_gone_is_let_go() {
    let (zenoh, server) = start(ServerOptions { grace: Duration::from_millis(200), ..options() });
    let mut gone = Client::open(&zenoh, &request("S07"));
    let stays = Client::open(&zenoh, &request("S07"));
    gone.reset(0).unwrap();
    gone.act(0, 0);
    gone.next();
    gone.token = None;
    assert_eq!(gone.notice(), notice::Code::Lost);
    assert_eq!(gone.reset(1), Err(refusal::Code::Closed));
    let last = gone.truths(0, 10).pop().unwrap();
    assert_eq!(last.result.unwrap().end.unwrap().cause, "aborted");
    stays.reset(0).unwrap();
    stays.act(0, 0);
    assert_eq!(stays.next().step, 1);
    assert_eq!(server.open_sessions(), 1);
    server.shutdown(LONG);
}

/// By the wall clock: one action is enough for many steps, and a step comes every 20 ms.
#[test]
fn real_time_goes_on_by_itself() {
    let (zenoh, server) = start(options());
    let client = Client::open(&zenoh, &OpenRequest { mode: 2, ..request("S07") });
    client.reset(0).unwrap();
    assert!(client.is_quiet(), "the clock starts with the first action");
    let start = std::time::Instant::now();
    client.act(0, 0);
    while client.next().step < 11 {}
    let seconds = start.elapsed().as_secs_f64();
    assert!(seconds > 0.19, "{seconds}");
    client.close();
    let held = client.truths(2, 1).remove(0).action;
    assert!(fiatlux_proto::v3::ActionRecord::decode(&*held).unwrap().held);
    drop(server);
}

/// A client that commands a velocity once and falls silent: half a second later the robot is told to stand.
#[test]
fn a_command_of_a_silent_client_expires() {
    let (zenoh, server) = start(options());
    let client = Client::open(&zenoh, &OpenRequest { mode: 2, sensors: Vec::new(), ..request("S07") });
    assert_eq!(client.info.command_timeout_s, 0.5);
    client.reset(0).unwrap();
    let walk = WholeBodyCommand { vx: 0.5, height: 0.75, ..WholeBodyCommand::default() };
    client.send(Action { whole_body: Some(walk), ..Action::default() }.encode_to_vec());
    while client.next().step < 30 {}
    assert_eq!(client.notice(), notice::Code::Late);
    client.close();
    let velocity = |step: u64| {
        let record = client.truths(step, 1).remove(0);
        let action = fiatlux_proto::v3::ActionRecord::decode(&*record.action).unwrap().action.unwrap();
        (record.step, action.whole_body.unwrap().vx)
    };
    assert_eq!([velocity(1), velocity(25), velocity(26), velocity(30)], [(1, 0.5), (25, 0.5), (26, 0.0), (30, 0.0)]);
    drop(server);
}

/// A client of an older version finds the server below the old root and is told what to do, in bytes that it can read.
#[test]
fn a_client_of_an_older_version_is_told_to_update() {
    let (zenoh, _server) = start(options());
    let keys = ServerKeys::legacy("test");
    let tokens = zenoh.liveliness().get("fiatlux/v1/*/alive").wait().unwrap();
    let token = tokens.recv().unwrap();
    assert_eq!(token.result().unwrap().key_expr().as_str(), "fiatlux/v1/test/alive");
    // Messages of an older client cannot be read by this version, and are not looked at.
    let ask = |key: String| zenoh.get(key).payload(vec![0xff; 20]).wait().unwrap().recv().unwrap();
    let opened = ask(keys.open());
    let bytes = opened.result().unwrap().payload().to_bytes();
    assert_eq!(bytes[0], 2 << 3 | 2, "field 2 of OpenReply");
    let open_reply::Reply::Refusal(refused) = OpenReply::decode(&*bytes).unwrap().reply.unwrap() else {
        panic!("opened")
    };
    let described = ask(keys.describe());
    let bytes = described.result().unwrap_err().payload().to_bytes();
    assert_eq!(Refusal::decode(&*bytes).unwrap(), refused);
    assert_eq!((refused.code(), refused.field.as_str()), (refusal::Code::Version, "protocol"));
    assert!(refused.message.contains("speaks protocol 3.") && refused.message.contains("update the client"));
}

/// A query that names no server gets one reply from each, and none of them opens a session.
#[test]
fn a_query_for_all_servers_is_answered_by_each() {
    let zenoh = fiatlux_link::Link::embedded().unwrap().session().clone();
    let start = |name: &str| {
        Server::start(fiatlux_link::carrier(&zenoh), ServerOptions { name: name.into(), ..options() }).unwrap()
    };
    let servers = [start("one"), start("two")];
    let any = ServerKeys::new("*");
    // As a client asks that knows nothing of consolidation.
    let names = zenoh.get(any.describe()).target(zenoh::query::QueryTarget::All).wait().unwrap();
    let name =
        |reply: zenoh::query::Reply| ServerInfo::decode(&*reply.result().unwrap().payload().to_bytes()).unwrap().server;
    let mut names: Vec<_> = names.iter().map(name).collect();
    names.sort();
    assert_eq!(names, ["one", "two"]);
    let request = request("S07").encode_to_vec();
    let replies = zenoh.get(any.open()).target(zenoh::query::QueryTarget::All).payload(request).wait().unwrap();
    let mut refused = 0;
    for reply in replies {
        let reply = OpenReply::decode(&*reply.result().unwrap().payload().to_bytes()).unwrap();
        let Some(open_reply::Reply::Refusal(refusal)) = reply.reply else { panic!("a session is open") };
        assert!(refusal.message.contains("must name one server"), "{}", refusal.message);
        refused += 1;
    }
    assert_eq!(refused, 2);
    assert_eq!(servers.map(|server| server.open_sessions()), [0, 0]);
}
