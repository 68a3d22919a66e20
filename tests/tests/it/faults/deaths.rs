//! Programs that die without a word.

use std::time::Duration;

use fiatlux_bag::{Bag, Completeness};
use fiatlux_tests::programs::{PATIENCE, Running, Service, Watch, alone, grade, played};

use super::LONG;

/// Guards that a client that dies costs its own episode alone: after the grace time its bag ends as aborted, with all rows
/// until then; the other session does not notice.
#[test]
fn a_client_dies() {
    let mut service = Service::start("client-dies", &["--grace", "1"]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut dies = service.client(&["--policy", "stand", "--task", "S05", "--recorded"]);
    let session = watch.wait_for(300);
    let mut stays = service.client(&[&LONG[..], &["--recorded"]].concat());
    watch.wait_for(600);
    dies.kill();
    let line = recorder.wait_for("aborted after ");
    assert!(stays.is_running() && line.contains(&session), "{line}");
    let path = line.split(": ").next().unwrap();
    let bag = Bag::open(path).unwrap();
    let end = bag.result().and_then(|result| result.end.clone()).unwrap();
    assert_eq!(bag.completeness(), &Completeness::Whole);
    assert!(end.steps >= 300 && bag.states().count() as u64 == end.steps + 1, "every row is there");
    assert_eq!(played(&mut stays), alone(&LONG));
    recorder.wait_for("time-out after 6000 steps");
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!((code, results["excluded"][0]["reason"].as_str()), (3, Some("aborted")));
    assert_eq!(results["episodes"][0]["state_digest"], alone(&LONG)[0].digest);
    assert!(service.server.is_running());
}

/// Guards that nobody waits for a dead server for ever, and nothing passes for whole: the client gives up with a message,
/// the recorder closes the bag as cut, and the scorer lists it and does not score it.
#[test]
fn the_server_dies() {
    let mut service = Service::start("server-dies", &[]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut client = service.client(&[&LONG[..], &["--recorded"]].concat());
    watch.wait_for(300);
    service.server.kill();
    let line = recorder.wait_for(": cut: ");
    assert!(line.contains("the server went away before the episode ended"), "{line}");
    let (status, _) = client.finish(Duration::from_secs(15));
    assert_eq!(status.code(), Some(1));
    assert!(client.log().contains("error: server test is gone: its token has been away for 5 s"), "{}", client.log());

    let [bag] = &service.folder.files(".mcap")[..] else { panic!("one bag") };
    let bag = Bag::open(bag).unwrap();
    let Completeness::Cut { next_step, .. } = bag.completeness() else { panic!("the bag is cut") };
    assert!(*next_step >= 300 && bag.states().count() as u64 == *next_step);
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!((code, results["excluded"][0]["reason"].as_str()), (3, Some("cut")));
    assert_eq!(results["episodes"].as_array().unwrap().len(), 0);
    recorder.signal("TERM");
    assert_eq!(recorder.finish(PATIENCE).0.code(), Some(3), "data was lost");
}

/// Guards that a client hears why its episode has no bag, also where that is known only after the last step.
#[test]
fn a_recorder_cannot_write() {
    let service = Service::start("recorder-full", &[]);
    for (blocks, policy) in [(16, "zero"), (64, "stand")] {
        let mut recorder = service.record_limited(blocks);
        let args = ["--policy", policy, "--task", "S07", "--seed", "1000", "--recorded"];
        let mut client = service.client(&args);
        let (status, _) = client.finish(PATIENCE);
        assert_eq!(status.code(), Some(3), "{policy}: {}", client.log());
        let said =
            "the recorder cannot write the bag of episode 0: File too large (os error 27): the episode goes on, but";
        let cut = client.log().lines().find(|line| line.starts_with("recording cut: ")).unwrap_or_default().to_owned();
        assert!(cut.contains(said), "{policy}: {}", client.log());
        recorder.signal("TERM");
        assert_eq!(recorder.finish(PATIENCE).0.code(), Some(3), "data was lost");
    }
}

/// Guards that a recorder that dies loses nothing: the session waits for the next one, which takes the bag up.
#[test]
fn the_recorder_dies() {
    let service = Service::start("recorder-dies", &[]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut client = service.client(&[&LONG[..], &["--recorded"]].concat());
    watch.wait_for(1000);
    recorder.kill();
    let parts = service.folder.files(".mcap.part");
    assert_eq!((parts.len(), service.folder.files(".mcap").len()), (1, 0));
    let mut recorder = service.record();
    recorder.wait_for("time-out after 6000 steps");
    assert_eq!(played(&mut client), alone(&LONG));
    assert!(service.folder.files(".part").is_empty());
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!((code, &results["episodes"][0]["state_digest"]), (0, &alone(&LONG)[0].digest.clone().into()));
}

/// Guards that a name means one server: a second one of that name on a network does not start, and says why.
#[test]
fn two_servers_of_one_name() {
    let mut service = Service::start("one-name", &[]);
    let endpoint = fiatlux_tests::programs::endpoint(service.port);
    let mut second = Running::start("sim-server", &["--name", "test", "-e", &endpoint], &service.folder);
    let (status, text) = second.finish(PATIENCE);
    assert_eq!((status.code(), text.as_str()), (Some(1), ""), "it is not ready");
    assert!(second.log().contains("error: another server is named 'test'"), "{}", second.log());
    assert!(service.server.is_running());
    let third =
        Running::start("sim-server", &["--name", "other", "-e", &endpoint], &service.folder).wait_for("as other");
    assert!(third.starts_with("connected to "), "{third}");
}

/// Guards the same where the two do not talk to each other but through a router.
#[test]
fn two_servers_of_one_name_behind_a_router() {
    let (service, _router) = Service::start_behind_router("one-name-router");
    let endpoint = fiatlux_tests::programs::endpoint(service.port);
    let mut second = Running::start("sim-server", &["--name", "test", "-e", &endpoint], &service.folder);
    let (status, text) = second.finish(PATIENCE);
    assert_eq!((status.code(), text.as_str()), (Some(1), ""), "it is not ready");
    assert!(second.log().contains("error: another server is named 'test'"), "{}", second.log());
}
