//! Rows as messages and back.

use fiatlux_proto::v3;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::{AttachmentRow, BodyRow, Bulb, HAND_BODIES, Row};

/// Why a message is no row.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RowError {
    /// A part is missing.
    #[error("State: {field} is missing")]
    Missing {
        /// The field.
        field: &'static str,
    },
    /// A list has a wrong length.
    #[error("State: {field} has {found} numbers instead of {expected}")]
    Length {
        /// The field.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The length it must have.
        expected: usize,
    },
    /// A number is infinite or none at all: no world has such a state, and rules are not made for it.
    #[error("State: {field} has a number that is not finite")]
    NotFinite {
        /// The field.
        field: &'static str,
    },
}

impl From<&Row> for v3::State {
    fn from(row: &Row) -> Self {
        let bulb = |bulb: Bulb| {
            let i = bulb as usize;
            v3::Bulb {
                body: Some(body(&row.bulbs[i])),
                hand_force: row.hand_force[i].iter().flat_map(|force| force.iter().copied()).collect(),
                hand_force_peak: row.hand_force_peak[i].to_vec(),
                seated: row.attachments[i].seated,
                steps_beyond: row.attachments[i].steps_beyond,
            }
        };
        Self {
            step: row.step,
            robot: Some(body(&row.robot)),
            com_velocity: list(&row.com_velocity),
            left_palm_position: list(&row.palm_position[0]),
            right_palm_position: list(&row.palm_position[1]),
            joint_position: row.joint_position.to_vec(),
            joint_velocity: row.joint_velocity.to_vec(),
            joint_target: row.joint_target.to_vec(),
            joint_effort: row.joint_effort.to_vec(),
            action: row.action.to_vec(),
            ladder: Some(body(&row.ladder)),
            old_bulb: Some(bulb(Bulb::Old)),
            fresh_bulb: Some(bulb(Bulb::Fresh)),
            fixture: Some(pose_message(&row.fixture)),
            crate_: Some(pose_message(&row.crate_)),
            limb_force: row.limb_force.iter().flat_map(|force| force.iter().copied()).collect(),
            unconverged: row.unconverged,
        }
    }
}

/// Lengths are checked, and that all numbers are finite.
impl TryFrom<&v3::State> for Row {
    type Error = RowError;

    fn try_from(state: &v3::State) -> Result<Self, RowError> {
        let [old, fresh] = [("old_bulb", &state.old_bulb), ("fresh_bulb", &state.fresh_bulb)]
            .map(|(field, bulb)| bulb.as_ref().ok_or(RowError::Missing { field }));
        let (old, fresh) = (old?, fresh?);
        let bulb_forces = |bulb: &v3::Bulb| vectors::<HAND_BODIES>("bulb.hand_force", &bulb.hand_force);
        let attachment = |bulb: &v3::Bulb| AttachmentRow { seated: bulb.seated, steps_beyond: bulb.steps_beyond };
        Ok(Row {
            step: state.step,
            robot: read_body("robot", &state.robot)?,
            com_velocity: vector("com_velocity", &state.com_velocity)?,
            palm_position: [
                vector("left_palm_position", &state.left_palm_position)?,
                vector("right_palm_position", &state.right_palm_position)?,
            ],
            joint_position: array("joint_position", &state.joint_position)?,
            joint_velocity: array("joint_velocity", &state.joint_velocity)?,
            joint_target: array("joint_target", &state.joint_target)?,
            joint_effort: array("joint_effort", &state.joint_effort)?,
            action: array("action", &state.action)?,
            ladder: read_body("ladder", &state.ladder)?,
            bulbs: [read_body("old_bulb.body", &old.body)?, read_body("fresh_bulb.body", &fresh.body)?],
            fixture: read_pose("fixture", &state.fixture)?,
            crate_: read_pose("crate", &state.crate_)?,
            hand_force: [bulb_forces(old)?, bulb_forces(fresh)?],
            hand_force_peak: [
                array("old_bulb.hand_force_peak", &old.hand_force_peak)?,
                array("fresh_bulb.hand_force_peak", &fresh.hand_force_peak)?,
            ],
            limb_force: vectors("limb_force", &state.limb_force)?,
            attachments: [attachment(old), attachment(fresh)],
            unconverged: state.unconverged,
        })
    }
}

fn list(vector: &Vector3<f64>) -> Vec<f64> {
    vector.iter().copied().collect()
}

fn quaternion(pose: &Isometry3<f64>) -> Vec<f64> {
    let q = pose.rotation.quaternion();
    vec![q.w, q.i, q.j, q.k]
}

/// A pose as a message.
pub fn pose_message(pose: &Isometry3<f64>) -> v3::Pose {
    v3::Pose { position: list(&pose.translation.vector), quaternion: quaternion(pose) }
}

fn body(body: &BodyRow) -> v3::Body {
    v3::Body {
        position: list(&body.pose.translation.vector),
        quaternion: quaternion(&body.pose),
        linear_velocity: list(&body.linear_velocity),
        angular_velocity: list(&body.angular_velocity),
    }
}

fn array<const N: usize>(field: &'static str, numbers: &[f64]) -> Result<[f64; N], RowError> {
    check_finite(field, numbers)?;
    numbers.try_into().map_err(|_| RowError::Length { field, found: numbers.len(), expected: N })
}

fn check_finite(field: &'static str, numbers: &[f64]) -> Result<(), RowError> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(RowError::NotFinite { field }) }
}

fn vector(field: &'static str, numbers: &[f64]) -> Result<Vector3<f64>, RowError> {
    array::<3>(field, numbers).map(Vector3::from)
}

fn vectors<const N: usize>(field: &'static str, numbers: &[f64]) -> Result<[Vector3<f64>; N], RowError> {
    if numbers.len() != 3 * N {
        return Err(RowError::Length { field, found: numbers.len(), expected: 3 * N });
    }
    check_finite(field, numbers)?;
    Ok(std::array::from_fn(|i| Vector3::new(numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2])))
}

/// The quaternion is taken as it is: a row that was recorded restarts a world exactly.
fn isometry(field: &'static str, position: &[f64], quaternion: &[f64]) -> Result<Isometry3<f64>, RowError> {
    let [w, x, y, z] = array(field, quaternion)?;
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    Ok(Isometry3::from_parts(Translation3::from(vector(field, position)?), rotation))
}

/// A pose from a message's field. That its quaternion has length 1 is not checked.
///
/// # Errors
/// [`RowError`]: it is missing, has a wrong length, or a number that is not finite.
pub fn read_pose(field: &'static str, pose: &Option<v3::Pose>) -> Result<Isometry3<f64>, RowError> {
    let pose = pose.as_ref().ok_or(RowError::Missing { field })?;
    isometry(field, &pose.position, &pose.quaternion)
}

fn read_body(field: &'static str, body: &Option<v3::Body>) -> Result<BodyRow, RowError> {
    let body = body.as_ref().ok_or(RowError::Missing { field })?;
    Ok(BodyRow {
        pose: isometry(field, &body.position, &body.quaternion)?,
        linear_velocity: vector(field, &body.linear_velocity)?,
        angular_velocity: vector(field, &body.angular_velocity)?,
    })
}
