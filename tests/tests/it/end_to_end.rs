//! The programs together, as processes that talk over TCP: what was played is what was recorded, graded, simulated again.

mod evaluate;
mod verify;

use fiatlux_bag::{Bag, Completeness};
use fiatlux_tests::programs::{PATIENCE, Running, Service, Watch, alone, endpoint, grade, played};

/// The way of an episode through all programs: the bag that the recorder wrote is graded as the client saw it end, and the
/// server simulates it again to the last bit, for the scorer and for the client.
fn goes_all_the_way(name: &str, args: &[&str]) -> Service {
    let mut service = Service::start(name, &[]);
    let mut recorder = service.record();
    let episode = service.play(&[args, &["--recorded"]].concat()).remove(0);
    let line = recorder.wait_for(".mcap");
    let expected = format!("{} after {} steps", episode.cause, episode.steps);
    assert!(line.contains(&expected), "{line}");

    let bags = service.folder.files(".mcap");
    let [bag] = &bags[..] else { panic!("one bag: {bags:?}") };
    let (code, results) = grade(bag, &service.folder);
    let graded = &results["episodes"][0];
    assert_eq!((code, results["excluded"].as_array().unwrap().len()), (0, 0), "{results:#}");
    assert_eq!(graded["state_digest"], episode.digest);
    assert_eq!((graded["steps"].as_u64(), graded["end"].as_str()), (Some(episode.steps), Some(episode.cause.as_str())));

    let bag = bag.display().to_string();
    let mut scorer = Running::start("scorer", &["verify", &bag, "-e", &endpoint(service.port)], &service.folder);
    let (status, text) = scorer.finish(PATIENCE);
    assert!(status.success() && text.starts_with("equal: ") && text.contains(&episode.digest), "{text}");
    let again = service.play(&["--policy", &format!("replay:{bag}")]).remove(0);
    assert_eq!((again.is_equal, again.digest), (Some(true), episode.digest));

    recorder.signal("TERM");
    assert!(recorder.finish(PATIENCE).0.success(), "no bag is cut");
    service.server.signal("TERM");
    assert!(service.server.finish(PATIENCE).0.success());
    service
}

/// Guards the whole way for actions in action units.
#[test]
fn actions_go_all_the_way() {
    goes_all_the_way("actions", &["--policy", "random", "--task", "S01", "--seed", "3"]);
}

/// Guards the whole way for joint targets, whose record is made of what the client sent and not of its rounded form; and
/// that thresholds of the run's own, and ranges, reach the second run.
#[test]
fn joint_targets_go_all_the_way() {
    let ranges = "gravity=9.0..9.6,noise=0.5..2,action_delay=20..60,floor_friction=0.5..0.7";
    let args = ["--policy", "stand", "--task", "S05", "--set", "fall_tilt_rad=0.05", "--range", ranges];
    let service = goes_all_the_way("targets", &args);
    let header = Bag::open(&service.folder.files(".mcap")[0]).unwrap().header().clone();
    assert_eq!(header.domain_sample.unwrap().varied.len(), 4);
}

/// Guards the whole way for a robot of another size: the hands that were asked for are in the bag, and all that reads it
/// takes its sizes from there.
#[test]
fn welded_fingers_go_all_the_way() {
    let args = ["--policy", "stand", "--task", "S01", "--seed", "2", "--robot", "g1_bare"];
    let service = goes_all_the_way("bare", &[&args[..], &["--set", "fall_tilt_rad=0.05"]].concat());
    let bag = Bag::open(&service.folder.files(".mcap")[0]).unwrap();
    let header = bag.header();
    assert_eq!((header.robot.as_str(), header.joint_names.len(), header.hand_bodies.len()), ("g1_bare", 29, 10));
}

/// Guards the whole way with every sensor and with props of other sizes: the bag has each large sensor as often as was
/// asked, its weights are named, and the second run finds the same rows without the sensors.
#[test]
fn sensors_go_all_the_way() {
    let args = ["--policy", "zero", "--task", "S01", "--seed", "2", "--prop-scale", "random", "--image", "64x64"];
    let sensors = "proprioception,last_action,lidar@25,camera@10,features@2,flat@look,privileged,verdict";
    let record = ["--sensors", sensors, "--record", "camera@25,lidar,features@5"];
    let service = goes_all_the_way("sensors", &[&args[..], &record].concat());
    let bag = Bag::open(&service.folder.files(".mcap")[0]).unwrap();
    let rows = bag.states().count();
    let every = |steps: usize| rows.div_ceil(steps);
    assert!(rows > 30, "{rows}");
    assert_eq!((bag.images().count(), bag.point_clouds().count()), (every(2), every(5)));
    let observations: Vec<_> = bag.observations().map(Result::unwrap).collect();
    assert_eq!(observations.len(), rows);
    for seen in &observations {
        assert!(seen.camera.is_none() && seen.lidar.is_empty() && seen.flat.is_none(), "{}", seen.step);
        assert_eq!(seen.features.is_some(), seen.step % 10 == 0, "{}", seen.step);
        assert!(seen.privileged.is_some() && seen.verdict.is_some() && seen.proprioception.is_some());
    }
    let header = bag.header();
    let label = &observations[0].features.as_ref().unwrap().weights;
    assert!(header.weights.starts_with("fiatlux-resnet18-seeded/") && header.weights == *label, "{label}");
    let scale = header.domain_sample.as_ref().and_then(|sample| sample.prop_scale).unwrap();
    assert!(scale.ladder_z != 1.0 && scale.socket != 1.0, "{scale:?}");
}

/// Guards that sessions do not share anything that a step reads: each digest is that of the episode alone.
#[test]
fn two_sessions_do_not_disturb_each_other() {
    let long = ["--policy", "zero", "--task", "S08"];
    let short = ["--policy", "random", "--task", "S05", "--seed", "2", "--episodes", "5"];
    let (long_alone, short_alone) = (alone(&long), alone(&short));
    assert_eq!((long_alone[0].steps, short_alone.len()), (6000, 5));
    let service = Service::start("two", &[]);
    let watch = Watch::start(service.port);
    let mut first = service.client(&long);
    watch.wait_for(100);
    let second = service.play(&short);
    assert!(first.is_running(), "both ran at once");
    assert_eq!(second, short_alone);
    assert_eq!(played(&mut first), long_alone);
}

/// Guards the orderly end: a server that is asked to end closes its sessions, and their recorder closes the bags.
#[test]
fn a_server_that_is_asked_to_end_ends_its_episodes() {
    let mut service = Service::start("end", &[]);
    let mut recorder = service.record();
    let watch = Watch::start(service.port);
    let mut client = service.client(&["--policy", "zero", "--task", "S08", "--recorded"]);
    watch.wait_for(300);
    service.server.signal("TERM");
    let (status, _) = service.server.finish(PATIENCE);
    assert!(status.success(), "{status}");
    recorder.wait_for("aborted after ");
    let bags = service.folder.files(".mcap");
    let bag = Bag::open(&bags[0]).unwrap();
    let end = bag.result().and_then(|result| result.end.clone()).unwrap();
    assert_eq!((bags.len(), bag.completeness()), (1, &Completeness::Whole));
    assert_eq!(end.cause, "aborted");
    assert!(end.steps >= 300 && bag.states().count() as u64 == end.steps + 1, "every row is there");
    let (status, _) = client.finish(PATIENCE);
    assert_eq!(status.code(), Some(1));
    assert!(client.log().contains("the server shuts down"), "{}", client.log());
}
