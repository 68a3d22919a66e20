//! Names that a request may have: robots, sets of gains and sensors. The simulator holds what they name; this list is for those that do
//! not link it. A build fails where a sensor is missing here, and `shared_checks_know_the_simulators_names` in `crates/server` where a
//! robot or a set of gains is.

/// Names of the robots and of their hands, each of which names the robot too. The first is the benchmark's.
pub const ROBOTS: &[(&str, &str)] = &include!("../../robot/robots/names.in");

/// Sets of gains, the benchmark's first.
pub const GAINS: [&str; 4] = ["fiatlux", "sonic", "gear", "gear-lerobot"];

/// A sensor by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KnownSensor {
    pub name: &'static str,
    /// A bag has it only where the session asks for it.
    pub is_large: bool,
}

const fn large(name: &'static str) -> KnownSensor {
    KnownSensor { name, is_large: true }
}

const fn small(name: &'static str) -> KnownSensor {
    KnownSensor { name, is_large: false }
}

/// Sensors, in the order in which sessions list them.
pub const SENSORS: [KnownSensor; 18] = [
    small("proprioception"),
    small("hand_contact"),
    small("limb_contact"),
    small("last_action"),
    large("lidar"),
    large("camera"),
    large("features"),
    large("flat"),
    small("privileged"),
    small("verdict"),
    large("chest_camera"),
    large("chest_depth"),
    large("chest_segmentation"),
    large("depth"),
    small("goal"),
    large("left_wrist_camera"),
    large("right_wrist_camera"),
    large("segmentation"),
];

/// The robot of that name, or with hands of that name; the benchmark's where none is given.
pub fn known_robot(name: &str) -> Option<&'static str> {
    if name.is_empty() {
        return Some(ROBOTS[0].0);
    }
    ROBOTS.iter().find(|(robot, hand)| [*robot, *hand].contains(&name)).map(|(robot, _)| *robot)
}

/// The set of gains of that name; the benchmark's where none is given.
pub fn known_gains(name: &str) -> Option<&'static str> {
    if name.is_empty() { Some(GAINS[0]) } else { GAINS.into_iter().find(|known| *known == name) }
}

/// The sensor of that name.
pub fn known_sensor(name: &str) -> Option<KnownSensor> {
    SENSORS.into_iter().find(|sensor| sensor.name == name)
}
