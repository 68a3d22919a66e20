//! Rows as messages and back.

use fiatlux_proto::v3;
use fiatlux_rules::{AttachmentRow, BodyRow, Bulb, LIMBS, RobotLayout, Row};
use nalgebra::Vector3;

use crate::WireError;
use crate::error::{array, check_finite, list};
use crate::pose::{isometry, numbers, pose_message, quaternion, read_pose, vector};

/// A row as a message.
pub fn state_message(row: &Row) -> v3::State {
    let bulb = |bulb: Bulb| {
        let i = bulb as usize;
        v3::Bulb {
            body: Some(body(&row.bulbs[i])),
            hand_force: flat(&row.hand_force[i]),
            hand_force_peak: row.hand_force_peak[i].clone(),
            other_force_peak: row.other_force_peak[i],
            seated: row.attachments[i].seated,
            steps_beyond: row.attachments[i].steps_beyond,
        }
    };
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
        ladder: Some(body(&row.ladder)),
        old_bulb: Some(bulb(Bulb::Old)),
        fresh_bulb: Some(bulb(Bulb::Fresh)),
        fixture: Some(pose_message(&row.fixture)),
        crate_: Some(pose_message(&row.crate_)),
        floor_load: row.floor_load.to_vec(),
        tread_load: row.tread_load.to_vec(),
        floor_force: flat(&row.floor_force),
        ladder_force: flat(&row.ladder_force),
        unconverged: row.unconverged,
        retried: row.retried,
        joint_speed_peak: row.joint_speed_peak,
        penetration: row.penetration,
    }
}

/// A row from a message, whose lists must have the lengths of `layout` and whose numbers must be finite. The peak speed of
/// the joints alone may be infinite: that is how a row says that its world went no further.
///
/// # Errors
/// [`WireError`], with the field.
pub fn read_row(state: &v3::State, layout: RobotLayout) -> Result<Row, WireError> {
    let [old, fresh] = [("old_bulb", &state.old_bulb), ("fresh_bulb", &state.fresh_bulb)]
        .map(|(field, bulb)| bulb.as_ref().ok_or(WireError::Missing { field }));
    let (old, fresh) = (old?, fresh?);
    let (joints, hands) = (layout.joints, layout.hand_bodies());
    let penetration = size("penetration", state.penetration)?;
    check_finite("penetration", &[penetration])?;
    let other_force_peak = [
        size("old_bulb.other_force_peak", old.other_force_peak)?,
        size("fresh_bulb.other_force_peak", fresh.other_force_peak)?,
    ];
    check_finite("other_force_peak", &other_force_peak)?;
    let attachment = |bulb: &v3::Bulb| AttachmentRow { seated: bulb.seated, steps_beyond: bulb.steps_beyond };
    Ok(Row {
        step: state.step,
        robot: read_body("robot", &state.robot)?,
        com_velocity: vector("com_velocity", &state.com_velocity)?,
        world_from_palm: [read_pose("left_palm", &state.left_palm)?, read_pose("right_palm", &state.right_palm)?],
        joint_position: list("joint_position", &state.joint_position, joints)?,
        joint_velocity: list("joint_velocity", &state.joint_velocity, joints)?,
        joint_target: list("joint_target", &state.joint_target, joints)?,
        joint_effort: list("joint_effort", &state.joint_effort, joints)?,
        action: list("action", &state.action, joints)?,
        ladder: read_body("ladder", &state.ladder)?,
        bulbs: [read_body("old_bulb.body", &old.body)?, read_body("fresh_bulb.body", &fresh.body)?],
        fixture: read_pose("fixture", &state.fixture)?,
        crate_: read_pose("crate", &state.crate_)?,
        hand_force: [
            vectors("old_bulb.hand_force", &old.hand_force, hands)?,
            vectors("fresh_bulb.hand_force", &fresh.hand_force, hands)?,
        ],
        hand_force_peak: [
            list("old_bulb.hand_force_peak", &old.hand_force_peak, hands)?,
            list("fresh_bulb.hand_force_peak", &fresh.hand_force_peak, hands)?,
        ],
        other_force_peak,
        floor_load: array("floor_load", &state.floor_load)?,
        tread_load: array("tread_load", &state.tread_load)?,
        floor_force: limbs("floor_force", &state.floor_force)?,
        ladder_force: limbs("ladder_force", &state.ladder_force)?,
        attachments: [attachment(old), attachment(fresh)],
        unconverged: state.unconverged,
        retried: state.retried,
        joint_speed_peak: size("joint_speed_peak", state.joint_speed_peak)?,
        penetration,
    })
}

fn body(body: &BodyRow) -> v3::Body {
    v3::Body {
        position: numbers(&body.pose.translation.vector),
        quaternion: quaternion(&body.pose),
        linear_velocity: numbers(&body.linear_velocity),
        angular_velocity: numbers(&body.angular_velocity),
    }
}

fn read_body(field: &'static str, body: &Option<v3::Body>) -> Result<BodyRow, WireError> {
    let body = body.as_ref().ok_or(WireError::Missing { field })?;
    Ok(BodyRow {
        pose: isometry(field, &body.position, &body.quaternion)?,
        linear_velocity: vector(field, &body.linear_velocity)?,
        angular_velocity: vector(field, &body.angular_velocity)?,
    })
}

/// Zero or above; it may be infinite.
fn size(field: &'static str, number: f64) -> Result<f64, WireError> {
    if number >= 0.0 {
        return Ok(number);
    }
    Err(WireError::Value { field, problem: format!("is {number}; it must be zero or above") })
}

fn flat(vectors: &[Vector3<f64>]) -> Vec<f64> {
    vectors.iter().flat_map(|vector| vector.iter().copied()).collect()
}

fn vectors(field: &'static str, numbers: &[f64], count: usize) -> Result<Vec<Vector3<f64>>, WireError> {
    if numbers.len() != 3 * count {
        return Err(WireError::Length { field, found: numbers.len(), expected: 3 * count });
    }
    check_finite(field, numbers)?;
    Ok(numbers.as_chunks::<3>().0.iter().map(|&vector| Vector3::from(vector)).collect())
}

fn limbs(field: &'static str, numbers: &[f64]) -> Result<[Vector3<f64>; LIMBS], WireError> {
    let flat: [f64; 3 * LIMBS] = array(field, numbers)?;
    Ok(std::array::from_fn(|limb| Vector3::from_column_slice(&flat[3 * limb..3 * limb + 3])))
}
