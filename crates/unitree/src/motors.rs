//! Which motor drives which joint.

use serde::Deserialize;
use thiserror::Error;

/// The joint of each motor of the body, in the order of `motor_cmd` and `motor_state`.
pub const MOTORS: [&str; 29] = [
    "left_hip_pitch_joint",
    "left_hip_roll_joint",
    "left_hip_yaw_joint",
    "left_knee_joint",
    "left_ankle_pitch_joint",
    "left_ankle_roll_joint",
    "right_hip_pitch_joint",
    "right_hip_roll_joint",
    "right_hip_yaw_joint",
    "right_knee_joint",
    "right_ankle_pitch_joint",
    "right_ankle_roll_joint",
    "waist_yaw_joint",
    "waist_roll_joint",
    "waist_pitch_joint",
    "left_shoulder_pitch_joint",
    "left_shoulder_roll_joint",
    "left_shoulder_yaw_joint",
    "left_elbow_joint",
    "left_wrist_roll_joint",
    "left_wrist_pitch_joint",
    "left_wrist_yaw_joint",
    "right_shoulder_pitch_joint",
    "right_shoulder_roll_joint",
    "right_shoulder_yaw_joint",
    "right_elbow_joint",
    "right_wrist_roll_joint",
    "right_wrist_pitch_joint",
    "right_wrist_yaw_joint",
];

/// Motors that the parallel linkages of ankles and waist move together.
pub(crate) const LINKED: [usize; 6] = [4, 5, 10, 11, 13, 14];

/// `hands.toml`, which explains its fields.
#[derive(Debug, Deserialize)]
pub(crate) struct Hands {
    #[cfg(feature = "dds")]
    pub topic: String,
    sides: Vec<String>,
    motors: Vec<Vec<(String, f64)>>,
}

impl Hands {
    /// Those of the file.
    pub fn known() -> Self {
        toml::from_str(include_str!("hands.toml")).expect("the file of this crate is sound, which a test reads")
    }
}

/// A robot whose body is not a G1's.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the robot has no joint {joint}; a G1 with 29 joints is needed")]
pub struct MotorsError {
    /// The first joint that is missing.
    pub joint: &'static str,
}

/// Motors of a robot, by index into its joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Motors {
    /// Of each motor of the body.
    pub body: [usize; MOTORS.len()],
    /// Of each motor of both hands that have a topic of their own: its joints, with their turn for one radian of the first. Empty for other hands.
    pub hands: Vec<Vec<(usize, f64)>>,
}

impl Motors {
    /// Finds the motors of a robot with these joints.
    ///
    /// # Errors
    /// [`MotorsError`].
    pub fn of(joints: &[&str]) -> Result<Self, MotorsError> {
        let find = |name: &str| joints.iter().position(|joint| *joint == name);
        let mut body = [0; MOTORS.len()];
        for (index, joint) in body.iter_mut().zip(MOTORS) {
            *index = find(joint).ok_or(MotorsError { joint })?;
        }
        let known = Hands::known();
        let motor = |side: &str, fingers: &[(String, f64)]| -> Option<Vec<(usize, f64)>> {
            fingers.iter().map(|(joint, turn)| Some((find(&format!("{side}_{joint}"))?, *turn))).collect()
        };
        let motors = known.sides.iter().flat_map(|side| known.motors.iter().map(|fingers| motor(side, fingers)));
        let hands: Option<Vec<_>> = motors.collect();
        Ok(Self { body, hands: hands.unwrap_or_default() })
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_robot::Robot;

    use super::*;

    fn joints(robot: &Robot) -> Vec<&str> {
        robot.joints().iter().map(|joint| joint.name.as_str()).collect()
    }

    #[test]
    fn every_robot_has_the_motors_of_a_g1() {
        for name in Robot::NAMES {
            let robot = Robot::by_name(name).expect("a robot");
            let motors = Motors::of(&joints(&robot)).expect("a G1");
            let named: Vec<&str> = motors.body.iter().map(|joint| robot.joints()[*joint].name.as_str()).collect();
            assert_eq!(named, MOTORS);
            assert_eq!(motors.hands.len(), if name.starts_with("g1_inspire") { 12 } else { 0 }, "{name}");
        }
    }

    #[test]
    fn an_inspire_hand_has_six_motors_for_twelve_fingers() {
        let robot = Robot::benchmark().expect("a robot");
        let motors = Motors::of(&joints(&robot)).expect("a G1");
        let mut all: Vec<usize> = motors.hands.iter().flatten().map(|(joint, _)| *joint).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 24);
        assert!(robot.joints()[motors.hands[0][0].0].name.starts_with("R_pinky"));
    }

    #[test]
    fn another_robot_is_refused_by_the_joint_that_it_lacks() {
        assert_eq!(Motors::of(&["wheel"]), Err(MotorsError { joint: "left_hip_pitch_joint" }));
    }
}
