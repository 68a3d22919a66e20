//! Which motor drives which joint.

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

/// The fingers that one motor of an Inspire hand bends, and how far each turns for one radian of the first; in the order of
/// `rt/inspire/cmd`: little, ring, middle, index finger, bend of the thumb, turn of the thumb.
const FINGERS: [&[(&str, f64)]; 6] = [
    &[("pinky_proximal_joint", 1.0), ("pinky_intermediate_joint", 1.0)],
    &[("ring_proximal_joint", 1.0), ("ring_intermediate_joint", 1.0)],
    &[("middle_proximal_joint", 1.0), ("middle_intermediate_joint", 1.0)],
    &[("index_proximal_joint", 1.0), ("index_intermediate_joint", 1.0)],
    &[("thumb_proximal_pitch_joint", 1.0), ("thumb_intermediate_joint", 1.6), ("thumb_distal_joint", 2.4)],
    &[("thumb_proximal_yaw_joint", 1.0)],
];
/// The right hand comes first.
const SIDES: [&str; 2] = ["R", "L"];

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
    /// Of each motor of both Inspire hands: its joints, with their turn for one radian of the first. Empty for another hand.
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
        let motor = |side: &str, fingers: &[(&str, f64)]| -> Option<Vec<(usize, f64)>> {
            fingers.iter().map(|(joint, turn)| Some((find(&format!("{side}_{joint}"))?, *turn))).collect()
        };
        let hands: Option<Vec<_>> =
            (SIDES.iter()).flat_map(|side| FINGERS.map(|fingers| motor(side, fingers))).collect();
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
            assert_eq!(motors.hands.len(), if name == "g1_inspire" { 12 } else { 0 }, "{name}");
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
