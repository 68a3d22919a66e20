//! Poses as messages and back.

use fiatlux_proto::v3;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::WireError;
use crate::error::array;

pub fn pose_message(pose: &Isometry3<f64>) -> v3::Pose {
    v3::Pose { position: numbers(&pose.translation.vector), quaternion: quaternion(pose) }
}

/// A pose from a message's field. That its quaternion has length 1 is not checked.
///
/// # Errors
/// [`WireError`]: it is missing, has a wrong length, or a number that is not finite.
pub fn read_pose(field: &'static str, pose: &Option<v3::Pose>) -> Result<Isometry3<f64>, WireError> {
    let pose = pose.as_ref().ok_or(WireError::Missing { field })?;
    isometry(field, &pose.position, &pose.quaternion)
}

/// The quaternion is taken as it is: a row that was recorded restarts a world exactly.
pub(crate) fn isometry(field: &'static str, position: &[f64], quaternion: &[f64]) -> Result<Isometry3<f64>, WireError> {
    let [w, x, y, z] = array(field, quaternion)?;
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    Ok(Isometry3::from_parts(Translation3::from(vector(field, position)?), rotation))
}

pub(crate) fn vector(field: &'static str, numbers: &[f64]) -> Result<Vector3<f64>, WireError> {
    array::<3>(field, numbers).map(Vector3::from)
}

pub(crate) fn numbers(vector: &Vector3<f64>) -> Vec<f64> {
    vector.iter().copied().collect()
}

pub(crate) fn quaternion(pose: &Isometry3<f64>) -> Vec<f64> {
    let q = pose.rotation.quaternion();
    vec![q.w, q.i, q.j, q.k]
}
