//! Links that break, and links that lose messages.

use fiatlux_tests::lossy::LossyProxy;
use fiatlux_tests::programs::{
    PATIENCE, Played, Running, Scratch, Service, Watch, alone, client, endpoint, free_port, grade, played, record,
    router,
};

use super::LONG;

/// Guards that a link that is gone for a moment costs time alone: every program finds its way back through the new router.
#[test]
fn the_router_dies_and_comes_back() {
    let (mut service, mut old_router) = Service::start_behind_router("router");
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut client = service.client(&[&LONG[..], &["--recorded"]].concat());
    watch.wait_for(1000);
    old_router.kill();
    assert!(client.is_running(), "it is in the middle of its episode");
    let _new_router = router(service.port, &service.folder);
    assert_eq!(played(&mut client), alone(&LONG));
    recorder.wait_for("time-out after 6000 steps");
    let (code, results) = grade(&service.bags(), &service.folder);
    assert_eq!((code, results["excluded"].as_array().unwrap().len()), (0, 0), "{results:#}");
    assert_eq!(results["episodes"][0]["state_digest"], alone(&LONG)[0].digest);
    assert!(service.server.is_running());
    for log in [service.server.log(), client.log(), recorder.log()] {
        assert!(!log.contains("Query not found") && !log.contains(".cargo/registry"), "{log}");
    }
}

/// Guards that where nothing listens our own error is all that is said.
#[test]
fn a_refused_connection_is_one_line() {
    let folder = Scratch::new("refused");
    let (endpoint, bags) = (endpoint(free_port()), folder.path().join("bags").display().to_string());
    let key = folder.path().join("recorder.key");
    fiatlux_access::RecorderKey::generate().unwrap().write(&key).unwrap();
    let key = key.display().to_string();
    let recorder = ["--out", &bags, "--recorder-key", &key];
    for (program, args) in [("policy-client", &["list"][..]), ("recorder", &recorder)] {
        let mut running = Running::start(program, &[args, &["-e", &endpoint]].concat(), &folder);
        let (status, text) = running.finish(PATIENCE);
        let log = running.log();
        assert_eq!((status.code(), text.as_str(), log.lines().count()), (Some(1), "", 1), "{log}");
        assert!(log.starts_with(&format!("error: nothing answers at {endpoint} within 5 s")), "{log}");
    }
}

/// Episodes that together take some 500 messages there and back.
const SHORT: [&str; 8] = ["--policy", "random", "--task", "S01", "--seed", "5", "--episodes", "5"];

/// Ten of a hundred.
const LOSS_PER_MILLE: u64 = 100;

fn assert_lost(proxy: &LossyProxy, episodes: &[Played]) {
    let (passed, lost) = proxy.counts();
    let steps: u64 = episodes.iter().map(|episode| episode.steps).sum();
    println!("{passed} messages passed, {lost} lost, {steps} steps");
    assert!(passed >= 2 * steps && lost >= steps / 10, "{passed} passed, {lost} lost, {steps} steps");
}

/// Guards the one rule of recovery: whatever is lost between client and server, the rows are the same.
#[test]
fn a_link_loses_a_tenth_of_the_clients_messages() {
    let service = Service::start("lossy-client", &[]);
    let port = free_port();
    let proxy = LossyProxy::start(service.port, port, LOSS_PER_MILLE);
    let episodes = played(&mut client(port, &SHORT, &service.folder));
    assert_eq!(episodes, alone(&SHORT));
    assert_lost(&proxy, &episodes);
}

/// Guards that truths and acknowledgements that are lost are asked for again: all bags are whole.
#[test]
fn a_link_loses_a_tenth_of_the_recorders_messages_too() {
    let service = Service::start("lossy-recorder", &[]);
    let port = free_port();
    let proxy = LossyProxy::start(service.port, port, LOSS_PER_MILLE);
    let mut recorder = record(port, &service.folder);
    let episodes = played(&mut client(port, &[&SHORT[..], &["--recorded"]].concat(), &service.folder));
    assert_eq!(episodes, alone(&SHORT));
    for episode in &episodes {
        recorder.wait_for(&format!("{} after {} steps", episode.cause, episode.steps));
    }
    assert_lost(&proxy, &episodes);
    recorder.signal("TERM");
    assert!(recorder.finish(PATIENCE).0.success(), "no bag is cut");
    let (code, results) = grade(&service.bags(), &service.folder);
    let graded = results["episodes"].as_array().unwrap();
    assert_eq!((code, graded.len()), (0, episodes.len()));
    assert!(graded.iter().zip(&episodes).all(|(graded, episode)| graded["state_digest"] == episode.digest));
}
