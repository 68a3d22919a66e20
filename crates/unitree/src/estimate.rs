//! What a robot does not measure but policies read: how fast its pelvis moves, and how high it is.

use fiatlux_robot::{Robot, RobotError};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Step of the numerical derivative, s.
const STEP: f64 = 1e-4;

/// Where the pelvis is and goes, if the lower foot stands still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Velocity in the pelvis's own frame, m/s.
    pub linear_velocity: [f64; 3],
    /// Height of the pelvis above the floor under the lower sole, m.
    pub height: f64,
    /// Direction of gravity in the pelvis frame.
    pub gravity: [f64; 3],
}

/// From joint angles and velocities of the whole robot, the pelvis's orientation (w, x, y, z) and its own angular velocity.
///
/// # Errors
/// Numbers that are not finite.
pub fn estimate(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    orientation: [f64; 4],
    angular_velocity: [f64; 3],
) -> Result<Estimate, RobotError> {
    let [w, i, j, k] = orientation;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    let later: Vec<f64> = q.iter().zip(dq).map(|(q, dq)| q + STEP * dq).collect();
    let now = robot.forward_kinematics(q, &Isometry3::identity())?;
    let then = robot.forward_kinematics(&later, &Isometry3::identity())?;
    let place = |poses: &[Isometry3<f64>], link: usize| poses[link].translation.vector;
    let height = |link: &&usize| (rotation * place(&now, **link)).z;
    let stance = robot.feet().iter().min_by(|one, other| height(one).total_cmp(&height(other))).copied().unwrap_or(0);
    let foot = place(&now, stance);
    // The foot stands still: pelvis + turn x foot + its own motion = 0.
    let velocity = -(Vector3::from(angular_velocity).cross(&foot) + (place(&then, stance) - foot) / STEP);
    Ok(Estimate {
        linear_velocity: velocity.into(),
        height: robot.height_on_soles(q, &rotation)?,
        gravity: (rotation.inverse() * -Vector3::z()).into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ankles(robot: &Robot) -> [usize; 2] {
        ["left_ankle_pitch_joint", "right_ankle_pitch_joint"].map(|name| robot.joint_index(name).expect("a joint"))
    }

    #[test]
    fn a_standing_robot_does_not_move() {
        let robot = Robot::benchmark().expect("a robot");
        let dq = vec![0.0; robot.joints().len()];
        let estimate = estimate(&robot, robot.q0(), &dq, [1.0, 0.0, 0.0, 0.0], [0.0; 3]).expect("finite");
        assert_eq!(estimate.linear_velocity, [0.0; 3]);
        assert_eq!(estimate.height, robot.standing_height());
        assert_eq!(estimate.gravity, [0.0, 0.0, -1.0]);
    }

    #[test]
    fn a_robot_that_sways_about_its_ankles_moves_by_its_height() {
        let robot = Robot::benchmark().expect("a robot");
        let mut dq = vec![0.0; robot.joints().len()];
        // The body turns forward about both ankles at 0.1 rad/s: the feet turn backward in its frame.
        ankles(&robot).iter().for_each(|&joint| dq[joint] = -0.1);
        let estimate = estimate(&robot, robot.q0(), &dq, [1.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0]).expect("finite");
        let [x, y, z] = estimate.linear_velocity;
        // About the ankle, 35 mm above the floor.
        let expected = 0.1 * (robot.standing_height() - 0.035);
        assert!((x - expected).abs() < 0.003 && y.abs() < 1e-3 && z.abs() < 0.01, "{x} {y} {z}, {expected}");
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        let robot = Robot::benchmark().expect("a robot");
        let dq = vec![f64::NAN; robot.joints().len()];
        assert!(estimate(&robot, robot.q0(), &dq, [1.0, 0.0, 0.0, 0.0], [0.0; 3]).is_err());
    }
}
