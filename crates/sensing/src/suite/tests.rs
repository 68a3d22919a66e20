#![allow(clippy::unwrap_used)]

use fiatlux_features::Weights;
use fiatlux_proto::Message;
use fiatlux_proto::foxglove::packed_element_field::NumericType;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Protocol, Task};
use fiatlux_world::{Episode, EpisodeSpec, SceneConfig};
use nalgebra::Vector3;

use super::*;
use crate::{LIDAR_RANGE, LIDAR_RAYS};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;
const HAND_BODIES: usize = 34;

fn episode(task: Task) -> Episode {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let spec = EpisodeSpec::new(task, 3, 1);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap());
    Episode::start(scene, &spec).unwrap()
}

fn suite(episode: &Episode, sensors: Sensors) -> SensorSuite {
    // A small picture: the network is slow.
    let network = sensors.meets(Sensors::WITH_FEATURES).then(|| ResNet18::new(&Weights::seeded(0)));
    let setup = Setup { image_size: [64, 32], ..Setup::new(episode.scene(), episode.spec().task) };
    let mut suite = SensorSuite::new(sensors, setup).with_network(network);
    let visuals = || Arc::new(Visuals::new(episode.scene()));
    suite.begin(episode.scene(), NoiseSeed::of(episode.spec()), visuals, Lighting::default()).unwrap();
    suite
}

fn all() -> Sensors {
    Sensors::of(&Sensor::ALL)
}

/// The lengths that `observation.proto` gives, and nothing that was not asked for.
#[test]
fn each_sensor_fills_its_own_field() {
    for task in [Task::S11, Task::Climb] {
        let episode = episode(task);
        let mut suite = suite(&episode, all());
        let climb = task == Task::Climb;
        let setup = Setup::new(episode.scene(), task);
        for sensor in Sensor::ALL {
            let seen = suite.observe(&View::of(&episode), Sensors::of(&[sensor])).unwrap();
            let count = |field: &str| seen.numbers(field).len();
            let privileged = Sensor::Privileged.terms(&setup).iter().map(|term| count(term.field)).sum();
            let [found, expected] = match sensor {
                Sensor::Proprioception => [count("proprioception.joint_velocity"), JOINTS],
                Sensor::HandContact => [count("hand_contact_force"), 3 * HAND_BODIES],
                Sensor::LimbContact => [count("limb_contact_force"), 12],
                Sensor::LastAction => [count("last_action"), JOINTS],
                Sensor::Lidar => [count("lidar"), LIDAR_RAYS],
                Sensor::Camera => [count("camera.rgb"), 3 * 64 * 32],
                Sensor::Features => [count("features.values"), 512],
                Sensor::Flat => [count("flat.values"), if climb { 6453 } else { 6543 }],
                Sensor::Privileged => [privileged, if climb { 17 } else { 48 }],
                Sensor::Verdict => [count("verdict.criteria"), task.spec().gate.n(Protocol::Strict) as usize],
                // The next sensor's own test says what it fills.
                #[allow(unreachable_patterns)]
                _ => continue,
            };
            assert_eq!(found, expected, "{task} {}", sensor.name());
            let rest = suite.observe(&View::of(&episode), all().without(Sensors::of(&[sensor]))).unwrap();
            let both = merge(rest, seen);
            assert_eq!(both, suite.observe(&View::of(&episode), all()).unwrap(), "{task} {}", sensor.name());
        }
    }
}

/// All fields of both: protobuf adds encoded messages up.
fn merge(mut one: Observation, other: Observation) -> Observation {
    one.merge(other.encode_to_vec().as_slice()).unwrap();
    one
}

/// The flat vector has each term where the table says, scaled, and equal to the raw sensors.
#[test]
fn flat_is_the_raw_sensors_in_order() {
    let episode = episode(Task::S11);
    let mut suite = suite(&episode, all());
    let seen = suite.observe(&View::of(&episode), all()).unwrap();
    let flat = seen.flat.as_ref().unwrap();
    let terms = Sensor::Flat.terms(&Setup::new(episode.scene(), Task::S11));
    let part = |name: &str| {
        let term = terms.iter().find(|term| term.name == name).unwrap();
        let numbers = flat.values[term.offset..term.offset + term.length()].iter();
        numbers.map(|number| f64::from(*number) / term.scale).collect::<Vec<_>>()
    };
    let same = |name: &str, raw: &[f32]| {
        let part = part(name);
        assert_eq!(part.len(), raw.len(), "{name}");
        for (flat, raw) in part.iter().zip(raw) {
            assert!((flat - f64::from(*raw)).abs() <= 1e-6 * flat.abs().max(1.0), "{name}: {flat} and {raw}");
        }
    };
    let own = seen.proprioception.as_ref().unwrap();
    same("joint_position", &own.joint_position);
    same("base_angular_velocity", &own.base_angular_velocity);
    same("lidar", &seen.lidar);
    same("camera_features", &seen.features.as_ref().unwrap().values);
    same("last_action", &seen.last_action);
    same("right_hand_contact", &seen.hand_contact_force[..51]);
    same("left_hand_contact", &seen.hand_contact_force[51..]);
    // The bulb is held, so the right hand feels something.
    assert!(seen.hand_contact_force[..51].iter().any(|force| force.abs() > 1.0));
    assert_eq!(flat.weights, seen.features.unwrap().weights);
}

/// Other sensors change nothing: neither the noise of the body's own sensors nor the rows.
#[test]
fn sensors_do_not_touch_each_other() {
    let body = Sensors::of_body(Task::S07);
    let run = |sensors: Sensors| {
        let mut episode = episode(Task::S07);
        let mut suite = suite(&episode, sensors);
        let mut seen = Vec::new();
        for _ in 0..5 {
            suite.observe(&View::of(&episode), sensors).unwrap();
            // Twice: a second look draws no noise.
            seen.push(suite.observe(&View::of(&episode), body).unwrap());
            episode.step(&[0.1; JOINTS]).unwrap();
        }
        (seen, episode.digest().hex())
    };
    assert_eq!(run(body), run(all()));
}

#[test]
fn a_new_row_is_sensed_afresh() {
    let mut episode = episode(Task::S02);
    let mut suite = suite(&episode, all());
    let first = suite.observe(&View::of(&episode), all()).unwrap();
    for _ in 0..20 {
        episode.step(&[0.5; JOINTS]).unwrap();
    }
    let later = suite.observe(&View::of(&episode), all()).unwrap();
    assert_ne!(first.lidar, later.lidar);
    assert_ne!(first.camera, later.camera);
    assert_ne!(first.features, later.features);
    assert_ne!(first.flat, later.flat);
}

#[test]
fn what_the_suite_was_not_made_for_is_an_error() {
    let episode = episode(Task::S07);
    let mut suite = suite(&episode, Sensors::of_body(Task::S07));
    for sensor in Sensors::LARGE.iter() {
        let error = suite.observe(&View::of(&episode), Sensors::of(&[sensor])).unwrap_err();
        assert!(matches!(error, SenseError::Absent(_)), "{error}");
    }
}

/// A viewer gets the image as PNG and the hits of the scan as points at their ranges.
#[test]
fn viewers_get_the_same() {
    let episode = episode(Task::S02);
    let mut suite = suite(&episode, all());
    let seen = suite.observe(&View::of(&episode), all()).unwrap();
    let image = suite.compressed_image(Sensor::Camera, &View::of(&episode)).unwrap();
    assert_eq!((image.format.as_str(), image.frame_id.as_str()), ("png", "d435_link"));
    let mut reader = png::Decoder::new(std::io::Cursor::new(&image.data)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    assert_eq!(pixels, seen.camera.unwrap().rgb);

    let cloud = suite.point_cloud(&View::of(&episode)).unwrap();
    assert_eq!((cloud.frame_id.as_str(), cloud.point_stride), ("mid360_link", 12));
    assert!(cloud.fields.iter().all(|field| field.r#type() == NumericType::Float32));
    let points = cloud.data.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
    let hits: Vec<f32> = seen.lidar.into_iter().filter(|range| *range < LIDAR_RANGE as f32).collect();
    assert!(hits.len() > 1000);
    assert_eq!(points.len(), 3 * hits.len());
    for (point, range) in points.as_chunks::<3>().0.iter().zip(hits) {
        assert!((Vector3::from(*point).norm() - range).abs() < 1e-5);
    }
}
