//! The registry: every file is in it, and what a sensor says of itself is what it does.

use std::collections::BTreeSet;
use std::path::Path;

use fiatlux_proto::ObservationLayout;
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::Robot;
use fiatlux_rules::Task;
use fiatlux_sensing::{Cost, NoiseSeed, Sensor, Sensors, Term, camera_messages, term_messages};

use crate::common::{Rig, start_row};

fn all() -> Sensors {
    Sensors::of(&Sensor::ALL)
}

#[test]
fn sensors_are_named_as_their_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/sensors");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        path.file_stem().unwrap().to_str().unwrap().to_owned()
    });
    let names = Sensor::ALL.map(|sensor| sensor.name().to_owned());
    assert_eq!(files.collect::<BTreeSet<_>>(), names.iter().cloned().collect());
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len(), "two sensors of one name");
}

#[test]
fn costs_follow_from_needs() {
    let cost = |sensors: Sensors| sensors.iter().map(Sensor::cost).collect::<Vec<_>>();
    assert_eq!(cost(Sensors::of_body(Task::Climb)), [Cost::Body; 3]);
    assert_eq!(Sensor::Lidar.cost(), Cost::Scan);
    assert_eq!(Sensor::Camera.cost(), Cost::Image);
    assert_eq!(cost(Sensors::WITH_FEATURES), [Cost::Network; 2]);
    assert!(all().iter().all(|sensor| !sensor.is_large() || sensor.cost() > Cost::Body));
}

/// Computed, encoded and described are the same numbers, within their range; and a client that knows the description
/// alone takes the message, and refuses one number more or less.
#[test]
fn terms_describe_what_is_computed_and_sent() {
    for task in [Task::S03, Task::S11, Task::Climb] {
        let (scene, row) = start_row(task);
        let mut rig = Rig::new(&scene, &row, task, all(), None);
        let info = SessionInfo { terms: term_messages(all(), &rig.setup), ..SessionInfo::default() };
        let layout = ObservationLayout::new(&info).unwrap();
        for sensor in Sensor::ALL {
            let computed = rig.compute(sensor, &row);
            let sent = rig.observe(Sensors::of(&[sensor]), &row);
            layout.check(&sent).unwrap();
            let mut at = 0;
            for (term, told) in sensor.terms(&rig.setup).iter().zip(info.terms_of(sensor.name())) {
                let own = &computed[at..at + term.length()];
                at += term.length();
                assert_eq!((told.length(), told.offset as usize), (term.length(), term.offset), "{task} {}", term.name);
                let bound = |number: f32, [low, high]: [f64; 2]| {
                    let number = f64::from(number) / term.scale;
                    number >= low - 1e-6 && number <= high + 1e-6
                };
                assert!(own.iter().all(|number| bound(*number, term.range)), "{task} {}", term.name);
                let field = sent.numbers(term.field);
                // A single zero is not sent.
                if !field.is_empty() || !term.shape.is_empty() {
                    let part = &field[term.offset..term.offset + term.length()];
                    assert!(own.iter().zip(part).all(|(own, sent)| *own == *sent as f32), "{task} {}", term.name);
                }
            }
            assert_eq!(at, computed.len(), "{task} {}", sensor.name());
        }
        let mut wrong = rig.observe(all(), &row);
        wrong.lidar.pop();
        assert_eq!(layout.check(&wrong).unwrap_err().to_string(), "lidar has 5759 numbers, not 5760");
        let mut wrong = rig.observe(all(), &row);
        wrong.camera.as_mut().unwrap().width = 16;
        assert_eq!(layout.check(&wrong).unwrap_err().to_string(), "camera is 16 x 32, not 64 x 32 pixels");
        let body = SessionInfo { terms: term_messages(Sensors::of_body(task), &rig.setup), ..SessionInfo::default() };
        let error = ObservationLayout::new(&body).unwrap().check(&rig.observe(all(), &row)).unwrap_err();
        assert!(error.to_string().contains("is not a term of the session"), "{error}");
    }
}

/// The noise of every sensor stays within what its terms say, reaches it about, and is the same when a row is asked for
/// again.
#[test]
fn noise_is_what_terms_say() {
    let (scene, mut row) = start_row(Task::S03);
    let sensors = all().without(Sensors::WITH_IMAGE);
    let seed = Some(NoiseSeed { seed: 3, episode: 1 });
    let [mut noisy, mut exact] = [seed, None].map(|seed| Rig::new(&scene, &row, Task::S03, sensors, seed));
    for sensor in sensors.iter() {
        let terms = sensor.terms(&noisy.setup);
        let mut most = vec![0.0_f64; terms.len()];
        for step in 0..50 {
            row.step = step;
            let [numbers, again] = [(); 2].map(|()| noisy.compute(sensor, &row));
            assert_eq!(numbers, again, "{}", sensor.name());
            let differences = numbers.iter().zip(exact.compute(sensor, &row)).map(|(a, b)| f64::from((a - b).abs()));
            let lengths = terms.iter().enumerate().flat_map(|(index, term)| std::iter::repeat_n(index, term.length()));
            lengths.zip(differences).for_each(|(index, difference)| most[index] = most[index].max(difference));
        }
        for (term, most) in terms.iter().zip(most) {
            let half_width = term.noise * term.scale;
            assert!((0.8 * half_width..=half_width * 1.001).contains(&most), "{}: {most}, not {half_width}", term.name);
        }
    }
}

/// Sizes come from the robot: with other joints and hands the terms follow.
#[test]
fn terms_are_sized_by_the_robot() {
    let (scene, row) = start_row(Task::S03);
    let mut setup = Rig::new(&scene, &row, Task::S03, Sensors::NONE, None).setup;
    setup.layout.joints = 29;
    setup.layout.hand_bodies_per_side = 5;
    let published = 6543 - 3 * 24 - 2 * 3 * 12;
    assert_eq!(Sensor::Flat.terms(&setup).iter().map(Term::length).sum::<usize>(), published);
}

/// The G1's cameras are described with their mounts.
#[test]
fn cameras_are_described() {
    let robot = Robot::benchmark().unwrap();
    let cameras = camera_messages(Sensors::of(&[Sensor::Camera, Sensor::Lidar]), &robot, [640, 480]);
    assert_eq!(cameras.len(), 1);
    assert_eq!((cameras[0].sensor.as_str(), cameras[0].link.as_str()), ("camera", "d435_link"));
    assert!((cameras[0].horizontal_fov.to_degrees() - 69.4).abs() < 0.05);
    // A lens of 15.13 mm before a sensor of 20.955 mm, and square pixels.
    let [fx, fy] = [cameras[0].fx, cameras[0].fy];
    assert!((fx - 640.0 * 15.13 / 20.955).abs() < 1e-9 && fx == fy, "{fx}, {fy}");
    assert_eq!([cameras[0].cx, cameras[0].cy], [320.0, 240.0]);
    let sensors = Sensors::of(&[Sensor::LeftWristCamera, Sensor::RightWristCamera]);
    for name in Robot::NAMES {
        let robot = Robot::by_name(name).unwrap();
        assert_eq!(camera_messages(sensors, &robot, [64, 64]).len(), 2, "{name}");
    }
}
