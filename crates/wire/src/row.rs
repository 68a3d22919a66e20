//! Rows as messages and back.

use fiatlux_proto::v3;
use fiatlux_rules::{AttachmentRow, BodyRow, Contact, Measure, Motion, RobotLayout, Row, manifest};
use nalgebra::{Isometry3, Vector3};

use crate::WireError;
use crate::error::check_finite;
use crate::pose::{isometry, numbers, pose_message, quaternion, read_pose, vector};

pub fn state_message(row: &Row) -> v3::State {
    let things = manifest().things.iter().zip(&row.present).zip(&row.things);
    let things = things.map(|((thing, present), values)| match (present, thing.motion) {
        (false, _) => v3::Body::default(),
        (true, Motion::Free) => body(values),
        (true, Motion::Fixed) => v3::Body { linear_velocity: Vec::new(), angular_velocity: Vec::new(), ..body(values) },
    });
    let attachments = row.attachments.iter();
    let attachments = attachments.map(|a| v3::Attachment { seated: a.seated, steps_beyond: a.steps_beyond });
    v3::State {
        step: row.step,
        robot: Some(body(&row.robot)),
        com_velocity: numbers(&row.com_velocity),
        left_palm: Some(pose_message(&row.world_from_palm[0])),
        right_palm: Some(pose_message(&row.world_from_palm[1])),
        joint_position: row.joint_position.clone(),
        joint_velocity: row.joint_velocity.clone(),
        joint_target: row.joint_target.clone(),
        joint_effort: row.joint_effort.clone(),
        action: row.action.clone(),
        things: things.collect(),
        attachments: attachments.collect(),
        forces: row.forces.iter().flat_map(|force| force.iter().copied()).collect(),
        loads: row.loads.clone(),
        unconverged: row.unconverged,
        retried: row.retried,
        joint_speed_peak: row.joint_speed_peak,
        penetration: row.penetration,
    }
}

/// The contact measures of a robot's rows, as a header names them.
pub fn contact_messages(layout: RobotLayout) -> Vec<v3::ContactMeasure> {
    let contacts = manifest().contacts.iter();
    let message = contacts.map(|contact| v3::ContactMeasure {
        name: contact.name.clone(),
        vectors: contact.measure == Measure::Force,
        parts: contact.range(layout).len() as u32,
    });
    message.collect()
}

/// A row from a message, whose lists must have the lengths of `layout` and whose numbers must be finite. The peak speed of
/// the joints alone may be infinite: that is how a row says that its world went no further.
pub fn read_row(state: &v3::State, layout: RobotLayout) -> Result<Row, WireError> {
    let mut row = Row::zeros(layout);
    row.step = state.step;
    row.robot = read_body("robot", state.robot.as_ref().ok_or(WireError::Missing { field: "robot" })?)?;
    row.com_velocity = vector("com_velocity", &state.com_velocity)?;
    row.world_from_palm = [read_pose("left_palm", &state.left_palm)?, read_pose("right_palm", &state.right_palm)?];
    for (field, to, from) in [
        ("joint_position", &mut row.joint_position, &state.joint_position),
        ("joint_velocity", &mut row.joint_velocity, &state.joint_velocity),
        ("joint_target", &mut row.joint_target, &state.joint_target),
        ("joint_effort", &mut row.joint_effort, &state.joint_effort),
        ("action", &mut row.action, &state.action),
        ("loads", &mut row.loads, &state.loads),
    ] {
        fill(field, to, from)?;
    }
    same_length("forces", state.forces.len(), 3 * row.forces.len())?;
    check_finite("forces", &state.forces)?;
    let forces = state.forces.as_chunks::<3>().0;
    row.forces.iter_mut().zip(forces).for_each(|(to, from)| *to = Vector3::from(*from));
    same_length("things", state.things.len(), row.things.len())?;
    for (index, (thing, body)) in manifest().things.iter().zip(&state.things).enumerate() {
        row.present[index] = !(body.position.is_empty() && body.quaternion.is_empty());
        let has_velocity = !(body.linear_velocity.is_empty() && body.angular_velocity.is_empty());
        row.things[index] = match (row.present[index], thing.motion) {
            (true, Motion::Free) => read_body(&thing.name, body)?,
            (true, Motion::Fixed) if !has_velocity => {
                BodyRow::at_rest(isometry(&thing.name, &body.position, &body.quaternion)?)
            }
            (false, _) if !has_velocity => BodyRow::at_rest(Isometry3::identity()),
            _ => {
                let problem = "has a velocity, but it is absent or cannot move".into();
                return Err(WireError::Value { field: &thing.name, problem });
            }
        };
    }
    same_length("attachments", state.attachments.len(), row.attachments.len())?;
    for (to, from) in row.attachments.iter_mut().zip(&state.attachments) {
        *to = AttachmentRow { seated: from.seated, steps_beyond: from.steps_beyond };
    }
    // Peaks are sizes.
    let is_peak = |contact: &&Contact| matches!(contact.measure, Measure::ForcePeak(_) | Measure::PressPeak);
    for contact in manifest().contacts.iter().filter(is_peak) {
        for load in &row.loads[contact.range(layout)] {
            size(&contact.name, *load)?;
        }
    }
    (row.unconverged, row.retried) = (state.unconverged, state.retried);
    row.joint_speed_peak = size("joint_speed_peak", state.joint_speed_peak)?;
    row.penetration = size("penetration", state.penetration)?;
    check_finite("penetration", &[row.penetration])?;
    Ok(row)
}

fn body(body: &BodyRow) -> v3::Body {
    v3::Body {
        position: numbers(&body.pose.translation.vector),
        quaternion: quaternion(&body.pose),
        linear_velocity: numbers(&body.linear_velocity),
        angular_velocity: numbers(&body.angular_velocity),
    }
}

fn read_body(field: &'static str, body: &v3::Body) -> Result<BodyRow, WireError> {
    Ok(BodyRow {
        pose: isometry(field, &body.position, &body.quaternion)?,
        linear_velocity: vector(field, &body.linear_velocity)?,
        angular_velocity: vector(field, &body.angular_velocity)?,
    })
}

fn fill(field: &'static str, to: &mut [f64], from: &[f64]) -> Result<(), WireError> {
    same_length(field, from.len(), to.len())?;
    check_finite(field, from)?;
    to.copy_from_slice(from);
    Ok(())
}

fn same_length(field: &'static str, found: usize, expected: usize) -> Result<(), WireError> {
    if found == expected { Ok(()) } else { Err(WireError::Length { field, found, expected }) }
}

/// Zero or above; it may be infinite.
fn size(field: &'static str, number: f64) -> Result<f64, WireError> {
    if number >= 0.0 {
        return Ok(number);
    }
    Err(WireError::Value { field, problem: format!("is {number}; it must be zero or above") })
}
