//! Runs on a server, by a client of raw messages: what counts, what may be tried again, and what nobody is told.

mod player;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use crate::common::{LONG, ask_run, ask_run_as, channel_of, open_session, subscribe};
use fiatlux_access::run_identity;
use fiatlux_bag::run::{EpisodeState, Ledger, LedgerError, Prefix, journal_of};
use fiatlux_bag::{Bag, Completeness};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::run_episode::State as StateMessage;
use fiatlux_proto::v3::run_request::Ask;
use fiatlux_proto::v3::{
    OpenRequest, Refusal, RunFinish, RunInfo, RunSpec, RunStatus, Source, StepRecord, StepRecordRequest, run_reply,
};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_server::{RecordError, Server, ServerError, ServerOptions};
use zenoh::{Session, Wait};

use player::Player;

const KEY: &str = "0123456789abcdef0123456789abcdef";
const JOINTS: usize = 53;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("runs").join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn options(folder: &Path) -> ServerOptions {
    let grace = Duration::from_millis(300);
    ServerOptions { name: "test".into(), workers: 2, grace, record: Some(folder.into()), ..ServerOptions::default() }
}

fn start(folder: &Path) -> (Session, Server) {
    let zenoh = fiatlux_link::Link::embedded().unwrap().session().clone();
    let server = Server::start(fiatlux_link::carrier(&zenoh), options(folder)).unwrap();
    (zenoh, server)
}

fn ask_with(zenoh: &Session, key: &str, ask: Ask) -> run_reply::Reply {
    ask_server(zenoh, "test", key, ask)
}

fn ask_server(zenoh: &Session, server: &str, key: &str, ask: Ask) -> run_reply::Reply {
    without_link(ask_run(zenoh, server, ["first", key], ask).0)
}

/// Each request has a link of its own.
fn without_link(reply: run_reply::Reply) -> run_reply::Reply {
    match reply {
        run_reply::Reply::Run(info) => run_reply::Reply::Run(RunInfo { link: String::new(), ..info }),
        other => other,
    }
}

fn ask(zenoh: &Session, ask: Ask) -> Result<RunInfo, Refusal> {
    match ask_with(zenoh, KEY, ask) {
        run_reply::Reply::Run(info) => Ok(info),
        run_reply::Reply::Refusal(refusal) => Err(refusal),
        run_reply::Reply::Session(_) => panic!("a session"),
    }
}

fn refused(zenoh: &Session, what: Ask) -> (Code, String, String) {
    match ask_with(zenoh, KEY, what) {
        run_reply::Reply::Refusal(refusal) => (refusal.code(), refusal.field, refusal.message),
        other => panic!("not refused: {other:?}"),
    }
}

fn status(zenoh: &Session) -> RunInfo {
    ask(zenoh, Ask::Status(RunStatus {})).unwrap()
}

/// Waits until no episode is open.
fn settled(zenoh: &Session) -> RunInfo {
    let until = Instant::now() + LONG;
    loop {
        let info = status(zenoh);
        if info.episodes.iter().all(|episode| episode.state() != StateMessage::Open) {
            return info;
        }
        assert!(Instant::now() < until, "{info:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// One task in these seeds.
fn spec(seeds: &[u64]) -> RunSpec {
    RunSpec {
        policy: "tiny".into(),
        policy_version: "1".into(),
        tasks: vec!["S07".into()],
        seeds: seeds.into(),
        ..RunSpec::default()
    }
}

#[test]
fn every_episode_is_played_once() {
    let folder = folder("once");
    let (zenoh, server) = start(&folder);
    let info = ask(&zenoh, Ask::Register(spec(&[1, 2]))).unwrap();
    assert_eq!(ask(&zenoh, Ask::Register(spec(&[1, 2]))), Ok(info.clone()), "taken up");
    assert_eq!(info.episodes.iter().map(|episode| episode.seed).collect::<Vec<_>>(), [1, 2]);

    let player = Player::open(&zenoh, 0);
    assert!(player.info.seed == 1 && !player.info.footprints.is_empty());
    let (code, field, message) = refused(&zenoh, Ask::Open(0));
    assert!(code == Code::Busy && field == "open" && message.contains(&player.info.session), "{message}");
    assert_eq!(refused(&zenoh, Ask::Finish(RunFinish {})).0, Code::Busy);
    assert_eq!(player.reset(1).unwrap_err().field, "episode");
    let end = player.play(0, u64::MAX).unwrap();
    assert_eq!(player.reset(0).unwrap_err().field, "episode", "once");
    player.close();
    let info = settled(&zenoh);
    let first = &info.episodes[0];
    assert_eq!((first.state(), &first.cause, &first.digest), (StateMessage::Played, &end.cause, &end.digest));
    assert_eq!((first.attempts, first.success, info.finished), (1, false, false));
    assert_eq!(refused(&zenoh, Ask::Open(0)).0, Code::Value);
    let info = ask(&zenoh, Ask::Finish(RunFinish {})).unwrap();
    assert!(info.finished && info.episodes[1].state() == StateMessage::Failed && info.episodes[1].cause == "not run");
    assert_eq!(ask(&zenoh, Ask::Finish(RunFinish {})), Ok(info), "finished once");
    assert_eq!(refused(&zenoh, Ask::Open(1)).0, Code::Closed);
    assert!(server.shutdown(LONG));

    let ledger = Ledger::read(journal_of(&folder.join("first"), "test")).unwrap();
    let EpisodeState::Played(played) = &ledger.episodes()[0].state else { panic!("{ledger:?}") };
    let bag = Bag::open(folder.join("first").join(&played.bag)).unwrap();
    assert_eq!(bag.completeness(), &Completeness::Whole);
    let ticket = bag.header().run.clone().unwrap();
    assert_eq!((ticket.run.as_str(), ticket.episode, ticket.attempt, ticket.hosted), ("first", 0, 1, false));
    assert_eq!((played.bag.as_str(), ticket.policy_version.as_str()), ("test-S07-s1-a1.mcap", "1"));
}

#[test]
fn what_does_not_fit_is_refused_by_field() {
    let (zenoh, _server) = start(&folder("fields"));
    assert_eq!(refused(&zenoh, Ask::Status(RunStatus {})).0, Code::Unknown);
    let session = |session: OpenRequest| RunSpec { session: Some(session), ..spec(&[1]) };
    // A person's actions are never ranked, so nobody gets hosted seeds for them.
    let hosted_for = |source| RunSpec {
        session: Some(OpenRequest { source, ..OpenRequest::default() }),
        hosted_seeds: 2,
        ..spec(&[])
    };
    let cases = [
        (RunSpec { policy: String::new(), ..spec(&[1]) }, "register.policy"),
        (RunSpec { policy_link: "a".repeat(600), ..spec(&[1]) }, "register.policy_link"),
        (RunSpec { tasks: vec!["S99".into()], ..spec(&[1]) }, "register.tasks"),
        (RunSpec { tasks: vec!["S07".into(), "s07".into()], ..spec(&[1]) }, "register.tasks"),
        (spec(&[1, 1]), "register.seeds"),
        (RunSpec { hosted_seeds: 2, ..spec(&[1]) }, "register.seeds"),
        (RunSpec { hosted_seeds: u32::MAX, ..spec(&[]) }, "register.hosted_seeds"),
        (session(OpenRequest { seed: 3, ..OpenRequest::default() }), "register.session.seed"),
        (session(OpenRequest { recorded: true, ..OpenRequest::default() }), "register.session.recorded"),
        (session(OpenRequest { take: true, ..OpenRequest::default() }), "register.session.take"),
        (session(OpenRequest { robot: "claw".into(), ..OpenRequest::default() }), "register.session.robot"),
        (hosted_for(Source::Person.into()), "register.session.source"),
        (hosted_for(7), "register.session.source"),
        (session(OpenRequest { action_delay_ms: 30, ..OpenRequest::default() }), "register.session.action_delay_ms"),
    ];
    for (spec, expected) in cases {
        let (_, field, message) = refused(&zenoh, Ask::Register(spec));
        assert!(field == expected && !message.is_empty(), "{expected}: {field}: {message}");
    }
    for key in ["", "short", &"g".repeat(32), &"0".repeat(65)] {
        let (run_reply::Reply::Refusal(refusal), _) =
            ask_run_as(&zenoh, "test", "first", &run_identity(KEY).unwrap(), key, Ask::Register(spec(&[1])))
        else {
            panic!("registered")
        };
        assert_eq!(refusal.field, "key");
    }
    ask(&zenoh, Ask::Register(spec(&[1]))).unwrap();
    assert_eq!(refused(&zenoh, Ask::Register(spec(&[2]))).1, "register.seeds");
    let other = "f".repeat(32);
    for what in [Ask::Register(spec(&[1])), Ask::Status(RunStatus {}), Ask::Open(0), Ask::Finish(RunFinish {})] {
        let run_reply::Reply::Refusal(refusal) = ask_with(&zenoh, &other, what) else { panic!("with another key") };
        assert_eq!((refusal.code(), refusal.field.as_str()), (Code::Value, "key"));
    }
    assert_eq!(refused(&zenoh, Ask::Open(1)).0, Code::Value);
}

/// An attempt that broke off may be made again, where it goes the way that it went before.
#[test]
fn a_later_attempt_repeats_the_one_before() {
    let folder = folder("again");
    let (zenoh, server) = start(&folder);
    ask(&zenoh, Ask::Register(spec(&[1, 2]))).unwrap();
    for episode in [0, 1] {
        let player = Player::open(&zenoh, episode);
        assert_eq!(player.play(0, 6), None);
        // The client dies.
        drop(player);
    }
    let info = settled(&zenoh);
    assert_eq!((info.episodes[0].state(), info.episodes[0].attempts), (StateMessage::Unspecified, 1));
    assert!(info.episodes[0].cause.contains("liveliness token"), "{}", info.episodes[0].cause);
    // A shorter one binds no less.
    let player = Player::open(&zenoh, 0);
    assert_eq!(player.play(0, 2), None);
    player.close();
    settled(&zenoh);
    let prefix = || {
        let ledger = Ledger::read(journal_of(&folder.join("first"), "test")).unwrap();
        ledger.episodes()[0].prefix.clone()
    };
    assert!(matches!(prefix(), Some(Prefix { steps: 6, .. })));

    let player = Player::open(&zenoh, 0);
    let end = player.play(0, u64::MAX).unwrap();
    player.close();
    let other = Player::open(&zenoh, 1);
    other.reset(0).unwrap();
    // It leaves the way at once, and is seen at once: there is nothing to find out.
    other.act(1, 0);
    let notice = other.notices.recv_timeout(LONG).unwrap();
    assert!(notice.message.contains("did not repeat"), "{}", notice.message);
    let info = settled(&zenoh);
    let [first, second] = &info.episodes[..] else { panic!("two episodes") };
    assert_eq!((first.state(), &first.digest, first.attempts), (StateMessage::Played, &end.digest, 3));
    assert_eq!((second.state(), second.cause.as_str()), (StateMessage::Failed, "not repeated"));
    assert!(other.observations.try_recv().is_err(), "what differs is not shown");
    assert!(server.shutdown(LONG));
}

/// A server that died is back: what was open binds nothing, what was abandoned still does.
#[test]
fn a_run_outlives_its_server() {
    let folder = folder("outlives");
    let (zenoh, server) = start(&folder);
    ask(&zenoh, Ask::Register(spec(&[1, 2]))).unwrap();
    let player = Player::open(&zenoh, 1);
    player.play(0, 6);
    player.close();
    settled(&zenoh);
    let player = Player::open(&zenoh, 0);
    player.play(0, 6);
    drop(server);
    // As far as it got with a line.
    let journal = journal_of(&folder.join("first"), "test");
    let written = fs::read(&journal).unwrap();
    fs::write(&journal, [&written[..], b"{\"event\":\"pl"].concat()).unwrap();

    let (zenoh, server) = start(&folder);
    let info = ask(&zenoh, Ask::Register(spec(&[1, 2]))).unwrap();
    assert_eq!((info.episodes[0].state(), info.episodes[0].attempts), (StateMessage::Unspecified, 1));
    let player = Player::open(&zenoh, 0);
    let end = player.play(1, u64::MAX).unwrap();
    player.close();
    assert_eq!(settled(&zenoh).episodes[0].digest, end.digest);
    let ledger = Ledger::read(&journal).unwrap();
    assert_eq!((ledger.episodes()[0].lost, ledger.episodes()[0].prefix.as_ref()), (1, None));
    let player = Player::open(&zenoh, 1);
    player.reset(0).unwrap();
    player.act(1, 0);
    assert_eq!(settled(&zenoh).episodes[1].cause, "not repeated");
    assert!(server.shutdown(LONG));
}

/// Nothing that reaches a client on the network tells a hosted seed before the run is over.
#[test]
fn hosted_seeds_are_not_told() {
    let folder = folder("hosted");
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = vec![format!("tcp/127.0.0.1:{port}")];
    let listens = CarrierArgs { listen: endpoint.clone(), ..CarrierArgs::default() }
        .open(Role::Server)
        .unwrap()
        .session()
        .clone();
    let server = Server::start(fiatlux_link::carrier(&listens), options(&folder)).unwrap();
    let zenoh =
        CarrierArgs { connect: endpoint, ..CarrierArgs::default() }.open(Role::Client).unwrap().session().clone();
    let heard: Receiver<StepRecord> = subscribe(&zenoh, "fiatlux/v3/test/s/*/truth/row".into());
    let hosted = RunSpec { hosted_seeds: 2, ..spec(&[]) };
    let info = ask(&zenoh, Ask::Register(hosted.clone())).unwrap();
    assert!(info.episodes.len() == 2 && info.episodes.iter().all(|episode| episode.seed == 0));

    let player = Player::open(&zenoh, 0);
    assert!(player.info.seed == 0 && player.info.footprints.is_empty());
    player.play(0, 5);
    let rows = zenoh.get(player.keys.truth_rows());
    let rows = rows.payload(StepRecordRequest { from_seq: 0, count: 10 }.encode_to_vec()).wait().unwrap();
    let rows: Vec<_> = rows.iter().collect();
    assert_eq!(rows.len(), 1);
    for reply in rows {
        let refusal = Refusal::decode(&*reply.result().unwrap_err().payload().to_bytes()).unwrap();
        assert_eq!(refusal.code(), Code::Closed);
    }
    player.close();
    let info = settled(&zenoh);
    assert!(info.episodes.iter().all(|episode| episode.seed == 0));
    assert!(heard.try_recv().is_err(), "rows stay on the server");
    let player = Player::open(&zenoh, 0);
    player.play(0, u64::MAX).unwrap();
    player.close();
    settled(&zenoh);

    let info = ask(&zenoh, Ask::Finish(RunFinish {})).unwrap();
    let seeds: Vec<u64> = info.episodes.iter().map(|episode| episode.seed).collect();
    assert!(seeds[0] != seeds[1] && seeds.iter().all(|seed| (1 << 32..1 << 53).contains(seed)), "{seeds:?}");
    let ledger = Ledger::read(journal_of(&folder.join("first"), "test")).unwrap();
    let EpisodeState::Played(played) = &ledger.episodes()[0].state else { panic!("{ledger:?}") };
    let bag = Bag::open(folder.join("first").join(&played.bag)).unwrap();
    assert!(bag.header().seed == seeds[0] && bag.header().run.as_ref().unwrap().hosted);
    drop(server);
}

#[test]
fn one_server_of_a_name_records_into_a_folder() {
    let folder = folder("locked");
    let (_, server) = start(&folder);
    // On another network: the name is free there.
    let other = fiatlux_link::Link::embedded().unwrap().session().clone();
    let refused = Server::start(fiatlux_link::carrier(&other), options(&folder));
    assert!(matches!(refused, Err(ServerError::Record(RecordError::Taken { .. }))));
    let named = ServerOptions { name: "other".into(), ..options(&folder) };
    drop(Server::start(fiatlux_link::carrier(&other), named).unwrap());
    drop(server);
    drop(Server::start(fiatlux_link::carrier(&other), options(&folder)).unwrap());
}

#[test]
fn a_server_without_a_folder_keeps_no_runs() {
    let zenoh = fiatlux_link::Link::embedded().unwrap().session().clone();
    let options = ServerOptions { record: None, ..options(Path::new("")) };
    let _server = Server::start(fiatlux_link::carrier(&zenoh), options).unwrap();
    let (code, _, message) = refused(&zenoh, Ask::Register(spec(&[1])));
    assert!(code == Code::Unknown && message.contains("--record DIR"), "{message}");
}

/// A bag that cannot be written ends the session, and its episode is abandoned for that reason.
#[test]
fn a_bag_that_is_lost_is_not_an_episode() {
    let folder = folder("lost");
    let (zenoh, server) = start(&folder);
    ask(&zenoh, Ask::Register(spec(&[1]))).unwrap();
    // The journal goes on in the file that it has open.
    fs::rename(folder.join("first"), folder.join("moved")).unwrap();
    fs::write(folder.join("first"), "a file in place of the folder").unwrap();
    let player = Player::open(&zenoh, 0);
    player.reset(0).unwrap();
    let notice = player.notices.recv_timeout(LONG).unwrap();
    assert!(notice.message.contains("its recording is lost"), "{}", notice.message);
    let info = settled(&zenoh);
    assert_eq!(info.episodes[0].state(), StateMessage::Unspecified);
    assert!(info.episodes[0].cause.starts_with("the recording is lost: "), "{}", info.episodes[0].cause);
    fs::remove_file(folder.join("first")).unwrap();
    fs::rename(folder.join("moved"), folder.join("first")).unwrap();
    let player = Player::open(&zenoh, 0);
    player.play(0, u64::MAX).unwrap();
    player.close();
    assert_eq!(settled(&zenoh).episodes[0].state(), StateMessage::Played);
    drop(server);
}

/// Sessions outside of runs are recorded too, whether they asked for it or not.
#[test]
fn every_session_is_recorded() {
    let folder = folder("every");
    let (zenoh, server) = start(&folder);
    let request = OpenRequest { protocol: Some(PROTOCOL), task: "S07".into(), seed: 1, ..OpenRequest::default() };
    let (info, secrets) = open_session(&zenoh, "test", &request).unwrap();
    let bags = folder.join("test").join(&info.session);
    let player = Player::of(&zenoh, info, channel_of(&secrets));
    let end = player.play(0, u64::MAX).unwrap();
    player.reset(1).unwrap();
    player.close();
    assert!(server.shutdown(LONG));
    let bag = Bag::open(bags.join("S07-s1-e0.mcap")).unwrap();
    assert_eq!((bag.result().unwrap().end.as_ref(), bag.header().run.as_ref()), (Some(&end), None));
    let aborted = Bag::open(bags.join("S07-s1-e1.mcap")).unwrap();
    assert_eq!(aborted.result().unwrap().end.as_ref().unwrap().cause, "aborted");
}

/// A journal that was changed by hand is left alone: its run is not taken up, nor is its name given away.
#[test]
fn a_damaged_journal_is_left_alone() {
    let folder = folder("damaged");
    let (zenoh, server) = start(&folder);
    ask(&zenoh, Ask::Register(spec(&[1]))).unwrap();
    drop(server);
    let journal = journal_of(&folder.join("first"), "test");
    let damaged = fs::read_to_string(&journal).unwrap().replace("\"seed\":1", "\"seed\":2");
    fs::write(&journal, &damaged).unwrap();
    assert!(matches!(Ledger::read(&journal), Err(LedgerError::Line { line: 1, .. })));
    drop(zenoh);
    let (zenoh, _server) = start(&folder);
    assert_eq!(refused(&zenoh, Ask::Status(RunStatus {})).0, Code::Unknown);
    let (code, _, message) = refused(&zenoh, Ask::Register(spec(&[1])));
    assert!(code == Code::Busy && message.contains("another name"), "{message}");
    assert_eq!(fs::read_to_string(&journal).unwrap(), damaged);
}

/// Servers that record into one folder share a run: its seeds, what was played, and what an attempt must repeat.
#[test]
fn servers_share_a_run() {
    let folder = folder("shared");
    let (zenoh, server) = start(&folder);
    let other = ServerOptions { name: "other".into(), ..options(&folder) };
    let other = Server::start(fiatlux_link::carrier(&zenoh), other).unwrap();
    let at_other = |what: Ask| match ask_server(&zenoh, "other", KEY, what) {
        run_reply::Reply::Run(info) => Ok(info),
        run_reply::Reply::Refusal(refusal) => Err((refusal.code(), refusal.field)),
        run_reply::Reply::Session(_) => panic!("a session"),
    };
    let hosted = RunSpec { hosted_seeds: 3, ..spec(&[]) };
    ask(&zenoh, Ask::Register(hosted.clone())).unwrap();
    let fewer = RunSpec { hosted_seeds: 2, ..spec(&[]) };
    assert_eq!(at_other(Ask::Register(fewer)), Err((Code::Value, "register.hosted_seeds".into())));
    at_other(Ask::Register(hosted)).unwrap();

    let player = Player::open(&zenoh, 0);
    assert_eq!(at_other(Ask::Open(0)), Err((Code::Busy, "open".into())), "open there");
    player.play(0, u64::MAX).unwrap();
    player.close();
    let player = Player::open(&zenoh, 1);
    player.play(0, 6);
    player.close();
    settled(&zenoh);
    assert_eq!(at_other(Ask::Open(0)), Err((Code::Value, "open".into())), "played there");
    let player = Player::open(&zenoh, 2);
    player.play(0, 3);
    // The first server dies with an episode open; the second goes on with both.
    drop(server);
    let player = Player::open_on(&zenoh, "other", 2);
    player.play(1, u64::MAX).unwrap();
    player.close();
    let player = Player::open_on(&zenoh, "other", 1);
    player.reset(0).unwrap();
    player.act(1, 0);
    let notice = player.notices.recv_timeout(LONG).unwrap();
    assert!(notice.message.contains("did not repeat"), "{}", notice.message);
    let until = Instant::now() + LONG;
    let info = loop {
        match at_other(Ask::Finish(RunFinish {})) {
            Ok(info) => break info,
            Err(refusal) => assert!(refusal.0 == Code::Busy && Instant::now() < until, "{refusal:?}"),
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    // The first is dead, and begins nothing more of a run that has ended.
    assert!(info.finished && info.episodes.iter().all(|episode| episode.seed >= 1 << 32));
    let server = Server::start(fiatlux_link::carrier(&zenoh), options(&folder)).unwrap();
    assert_eq!(refused(&zenoh, Ask::Open(1)).0, Code::Closed);
    let info = ask(&zenoh, Ask::Finish(RunFinish {})).unwrap();
    assert!(info.episodes.iter().all(|episode| episode.seed >= 1 << 32));
    assert_eq!(at_other(Ask::Status(RunStatus {})).unwrap().episodes[2].seed, info.episodes[2].seed);
    drop((server, other));
}
