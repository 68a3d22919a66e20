//! A client against a small server that counts instead of simulating, over Zenoh.

mod fake;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use fiatlux_client::{
    Client, ClientError, Command, Policy, PolicyError, SessionFailure, describe_servers, find_server,
};
use fiatlux_link::Link;
use fiatlux_proto::keys::ServerKeys;
use fiatlux_proto::v3::{Observation, OpenRequest, SessionInfo};
use zenoh::{Session, Wait};

use fake::{FakeServer, HORIZON, tcp};

#[test]
fn an_episode_over_an_embedded_session() {
    let link = Link::embedded().expect("opens").session().clone();
    let server = FakeServer::new(&link, "lab", 0);
    run_two_episodes(&link, &server);
}

#[test]
fn an_episode_over_tcp() {
    let ([server_link, link], _) = tcp();
    let server = FakeServer::new(&server_link, "lab", 0);
    run_two_episodes(&link, &server);
}

/// Every seventh action is ignored by the server, as if it were lost.
#[test]
fn lost_actions_are_sent_again() {
    let link = Link::embedded().expect("opens").session().clone();
    let server = FakeServer::new(&link, "lab", 7);
    run_two_episodes(&link, &server);
}

fn run_two_episodes(link: &Session, server: &FakeServer) {
    let mut client = Client::open(&fiatlux_link::carrier(link), None, request()).expect("opens");
    let (mut policy, stop) =
        (fiatlux_policies::Policies::default().make("zero").expect("known"), AtomicBool::new(false));
    for episode in [0, 1] {
        let mut steps = Vec::new();
        let end = client.run_episode(episode, policy.as_mut(), &mut |step| steps.push(step), &stop).expect("ends");
        assert_eq!((end.steps, end.cause.as_str()), (HORIZON, "time-out"));
        assert_eq!(steps, (0..HORIZON).collect::<Vec<_>>());
        assert_eq!(server.steps.load(Ordering::Relaxed), HORIZON);
    }
    assert_eq!(client.round_trips().count() as u64, 2 * HORIZON);
    let [p50, p99] = [0.5, 0.99].map(|share| client.round_trips().quantile_s(share).expect("some") * 1e6);
    println!("round trip: {p50:.0} us (median), {p99:.0} us (99th percentile)");
    client.close().expect("closes");
    assert!(server.closed.load(Ordering::Relaxed));
}

#[test]
fn servers_are_found_by_name_or_alone() {
    let link = Link::embedded().expect("opens").session().clone();
    let (_a, b) = (FakeServer::new(&link, "a", 0), FakeServer::new(&link, "b", 0));
    assert_eq!(find_server(&fiatlux_link::carrier(&link), Some("b")).expect("is there"), "b");
    assert!(
        matches!(find_server(&fiatlux_link::carrier(&link), None), Err(ClientError::SeveralServers { found }) if found == ["a", "b"])
    );
    assert!(
        matches!(find_server(&fiatlux_link::carrier(&link), Some("c")), Err(ClientError::NotThere { found, .. }) if found == ["a", "b"])
    );
    let names = describe_servers(&fiatlux_link::carrier(&link)).expect("asks").into_iter().map(|info| info.server);
    assert_eq!(names.collect::<Vec<_>>(), ["a", "b"]);
    drop(b);
    assert_eq!(find_server(&fiatlux_link::carrier(&link), None).expect("is alone"), "a");
}

/// A session that the server gave away before it was used is opened again for some seconds; then the remedy is named.
#[test]
fn who_is_crowded_out_tries_again() {
    let link = Link::embedded().expect("opens").session().clone();
    let server = FakeServer::new(&link, "lab", 0);
    let open = || Client::open(&fiatlux_link::carrier(&link), None, request());
    server.evictions.store(3, Ordering::Relaxed);
    open().expect("opens at the fourth attempt").close().expect("closes");
    assert_eq!(server.evictions.load(Ordering::Relaxed), 0);
    server.evictions.store(u64::MAX, Ordering::Relaxed);
    let start = Instant::now();
    let error = open().map(|_| ()).expect_err("there is no place");
    assert!((5..20).contains(&start.elapsed().as_secs()), "{:?}", start.elapsed());
    assert!(matches!(&error, ClientError::Crowded { server } if server == "lab"), "{error}");
    let text = error.to_string();
    assert!(text.contains("--tokens") && text.contains("--capacity"), "{text}");
}

/// Only its token is there, below the old root.
#[test]
fn a_server_of_an_older_version_is_named() {
    let link = Link::embedded().expect("opens").session().clone();
    let _old = link.liveliness().declare_token(ServerKeys::legacy("old").alive()).wait().expect("declares");
    for wanted in [None, Some("old")] {
        let error = find_server(&fiatlux_link::carrier(&link), wanted).expect_err("it cannot be used").to_string();
        assert!(error.contains("server old is of an older version") && error.contains("update it"), "{error}");
    }
    let _new = FakeServer::new(&link, "new", 0);
    assert_eq!(find_server(&fiatlux_link::carrier(&link), None).expect("the other one does"), "new");
}

#[test]
fn what_the_server_refuses_reaches_the_user() {
    let link = Link::embedded().expect("opens").session().clone();
    let _server = FakeServer::new(&link, "lab", 0);
    let error = Client::open(&fiatlux_link::carrier(&link), None, OpenRequest { task: "S99".into(), ..request() })
        .expect_err("refused");
    assert_eq!(error.to_string(), "server lab refuses 'task': there is no S99; use S01");
}

#[test]
fn a_policy_that_gives_up_or_a_stop_ends_the_run() {
    struct Late;
    impl Policy for Late {
        fn name(&self) -> String {
            "late".into()
        }
        fn reset(&mut self, _info: &SessionInfo, _first: &Observation) -> Result<(), PolicyError> {
            Ok(())
        }
        fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
            Ok(Command::Action(vec![0.0; if observation.step < 5 { 2 } else { 1 }]))
        }
    }
    let link = Link::embedded().expect("opens").session().clone();
    let _server = FakeServer::new(&link, "lab", 0);
    let mut client = Client::open(&fiatlux_link::carrier(&link), None, request()).expect("opens");
    let stop = AtomicBool::new(false);
    let error = client.run_episode(0, &mut Late, &mut |_| {}, &stop).expect_err("gives up").to_string();
    assert_eq!(error, "policy late commands action of 1 numbers, not 2, in step 5; correct the policy");
    let mut policy = fiatlux_policies::Policies::default().make("zero").expect("known");
    let mut at = |step| stop.store(step == 3, Ordering::Relaxed);
    assert!(matches!(client.run_episode(1, policy.as_mut(), &mut at, &stop), Err(ClientError::Stopped)));
}

/// The server goes away in the middle of an episode; the answer says so, and nothing hangs.
#[test]
fn a_server_that_is_gone_is_told() {
    let link = Link::embedded().expect("opens").session().clone();
    let server = Mutex::new(Some(FakeServer::new(&link, "lab", 0)));
    let mut client = Client::open(&fiatlux_link::carrier(&link), None, request()).expect("opens");
    let mut policy = fiatlux_policies::Policies::default().make("zero").expect("known");
    let mut at = |step| {
        if step == 20 {
            server.lock().expect("is whole").take();
        }
    };
    let end = client.run_episode(0, policy.as_mut(), &mut at, &AtomicBool::new(false));
    assert!(matches!(end, Err(ClientError::Episode(SessionFailure::Silent { .. }))), "{end:?}");
}

fn request() -> OpenRequest {
    OpenRequest { task: "S01".into(), ..OpenRequest::default() }
}
