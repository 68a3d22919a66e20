//! What an observation can have, term by term: names, shapes and units as in `observation.proto`.

use fiatlux_proto::Message;
use fiatlux_proto::v3::{Observation, Pose, Privileged, Proprioception, SessionInfo, Verdict};

/// A sensor's part of an observation.
pub struct Sensor {
    /// Name, as a session asks for it.
    pub name: &'static str,
    /// It takes the server a while, or many bytes; its cost is worth a look.
    pub is_large: bool,
    pub terms: &'static [Term],
    /// Puts what an observation has of it into another one.
    copy: fn(&Observation, &mut Observation),
}

/// Numbers of one kind.
pub struct Term {
    pub name: &'static str,
    pub unit: &'static str,
    /// How many of its numbers say more by themselves than their least, mean and greatest do.
    pub shown: usize,
    pub shape: fn(&SessionInfo) -> Vec<usize>,
    read: fn(&Observation) -> Option<Vec<f64>>,
}

impl Sensor {
    /// The sensor of that name.
    pub fn by_name(name: &str) -> Option<&'static Sensor> {
        SENSORS.iter().find(|sensor| sensor.name == name)
    }

    /// Whether an observation has it.
    pub fn is_in(&self, observation: &Observation) -> bool {
        self.terms.iter().any(|term| term.read(observation).is_some())
    }

    /// Puts what an observation has of it into another one; the bytes that it takes in a message, 0 without it.
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
    /// Its numbers; `None` where an observation does not have it.
    pub fn read(&self, observation: &Observation) -> Option<Vec<f64>> {
        (self.read)(observation).filter(|numbers| !numbers.is_empty())
    }
}

const SELF: usize = 4;

const fn term(
    name: &'static str,
    unit: &'static str,
    shown: usize,
    shape: fn(&SessionInfo) -> Vec<usize>,
    read: fn(&Observation) -> Option<Vec<f64>>,
) -> Term {
    Term { name, unit, shown, shape, read }
}

/// All sensors, in the order in which sessions list them.
pub static SENSORS: [Sensor; 10] = [
    Sensor {
        name: "proprioception",
        is_large: false,
        terms: &[
            term("base_angular_velocity", "rad/s", SELF, |_| vec![3], |o| own(o, |p| &p.base_angular_velocity)),
            term("projected_gravity", "", SELF, |_| vec![3], |o| own(o, |p| &p.projected_gravity)),
            term("base_linear_velocity", "m/s", SELF, |_| vec![3], |o| own(o, |p| &p.base_linear_velocity)),
            term(
                "base_height",
                "m",
                SELF,
                |_| vec![1],
                |o| o.proprioception.as_ref().map(|own| vec![f64::from(own.base_height)]),
            ),
            term("joint_position", "rad", SELF, joints, |o| own(o, |p| &p.joint_position)),
            term("joint_velocity", "rad/s", SELF, joints, |o| own(o, |p| &p.joint_velocity)),
        ],
        copy: |from, to| to.proprioception.clone_from(&from.proprioception),
    },
    Sensor {
        name: "hand_contact",
        is_large: false,
        terms: &[term(
            "hand_contact_force",
            "N",
            SELF,
            |info| vec![info.hand_bodies.len(), 3],
            |o| Some(wide(&o.hand_contact_force)),
        )],
        copy: |from, to| to.hand_contact_force.clone_from(&from.hand_contact_force),
    },
    Sensor {
        name: "limb_contact",
        is_large: false,
        terms: &[term("limb_contact_force", "N", SELF, |_| vec![4, 3], |o| Some(wide(&o.limb_contact_force)))],
        copy: |from, to| to.limb_contact_force.clone_from(&from.limb_contact_force),
    },
    Sensor {
        name: "last_action",
        is_large: false,
        terms: &[term("last_action", "action", SELF, joints, |o| Some(wide(&o.last_action)))],
        copy: |from, to| to.last_action.clone_from(&from.last_action),
    },
    Sensor {
        name: "lidar",
        is_large: true,
        terms: &[term("lidar", "m", SELF, |_| vec![32, 180], |o| Some(wide(&o.lidar)))],
        copy: |from, to| to.lidar.clone_from(&from.lidar),
    },
    Sensor {
        name: "camera",
        is_large: true,
        terms: &[term("camera.rgb", "0-255", SELF, image, |o| {
            o.camera.as_ref().map(|image| image.rgb.iter().map(|&byte| f64::from(byte)).collect())
        })],
        copy: |from, to| to.camera.clone_from(&from.camera),
    },
    Sensor {
        name: "features",
        is_large: true,
        terms: &[term("features.values", "", SELF, |_| vec![512], |o| o.features.as_ref().map(|f| wide(&f.values)))],
        copy: |from, to| to.features.clone_from(&from.features),
    },
    Sensor {
        name: "flat",
        is_large: true,
        terms: &[term("flat.values", "", SELF, flat, |o| o.flat.as_ref().map(|flat| wide(&flat.values)))],
        copy: |from, to| to.flat.clone_from(&from.flat),
    },
    Sensor {
        name: "privileged",
        is_large: false,
        terms: &[
            term("robot", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.robot)),
            term("ladder", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.ladder)),
            term("socket", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.socket)),
            term("fresh_bulb", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.fresh_bulb)),
            term("old_bulb", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.old_bulb)),
            term("crate", "m, wxyz", 3, pose_shape, |o| pose(o, |exact| &exact.crate_)),
            term("distances", "m", SELF, |_| vec![4], |o| exact(o, |exact| exact.distances.clone())),
            term("seated", "bool", SELF, |_| vec![2], |o| exact(o, |exact| bools(&exact.seated))),
            term("linear_velocity", "m/s", SELF, |_| vec![3], |o| exact(o, |exact| exact.linear_velocity.clone())),
        ],
        copy: |from, to| to.privileged.clone_from(&from.privileged),
    },
    Sensor {
        name: "verdict",
        is_large: false,
        terms: &[
            term("criteria", "bool", 6, criteria, |o| verdict(o, |v| bools(&v.criteria))),
            term("gate_progress", "", SELF, |_| vec![1], |o| verdict(o, |v| vec![v.gate_progress])),
            term("reward", "", SELF, |_| vec![1], |o| verdict(o, |v| vec![v.reward])),
        ],
        copy: |from, to| to.verdict.clone_from(&from.verdict),
    },
];

fn joints(info: &SessionInfo) -> Vec<usize> {
    vec![info.joints.len()]
}

fn image(info: &SessionInfo) -> Vec<usize> {
    vec![info.image_height as usize, info.image_width as usize, 3]
}

fn flat(info: &SessionInfo) -> Vec<usize> {
    vec![info.flat_terms.iter().map(|term| term.length as usize).sum()]
}

fn criteria(info: &SessionInfo) -> Vec<usize> {
    vec![info.task.as_ref().map_or(0, |task| task.criteria.len())]
}

fn pose_shape(_: &SessionInfo) -> Vec<usize> {
    vec![7]
}

fn own(observation: &Observation, of: fn(&Proprioception) -> &[f32]) -> Option<Vec<f64>> {
    observation.proprioception.as_ref().map(|own| wide(of(own)))
}

fn exact(observation: &Observation, of: fn(&Privileged) -> Vec<f64>) -> Option<Vec<f64>> {
    observation.privileged.as_ref().map(of)
}

fn pose(observation: &Observation, of: fn(&Privileged) -> &Option<Pose>) -> Option<Vec<f64>> {
    let pose = of(observation.privileged.as_ref()?).as_ref()?;
    Some(pose.position.iter().chain(&pose.quaternion).copied().collect())
}

fn verdict(observation: &Observation, of: fn(&Verdict) -> Vec<f64>) -> Option<Vec<f64>> {
    observation.verdict.as_ref().map(of)
}

fn bools(flags: &[bool]) -> Vec<f64> {
    flags.iter().map(|&flag| f64::from(u8::from(flag))).collect()
}

/// As doubles.
fn wide(singles: &[f32]) -> Vec<f64> {
    singles.iter().map(|&number| f64::from(number)).collect()
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
        // 4 bytes a number, the field's number and the length.
        assert_eq!(lidar.keep(&seen, &mut kept), 4 * 5760 + 4);
        assert_eq!(kept, Observation { lidar: vec![1.0; 5760], ..Observation::default() });
        // What an observation lacks stays.
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
