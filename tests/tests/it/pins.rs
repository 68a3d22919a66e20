//! The benchmark is what its pins say: robots, scene, rules and sensors have the digests of `fiatlux_rules::pins`.

use std::fmt::Write;

use data_encoding::HEXLOWER;
use fiatlux_robot::Robot;
use fiatlux_rules::{BENCHMARK_VERSION, Protocol, RobotLayout, Task, pins};
use fiatlux_sensing::{Class, Sensor, Setup};
use fiatlux_world::SceneConfig;
use sha2::{Digest, Sha256};

/// SHA-256 over the terms of the benchmark's sensors, for each pinned robot in a task of the room and in `climb`, hexadecimal.
fn sensors_digest() -> String {
    let mut text = String::new();
    for (name, _) in pins::MODELS {
        let robot = Robot::by_name(name).unwrap();
        let layout = RobotLayout { joints: robot.joints().len(), hand_bodies_per_side: robot.hand_links().len() / 2 };
        for task in [Task::S01, Task::Climb] {
            writeln!(text, "{} {task:?}", robot.hand()).unwrap();
            for sensor in
                Sensor::ALL.into_iter().filter(|sensor| !matches!(sensor.class(), Class::Goal | Class::Optional))
            {
                writeln!(text, "{} {:?} {:?}", sensor.name(), sensor.cost(), sensor.camera()).unwrap();
                for term in sensor.terms(&Setup { task, protocol: Protocol::Strict, layout, image_size: [256; 2] }) {
                    let (name, field, unit) = (term.name, term.field, term.unit);
                    write!(text, "{name} {field} {} {:?} {unit} ", term.offset, term.shape).unwrap();
                    writeln!(text, "{:?} {:?} {:?}", term.range, term.scale, term.noise).unwrap();
                }
            }
        }
    }
    HEXLOWER.encode(&Sha256::digest(text))
}

/// Guards that a scorer, which has no sensors, ranks a run with a sensor by the class in the sensor's file.
#[test]
fn pins_name_the_sensors_of_the_benchmark() {
    for sensor in Sensor::ALL {
        let observations = match sensor.class() {
            Class::Standard => "standard",
            Class::Privileged => "privileged",
            Class::Goal => "goal",
            Class::Optional => "other",
        };
        let name = sensor.name();
        assert_eq!(pins::observations_with(name), observations, "{name}: see crates/rules/src/pins.rs");
    }
}

#[test]
fn the_benchmark_is_the_pinned_one() {
    let scene = SceneConfig::default().digest();
    let mut found = vec![
        ("SCENE".to_owned(), scene, pins::SCENE),
        ("RULES".to_owned(), pins::rules_digest(), pins::RULES),
        ("SENSORS".to_owned(), sensors_digest(), pins::SENSORS),
    ];
    for (name, pinned) in pins::MODELS {
        found.push((format!("MODELS, {name}"), Robot::by_name(name).unwrap().digest().to_owned(), pinned));
    }
    let changed: Vec<_> = found.iter().filter(|(_, found, pinned)| found != pinned).collect();
    assert!(
        changed.is_empty(),
        "the benchmark is no longer that of version {BENCHMARK_VERSION}, and scores of it would not compare with those \
         before. If that is meant, raise BENCHMARK_VERSION in crates/rules/src/lib.rs, once a release, and ENGINE_VERSION with it \
         unless the rules alone changed; then set in crates/rules/src/pins.rs (constant, digest found, digest pinned): {changed:#?}"
    );
}

/// Guards against a division of a robot that nobody can play.
#[test]
fn ranked_robots_are_known_and_pinned() {
    assert_eq!(pins::RANKED_ROBOTS[0], Robot::NAMES[0]);
    for name in pins::RANKED_ROBOTS {
        assert!(Robot::known(name).is_ok() && pins::model(name).is_some(), "{name}");
    }
}
