//! Runs that differ are told apart.

use fiatlux_proto::v3;
use fiatlux_rules::{BENCHMARK_VERSION, Thresholds, pins};

use super::*;

fn new(header: v3::EpisodeHeader) -> Conditions {
    Conditions::new(&header, &Thresholds::default(), &[], false)
}

fn pinned() -> v3::EpisodeHeader {
    v3::EpisodeHeader {
        request: Some(v3::OpenRequest::default()),
        benchmark_version: BENCHMARK_VERSION,
        episode_protocol: "strict".into(),
        model_digest: pins::model(ROBOT).unwrap_or_default().into(),
        scene_digest: pins::SCENE.into(),
        ..v3::EpisodeHeader::default()
    }
}

fn words(conditions: &Conditions) -> [&str; 4] {
    [&conditions.protocol, &conditions.seeds, &conditions.observations, &conditions.time].map(String::as_str)
}

/// Guards that `evaluate --tasks all,climb` gives one table, and that a session which names its sensors is no part of it.
#[test]
fn sensors_that_are_left_to_the_task_are_no_difference() {
    let with = |task: &str, sensors: &[&str], named: &[&str]| v3::EpisodeHeader {
        task: task.into(),
        sensors: sensors.iter().map(|name| (*name).into()).collect(),
        request: Some(v3::OpenRequest {
            sensors: named.iter().map(|name| (*name).into()).collect(),
            ..v3::OpenRequest::default()
        }),
        ..pinned()
    };
    let carry = with("S05", &["proprioception", "hand_contact"], &[]);
    let sensors = |header: &v3::EpisodeHeader| new(header.clone()).sensors;
    assert_eq!(sensors(&carry), [OWN]);
    for (task, contacts) in [("climb", &["limb_contact"][..]), ("S02", &["hand_contact", "limb_contact"])] {
        let other = with(task, &[&["proprioception"], contacts].concat(), &[]);
        assert_eq!(compared(&other), compared(&carry), "{task}");
        let named = with(task, &[&["proprioception"], contacts].concat(), &[&["proprioception"], contacts].concat());
        assert_ne!(compared(&named), compared(&carry), "{task}");
    }
    let mut recorded = carry.clone();
    let camera = v3::Sensor { bag_only: true, recorded: true, ..v3::Sensor::from("camera") };
    recorded.sensors.push(camera.clone());
    recorded.request.get_or_insert_default().sensors.push(camera);
    assert_eq!(compared(&recorded), compared(&carry));
    // A header that does not say what it has is not believed.
    let seen = with("S05", &["proprioception", "privileged"], &[]);
    assert_eq!(sensors(&seen), ["proprioception@0", "privileged@0"]);
}

/// Guards that objects from files are the only thing that may differ from the pinned scene, and that they are told apart.
#[test]
fn objects_from_files_are_named_in_a_pinned_scene() {
    let with = |place: &str, digest: String| v3::EpisodeHeader {
        scene_digest: "1".into(),
        scene_config: "[assets]".into(),
        base_scene_digest: pins::SCENE.into(),
        assets: vec![v3::Asset { place: place.into(), name: "box".into(), digest }],
        ..pinned()
    };
    let conditions = new(with("crate", "ab".repeat(32)));
    let named = format!("crate {}", "ab".repeat(32));
    assert_eq!(conditions.deviations, [format!("{OBJECTS}{named}")]);
    assert_eq!((conditions.ranked, conditions.assets), (false, vec![named]));
    assert_ne!(compared(&with("crate", "ab".repeat(32))), compared(&with("crate", "cd".repeat(32))));
    let elsewhere = v3::EpisodeHeader { base_scene_digest: "2".into(), ..with("crate", "ab".repeat(32)) };
    assert!(new(elsewhere).deviations[0].contains("without its objects is not the pinned one"));
    for (place, digest) in [("<b>", "ab".repeat(32)), ("crate", "AB".repeat(32)), ("crate", String::new())] {
        assert!(new(with(place, digest)).deviations[0].contains("malformed"), "{place}");
    }
    // An object cannot hide a changed scene.
    let none = v3::EpisodeHeader { assets: Vec::new(), ..with("crate", String::new()) };
    assert_eq!(new(none).deviations, ["the scene is not the pinned one"]);
}

/// Guards that randomization, sizes of props and sensors are conditions, and that fields of a single bag are not.
#[test]
fn sessions_that_differ_are_told_apart() {
    let header = || v3::EpisodeHeader { sensors: vec!["proprioception".into()], ..pinned() };
    let usual = new(header());
    assert!(usual.ranked, "{:?}", usual.deviations);
    assert_eq!(words(&usual), ["strict", "public", "standard", "lockstep"]);
    let random = |random: v3::Randomization| v3::EpisodeHeader { randomization: Some(random), ..header() };
    let default = v3::Randomization::default();
    let sized = v3::PropScale { ladder_z: 1.05, ..v3::PropScale::default() };
    let request = v3::OpenRequest { prop_scale: Some(sized), ..v3::OpenRequest::default() };
    let delayed = v3::OpenRequest { action_delay_ms: 40, ..v3::OpenRequest::default() };
    let range = |name: &str, least, most| (name.to_owned(), v3::Range { least, most });
    let ranges = [range("noise", 0.5, 2.0), range("gravity", 9.6, 10.0)].into();
    let ranging = v3::OpenRequest { ranges, ..v3::OpenRequest::default() };
    let sensing = |sensor: v3::Sensor| v3::EpisodeHeader { sensors: vec![sensor], ..header() };
    let seeded = v3::EpisodeHeader { weights: "fiatlux-resnet18-seeded/1:0".into(), ..sensing("flat".into()) };
    let cases = [
        (random(v3::Randomization { fixed_start: true, ..default }), "start is fixed", "standard"),
        (random(v3::Randomization { fixed_layout: true, ..default }), "layout is fixed", "standard"),
        (random(v3::Randomization { exact_sensors: true, ..default }), "sensors are exact", "other"),
        (random(v3::Randomization { prop_scale: true, ..default }), "sizes of props are random", "standard"),
        (v3::EpisodeHeader { request: Some(request), ..header() }, "sizes of props are ladder_z 1.05", "standard"),
        (v3::EpisodeHeader { request: Some(delayed), ..header() }, "actions are delayed by 40 ms", "standard"),
        (
            v3::EpisodeHeader { request: Some(ranging), ..header() },
            "each episode draws gravity from 9.6 to 10, noise from 0.5 to 2",
            "standard",
        ),
        (
            v3::EpisodeHeader { scene_config: "[bench]".into(), ..header() },
            "the scene is not the pinned one",
            "standard",
        ),
        (v3::EpisodeHeader { scene_digest: "1".into(), ..header() }, "the scene is not the pinned one", "standard"),
        (v3::EpisodeHeader { model_digest: "1".into(), ..header() }, "the robot is not the pinned one", "standard"),
        (seeded, "the camera's features are those of an untrained network, 'fiatlux-resnet18-seeded/1:0'", "other"),
        (
            v3::EpisodeHeader { benchmark_version: 7, ..header() },
            &format!("the rules are those of benchmark version {BENCHMARK_VERSION}, the episodes of 7"),
            "standard",
        ),
    ];
    for (other, deviation, observations) in cases {
        let conditions = new(other);
        assert!(!conditions.ranked && conditions.deviations == [deviation], "{:?}", conditions.deviations);
        assert_eq!(conditions.observations, observations, "{deviation}");
    }
    // The four words are not deviations: they separate rankings.
    for (header, expected) in [
        (sensing("verdict".into()), ["strict", "public", "privileged", "lockstep"]),
        (sensing("privileged".into()), ["strict", "public", "privileged", "lockstep"]),
        (
            v3::EpisodeHeader { mode: v3::Mode::RealTime.into(), ..header() },
            ["strict", "public", "standard", "real time"],
        ),
        (
            v3::EpisodeHeader { run: Some(v3::RunTicket { hosted: true, ..v3::RunTicket::default() }), ..header() },
            ["strict", "hosted", "standard", "lockstep"],
        ),
    ] {
        let conditions = new(header);
        assert!(conditions.ranked, "{:?}", conditions.deviations);
        assert_eq!(words(&conditions), expected);
    }
    let camera = |width| v3::EpisodeHeader { image_width: width, image_height: 256, ..sensing("camera".into()) };
    assert_ne!(compared(&camera(256)), compared(&camera(512)), "the image's size");
    assert!(new(camera(512)).ranked);
    let lidar = |rate_hz| sensing(v3::Sensor { rate_hz, ..v3::Sensor::from("lidar") });
    assert_ne!(compared(&lidar(10.0)), compared(&lidar(50.0)), "the rate");
    let in_bag = v3::Sensor { bag_only: true, recorded: true, ..v3::Sensor::from("camera") };
    let mut recorded = header();
    recorded.sensors.push(in_bag);
    assert_eq!(compared(&recorded), compared(&header()), "fields of a single bag");
    let delayed = |action_delay_ms| v3::EpisodeHeader {
        request: Some(v3::OpenRequest { action_delay_ms, ..v3::OpenRequest::default() }),
        ..header()
    };
    assert_ne!(compared(&delayed(20)), compared(&delayed(40)), "the delay");
    assert_eq!(compared(&delayed(0)), compared(&header()));
}

/// Guards that what cannot be compared is not ranked, and that what a person did is not.
#[test]
fn bags_without_a_request_and_of_persons_are_not_ranked() {
    let header = || v3::EpisodeHeader { sensors: vec!["proprioception".into()], ..pinned() };
    assert!(new(header()).ranked);
    assert!(new(v3::EpisodeHeader { request: None, ..header() }).deviations[0].contains("no request"));
    let take = v3::OpenRequest { take: true, ..v3::OpenRequest::default() };
    let persons = [
        v3::EpisodeHeader { request: Some(take), ..header() },
        v3::EpisodeHeader { policy: "sonic:models,stream=tcp://192.0.2.1:5555".into(), ..header() },
    ];
    for header in persons {
        assert_ne!(compared(&header), compared(&pinned()));
        let conditions = new(header);
        assert!(conditions.source == "person" && !conditions.ranked, "{:?}", conditions.deviations);
    }
}

/// Guards that other meshes are other conditions only for a policy that sees pictures of them.
#[test]
fn meshes_count_where_they_are_seen() {
    let header = |sensor: &str, meshes: &str| v3::EpisodeHeader {
        sensors: vec!["proprioception".into(), sensor.into()],
        meshes: meshes.into(),
        weights: "safetensors:1".into(),
        ..pinned()
    };
    for sensor in ["camera", "features", "flat"] {
        assert_ne!(compared(&header(sensor, "meshes:1")), compared(&header(sensor, "meshes:2")), "{sensor}");
        assert_ne!(compared(&header(sensor, "meshes:1")), compared(&header(sensor, "")), "{sensor}");
        let conditions = new(header(sensor, "meshes:1"));
        assert_eq!(conditions.deviations, ["the robot is drawn with the user's own meshes"]);
        assert!(!conditions.ranked && conditions.meshes == "meshes:1" && conditions.observations == "other");
        assert!(new(header(sensor, "")).ranked);
    }
    assert_eq!(compared(&header("lidar", "meshes:1")), compared(&header("lidar", "")));
    assert!(new(header("lidar", "meshes:1")).ranked);
}
