//! Wrist poses as nine numbers, and the joint angles that reach them.

use fiatlux_robot::Robot;
use nalgebra::{Isometry3, Matrix6, Matrix6xX, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::BridgeError;
use crate::hands::Side;

/// Iterations for one row, which are enough because rows are close to each other.
const STEPS: usize = 12;
/// Square of the damping, which limits the steps near a stretched arm.
const DAMPING: f64 = 1e-4;

/// x, y, z in m and the first two rows of the rotation, in the pelvis frame.
pub(crate) fn nine(pose: &Isometry3<f64>) -> [f64; 9] {
    let (at, turn) = (pose.translation.vector, pose.rotation.to_rotation_matrix());
    let turn = turn.matrix();
    [at.x, at.y, at.z, turn[(0, 0)], turn[(0, 1)], turn[(0, 2)], turn[(1, 0)], turn[(1, 1)], turn[(1, 2)]]
}

/// The pose of nine numbers, whose two rows need not be exactly orthogonal. `None` if they define no rotation.
pub(crate) fn pose(nine: &[f64]) -> Option<Isometry3<f64>> {
    let &[x, y, z, a, b, c, d, e, f] = nine else { return None };
    let first = Vector3::new(a, b, c).try_normalize(1e-6)?;
    let second = Vector3::new(d, e, f);
    let second = (second - first * first.dot(&second)).try_normalize(1e-6)?;
    let rows = [first.transpose(), second.transpose(), first.cross(&second).transpose()];
    let turn = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_rows(&rows));
    Some(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_rotation_matrix(&turn)))
}

/// Pose of a wrist in the pelvis frame, for the angles of all joints, rad.
pub(crate) fn wrist(robot: &Robot, side: Side, q: &[f64]) -> Result<Isometry3<f64>, BridgeError> {
    Ok(chain(robot, side, q)?.1)
}

type LinkPoses = (Vec<Isometry3<f64>>, Isometry3<f64>);

/// Poses of all links, with the index of the wrist.
fn chain(robot: &Robot, side: Side, q: &[f64]) -> Result<LinkPoses, BridgeError> {
    let missing = |what: String| BridgeError::Sensed { what, remedy: "use a robot of this version" };
    let links = robot.forward_kinematics(q, &Isometry3::identity()).map_err(|error| missing(error.to_string()))?;
    let wrist = robot.link_index(side.wrist()).ok_or_else(|| missing(format!("a link {}", side.wrist())))?;
    let pose = links[wrist];
    Ok((links, pose))
}

/// Moves the arm's joints in `q` so that the wrist gets as close to a pose as their limits allow, by damped least
/// squares.
pub(crate) fn reach(robot: &Robot, side: Side, target: &Isometry3<f64>, q: &mut [f64]) -> Result<(), BridgeError> {
    for _ in 0..STEPS {
        let (links, wrist) = chain(robot, side, q)?;
        let moved = target.translation.vector - wrist.translation.vector;
        let turned = (target.rotation * wrist.rotation.inverse()).scaled_axis();
        let error = Vector6::new(moved.x, moved.y, moved.z, turned.x, turned.y, turned.z);
        if error.norm() < 1e-6 {
            break;
        }
        let mut jacobian = Matrix6xX::zeros(side.arm().len());
        for (column, joint) in side.arm().enumerate() {
            let joint = &robot.joints()[joint];
            let link = &links[joint.link];
            let axis = link.rotation * joint.axis.into_inner();
            let lever = wrist.translation.vector - link.translation.vector;
            jacobian.fixed_view_mut::<3, 1>(0, column).copy_from(&axis.cross(&lever));
            jacobian.fixed_view_mut::<3, 1>(3, column).copy_from(&axis);
        }
        let square = &jacobian * jacobian.transpose() + Matrix6::identity() * DAMPING;
        let Some(solved) = square.cholesky().map(|square| square.solve(&error)) else { break };
        let change = jacobian.transpose() * solved;
        for (column, index) in side.arm().enumerate() {
            let joint = &robot.joints()[index];
            q[index] = (q[index] + change[column]).clamp(joint.lower, joint.upper);
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Nine numbers restore a pose, and the arm returns to it.
    #[test]
    fn a_wrist_is_reached_again() {
        let robot = Robot::benchmark().unwrap();
        for side in [Side::Left, Side::Right] {
            let mut bent = robot.q0().to_vec();
            for (at, joint) in side.arm().enumerate() {
                bent[joint] += [0.3, 0.1, -0.2, 0.8, 0.2, -0.1, 0.3][at];
            }
            let there = wrist(&robot, side, &bent).unwrap();
            let again = pose(&nine(&there)).unwrap();
            assert!((again.translation.vector - there.translation.vector).norm() < 1e-12);
            assert!(again.rotation.angle_to(&there.rotation) < 1e-7);
            let mut q = robot.q0().to_vec();
            for joint in side.arm() {
                q[joint] += 0.1;
            }
            for _ in 0..5 {
                reach(&robot, side, &there, &mut q).unwrap();
            }
            let reached = wrist(&robot, side, &q).unwrap();
            assert!((reached.translation.vector - there.translation.vector).norm() < 1e-3);
            assert!(reached.rotation.angle_to(&there.rotation) < 1e-2);
        }
        assert!(pose(&[0.0; 9]).is_none() && pose(&[1.0; 3]).is_none());
    }
}
