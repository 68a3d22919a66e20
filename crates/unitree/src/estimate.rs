//! The pelvis's velocity and height, which policies read and no robot measures.

use fiatlux_robot::{Robot, RobotError};
use fiatlux_rules::GRAVITY;
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::messages::ImuState;

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

/// Follows a robot from state to state. Legs say where the pelvis goes, with the noise of all their joints; the inertial unit says how
/// that changes.
#[derive(Debug, Clone, Default)]
pub struct Estimator {
    now: Option<(Estimate, u32)>,
}

/// Times after which what legs say counts, s.
const VELOCITY_TIME: f64 = 0.3;
const HEIGHT_TIME: f64 = 0.1;
/// Longest time between two states that is followed, s: after a longer one legs alone count.
const MAX_GAP: f64 = 0.1;

impl Estimator {
    /// The next state: joint angles and velocities of the whole robot, rad and rad/s, the pelvis's inertial unit, and the robot's clock, ms.
    ///
    /// # Errors
    /// Numbers that are not finite.
    pub fn follow(
        &mut self,
        robot: &Robot,
        q: &[f64],
        dq: &[f64],
        imu: &ImuState,
        tick: u32,
    ) -> Result<Estimate, RobotError> {
        let turn = Vector3::from(imu.gyroscope.map(f64::from));
        let by_legs = by_legs(robot, q, dq, imu.quaternion.map(f64::from), turn)?;
        let gap = |before: u32| f64::from(tick.wrapping_sub(before)) / 1000.0;
        let estimate = match self.now {
            Some((last, before)) if gap(before) <= MAX_GAP => {
                let dt = gap(before);
                let last_velocity = Vector3::from(last.linear_velocity);
                let force = Vector3::from(imu.accelerometer.map(f64::from));
                let pull = GRAVITY * Vector3::from(by_legs.gravity);
                let predicted = last_velocity + dt * (force + pull - turn.cross(&last_velocity));
                let share = 1.0 - (-dt / VELOCITY_TIME).exp();
                let velocity = predicted + share * (Vector3::from(by_legs.linear_velocity) - predicted);
                let height = last.height + (1.0 - (-dt / HEIGHT_TIME).exp()) * (by_legs.height - last.height);
                Estimate { linear_velocity: velocity.into(), height, ..by_legs }
            }
            // The first state is of a robot at rest, as far as anybody knows.
            None => Estimate { linear_velocity: [0.0; 3], ..by_legs },
            Some(_) => by_legs,
        };
        self.now = Some((estimate, tick));
        Ok(estimate)
    }
}

/// The legs' word, from angles and velocities, the pelvis's orientation (w, x, y, z) and its own angular velocity.
fn by_legs(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    orientation: [f64; 4],
    turn: Vector3<f64>,
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
    let velocity = -(turn.cross(&foot) + (place(&then, stance) - foot) / STEP);
    Ok(Estimate {
        linear_velocity: velocity.into(),
        height: robot.height_on_soles(q, &rotation)?,
        gravity: (rotation.inverse() * -Vector3::z()).into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

    fn ankles(robot: &Robot) -> [usize; 2] {
        ["left_ankle_pitch_joint", "right_ankle_pitch_joint"].map(|name| robot.joint_index(name).expect("a joint"))
    }

    #[test]
    fn a_standing_robot_does_not_move() {
        let robot = Robot::benchmark().expect("a robot");
        let dq = vec![0.0; robot.joints().len()];
        let estimate = by_legs(&robot, robot.q0(), &dq, UPRIGHT, Vector3::zeros()).expect("finite");
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
        let estimate = by_legs(&robot, robot.q0(), &dq, UPRIGHT, Vector3::new(0.0, 0.1, 0.0)).expect("finite");
        let [x, y, z] = estimate.linear_velocity;
        // About the ankle, 35 mm above the floor.
        let expected = 0.1 * (robot.standing_height() - 0.035);
        assert!((x - expected).abs() < 0.003 && y.abs() < 1e-3 && z.abs() < 0.01, "{x} {y} {z}, {expected}");
    }

    #[test]
    fn noise_of_the_joints_is_smoothed_and_what_the_body_feels_is_not_late() {
        let robot = Robot::benchmark().expect("a robot");
        let count = robot.joints().len();
        let mut estimator = Estimator::default();
        // At rest for 2 s, with velocities of the joints that are wrong by 0.5 rad/s, another way in each state; then 0.1 s of 2 m/s^2 forwards.
        let (mut worst, mut last) = (0.0_f64, [0.0; 3]);
        for tick in 0..1050_u32 {
            let noise = |joint: usize| 0.5 * (f64::from(tick) * 12.9898 + joint as f64 * 78.233).sin();
            let dq: Vec<f64> = (0..count).map(noise).collect();
            let pushed = if tick > 1000 { 2.0 } else { 0.0 };
            let quaternion = UPRIGHT.map(|number| number as f32);
            let imu = ImuState { quaternion, accelerometer: [pushed, 0.0, 9.81], ..ImuState::default() };
            last = estimator.follow(&robot, robot.q0(), &dq, &imu, 2 * tick).expect("finite").linear_velocity;
            if tick == 1000 {
                worst = last.iter().fold(0.0, |most: f64, speed| most.max(speed.abs()));
            }
        }
        assert!(worst < 0.05, "{worst}");
        assert!((last[0] - 0.2).abs() < 0.06, "{last:?}");
    }

    #[test]
    fn a_clock_that_stands_changes_nothing_and_a_gap_leaves_the_legs() {
        let robot = Robot::benchmark().expect("a robot");
        let mut dq = vec![0.0; robot.joints().len()];
        let quaternion = UPRIGHT.map(|number| number as f32);
        let mut imu = ImuState { quaternion, accelerometer: [0.0, 0.0, 9.81], ..ImuState::default() };
        let mut estimator = Estimator::default();
        let first = estimator.follow(&robot, robot.q0(), &dq, &imu, 5).expect("finite");
        ankles(&robot).iter().for_each(|&joint| dq[joint] = -0.1);
        imu.gyroscope = [0.0, 0.1, 0.0];
        let same = estimator.follow(&robot, robot.q0(), &dq, &imu, 5).expect("finite");
        assert_eq!(same.linear_velocity, first.linear_velocity);
        let after = estimator.follow(&robot, robot.q0(), &dq, &imu, 500).expect("finite");
        assert!(after.linear_velocity[0] > 0.07);
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        let robot = Robot::benchmark().expect("a robot");
        let dq = vec![f64::NAN; robot.joints().len()];
        assert!(Estimator::default().follow(&robot, robot.q0(), &dq, &ImuState::default(), 0).is_err());
    }
}
