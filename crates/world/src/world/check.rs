//! Checks that a world can start from a row.

use fiatlux_rules::{Motion, Row, manifest};

use crate::error::WorldError;

pub(super) fn check_row(row: &Row) -> Result<(), WorldError> {
    let finite = |field: &'static str, values: &[f64]| match values.iter().find(|v| !v.is_finite()) {
        Some(&value) => Err(WorldError::Row { field, value, rule: "it must be finite" }),
        None => Ok(()),
    };
    let things = manifest().things.iter().zip(&row.things);
    let things =
        things.filter(|(thing, _)| thing.motion == Motion::Free).map(|(thing, body)| (thing.name.as_str(), body));
    for (field, body) in [("robot", &row.robot)].into_iter().chain(things) {
        finite(field, body.pose.translation.vector.as_slice())?;
        finite(field, body.pose.rotation.coords.as_slice())?;
        finite(field, body.linear_velocity.as_slice())?;
        finite(field, body.angular_velocity.as_slice())?;
        let norm = body.pose.rotation.coords.norm();
        if (norm - 1.0).abs() > 1e-6 {
            return Err(WorldError::Row { field, value: norm, rule: "its quaternion must have length 1" });
        }
    }
    // Rows may come from a file: counters stay where another step cannot overflow them.
    let limit = |field, value: u64, most: u64| {
        let rule = "it is more than an episode can reach";
        if value <= most { Ok(()) } else { Err(WorldError::Row { field, value: value as f64, rule }) }
    };
    limit("step", row.step, 1 << 52)?;
    for attachment in &row.attachments {
        limit("attachments", attachment.steps_beyond.into(), u64::from(u32::MAX / 2))?;
    }
    if row.attachments.iter().filter(|attachment| attachment.seated).count() > 1 {
        let rule = "bulbs are seated; the socket holds one";
        return Err(WorldError::Row { field: "attachments", value: 2.0, rule });
    }
    finite("joint_position", &row.joint_position)?;
    finite("joint_velocity", &row.joint_velocity)?;
    finite("joint_target", &row.joint_target)
}
