//! What an observation can contain: the list of sensors and their terms, with names, shapes and units as in
//! `observation.proto`.

use fiatlux_proto::Message;
use fiatlux_proto::v3::{Observation, ObservationTerm, Pose, Privileged, Proprioception, SessionInfo};

/// A sensor's part of an observation.
pub struct Sensor {
    /// Name of the sensor in a request.
    pub name: &'static str,
    /// Default rate, Hz: 0 for every step, `None` for on request.
    pub rate_hz: Option<f64>,
    /// Whether it takes the server a while or many bytes, so that its cost is worth a look.
    pub is_large: bool,
    pub terms: &'static [Term],
    /// What its numbers mean, as far as names and units do not say it, line by line.
    pub remarks: fn(&SessionInfo) -> String,
    /// Copies this sensor's field from one observation to another.
    copy: fn(&Observation, &mut Observation),
}

/// A group of numbers in a sensor's field.
pub struct Term {
    pub name: &'static str,
    pub unit: &'static str,
    pub shape: fn(&SessionInfo) -> Vec<usize>,
    read: fn(&Observation) -> Option<Vec<f64>>,
}

impl Sensor {
    /// Finds a sensor by its name.
    pub fn by_name(name: &str) -> Option<&'static Sensor> {
        SENSORS.iter().find(|sensor| sensor.name == name)
    }

    /// Whether an observation contains this sensor.
    pub fn is_in(&self, observation: &Observation) -> bool {
        self.terms.iter().any(|term| term.read(observation).is_some())
    }

    /// Copies this sensor's field to another observation; returns its size in a message, bytes, or 0 if it is missing.
    pub fn keep(&self, from: &Observation, to: &mut Observation) -> usize {
        let mut alone = Observation::default();
        (self.copy)(from, &mut alone);
        let bytes = alone.encoded_len();
        if bytes > 0 {
            (self.copy)(&alone, to);
        }
        bytes
    }
}

impl Term {
    /// The term's numbers; `None` if the observation lacks them.
    pub fn read(&self, observation: &Observation) -> Option<Vec<f64>> {
        (self.read)(observation).filter(|numbers| !numbers.is_empty())
    }
}

const fn term(
    name: &'static str,
    unit: &'static str,
    shape: fn(&SessionInfo) -> Vec<usize>,
    read: fn(&Observation) -> Option<Vec<f64>>,
) -> Term {
    Term { name, unit, shape, read }
}

/// Defines a sensor with a field in the observation.
macro_rules! sensor {
    ($name:literal, $rate_hz:expr, large: $is_large:literal, $field:ident, $remarks:expr, $terms:expr) => {
        Sensor {
            name: $name,
            rate_hz: $rate_hz,
            is_large: $is_large,
            terms: &$terms,
            remarks: $remarks,
            copy: |from, to| to.$field.clone_from(&from.$field),
        }
    };
}

/// The sensors that are shown by default, in the order in which sessions list them: all but chest_camera, which
/// `--sensors` can name.
#[rustfmt::skip] // One line for each term reads like a table.
pub static SENSORS: [Sensor; 10] = [
    sensor!("proprioception", Some(0.0), large: false, proprioception, |_| {
        "proprioception: with noise unless it is fixed; joint_position is relative to q0; vectors in the pelvis frame".into()
    }, [
        term("base_angular_velocity", "rad/s", |_| vec![3], |o| all(&own(o)?.base_angular_velocity)),
        term("projected_gravity", "", |_| vec![3], |o| all(&own(o)?.projected_gravity)),
        term("base_linear_velocity", "m/s", |_| vec![3], |o| all(&own(o)?.base_linear_velocity)),
        term("base_height", "m", |_| vec![1], |o| all(&[own(o)?.base_height])),
        term("joint_position", "rad", joints, |o| all(&own(o)?.joint_position)),
        term("joint_velocity", "rad/s", joints, |o| all(&own(o)?.joint_velocity)),
    ]),
    sensor!("hand_contact", Some(0.0), large: false, hand_contact_force, |_| {
        "hand_contact: force of the bulbs on the right hand's bodies, then the left's, world axes".into()
    }, [
        term("hand_contact_force", "N", |info| vec![info.hand_bodies.len(), 3], |o| all(&o.hand_contact_force)),
    ]),
    sensor!("limb_contact", Some(0.0), large: false, limb_contact_force, |_| {
        "limb_contact: force of the ladder on left foot, right foot, left palm, right palm, world axes".into()
    }, [
        term("limb_contact_force", "N", |_| vec![4, 3], |o| all(&o.limb_contact_force)),
    ]),
    sensor!("last_action", Some(0.0), large: false, last_action, |_| String::new(), [
        term("last_action", "action", joints, |o| all(&o.last_action)),
    ]),
    sensor!("lidar", Some(10.0), large: true, lidar, |_| {
        "lidar: floor and ladder only; 180 row + column, row 0 looks up, column 90 ahead; 10 where nothing is hit".into()
    }, [
        term("lidar", "m", |_| vec![32, 180], |o| all(&o.lidar)),
    ]),
    sensor!("camera", Some(10.0), large: true, camera, |info| {
        let fov = info.cameras.iter().find(|camera| camera.sensor == "camera").map_or(0.0, |camera| camera.horizontal_fov);
        format!("camera: rows from the top, {:.0}° from the left to the right edge", fov.to_degrees())
    }, [
        term("camera.rgb", "0-255", image, |o| all(&o.camera.as_ref()?.rgb)),
    ]),
    sensor!("features", None, large: true, features, |info| {
        format!("features, flat: ResNet-18 with the weights {}", info.weights)
    }, [
        term("features.values", "", |_| vec![512], |o| all(&o.features.as_ref()?.values)),
    ]),
    sensor!("flat", None, large: true, flat, |_| String::new(), [
        term("flat.values", "", flat, |o| all(&o.flat.as_ref()?.values)),
    ]),
    sensor!("privileged", Some(0.0), large: false, privileged, |_| {
        "distances: ladder's top to seat, fresh plug to seat, old plug to seat, old bulb to crate\n\
         seated: old bulb, fresh bulb; poses in the world, of which this table shows position and yaw".into()
    }, [
        term("robot", POSE, |_| vec![7], |o| pose(&exact(o)?.robot)),
        term("ladder", POSE, |_| vec![7], |o| pose(&exact(o)?.ladder)),
        term("socket", POSE, |_| vec![7], |o| pose(&exact(o)?.socket)),
        term("fresh_bulb", POSE, |_| vec![7], |o| pose(&exact(o)?.fresh_bulb)),
        term("old_bulb", POSE, |_| vec![7], |o| pose(&exact(o)?.old_bulb)),
        term("crate", POSE, |_| vec![7], |o| pose(&exact(o)?.crate_)),
        term("distances", "m", |_| vec![4], |o| all(&exact(o)?.distances)),
        term("seated", "bool", |_| vec![2], |o| all(&exact(o)?.seated)),
        term("linear_velocity", "m/s", |_| vec![3], |o| all(&exact(o)?.linear_velocity)),
    ]),
    sensor!("verdict", Some(0.0), large: false, verdict, |_| String::new(), [
        term("criteria", "bool", criteria, |o| all(&o.verdict.as_ref()?.criteria)),
        term("gate_progress", "", |_| vec![1], |o| all(&[o.verdict.as_ref()?.gate_progress])),
        term("reward", "", |_| vec![1], |o| all(&[o.verdict.as_ref()?.reward])),
    ]),
];

/// Units of a pose: position and quaternion.
pub const POSE: &str = "m, wxyz";

fn joints(info: &SessionInfo) -> Vec<usize> {
    vec![info.joints.len()]
}

fn image(info: &SessionInfo) -> Vec<usize> {
    vec![info.image_height as usize, info.image_width as usize, 3]
}

fn flat(info: &SessionInfo) -> Vec<usize> {
    vec![info.terms_of("flat").map(ObservationTerm::length).sum()]
}

fn criteria(info: &SessionInfo) -> Vec<usize> {
    vec![info.task.as_ref().map_or(0, |task| task.criteria.len())]
}

fn own(observation: &Observation) -> Option<&Proprioception> {
    observation.proprioception.as_ref()
}

fn exact(observation: &Observation) -> Option<&Privileged> {
    observation.privileged.as_ref()
}

fn pose(pose: &Option<Pose>) -> Option<Vec<f64>> {
    pose.as_ref().map(|pose| pose.position.iter().chain(&pose.quaternion).copied().collect())
}

/// Numbers or flags as doubles.
fn all<T: Copy + Into<f64>>(numbers: &[T]) -> Option<Vec<f64>> {
    Some(numbers.iter().map(|&number| number.into()).collect())
}

/// Least, mean and greatest of at least one number.
pub fn spread(numbers: &[f64]) -> [f64; 3] {
    let (least, greatest) =
        numbers.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, greatest), x| (x.min(least), x.max(greatest)));
    [least, numbers.iter().sum::<f64>() / numbers.len() as f64, greatest]
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use fiatlux_proto::v3::Image;

    use super::*;

    #[test]
    fn a_sensor_is_kept_alone() {
        let camera = Some(Image { width: 1, height: 1, rgb: vec![1, 2, 3] });
        let seen = Observation { step: 7, lidar: vec![1.0; 5760], camera, ..Observation::default() };
        let mut kept = Observation::default();
        let lidar = Sensor::by_name("lidar").unwrap();
        // 4 bytes for each number, plus the field's number and the length.
        assert_eq!(lidar.keep(&seen, &mut kept), 4 * 5760 + 4);
        assert_eq!(kept, Observation { lidar: vec![1.0; 5760], ..Observation::default() });
        // Fields that an observation lacks stay unchanged.
        assert_eq!(lidar.keep(&Observation::default(), &mut kept), 0);
        assert_eq!(kept.lidar.len(), 5760);
        let present = SENSORS.iter().filter(|sensor| sensor.is_in(&seen)).map(|sensor| sensor.name);
        assert_eq!(present.collect::<Vec<_>>(), ["lidar", "camera"]);
    }

    #[test]
    fn numbers_fill_their_shapes() {
        let info = SessionInfo { image_width: 2, image_height: 3, ..SessionInfo::default() };
        let camera = Some(Image { width: 2, height: 3, rgb: vec![0; 18] });
        let own = Proprioception {
            base_angular_velocity: vec![0.0; 3],
            projected_gravity: vec![0.0; 3],
            base_linear_velocity: vec![0.0; 3],
            ..Proprioception::default()
        };
        let pose = Some(Pose { position: vec![0.0; 3], quaternion: vec![0.0; 4] });
        let privileged =
            Privileged { robot: pose.clone(), crate_: pose, seated: vec![true; 2], ..Privileged::default() };
        let seen = Observation {
            camera,
            proprioception: Some(own),
            privileged: Some(privileged),
            lidar: vec![0.0; 5760],
            limb_contact_force: vec![0.0; 12],
            ..Observation::default()
        };
        let mut count = 0;
        for term in SENSORS.iter().flat_map(|sensor| sensor.terms) {
            if let Some(numbers) = term.read(&seen) {
                assert_eq!(numbers.len(), (term.shape)(&info).iter().product::<usize>(), "{}", term.name);
                count += 1;
            }
        }
        assert_eq!(count, 10);
    }
}
