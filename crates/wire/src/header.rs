//! The header of a bag, which describes the rows that follow it.

use data_encoding::HEXLOWER;
use fiatlux_proto::Message;
use fiatlux_proto::v3::{self, EpisodeHeader};
use fiatlux_rules::{
    Cause, Causes, EpisodeIdentity, JointDrive, JointGroups, RobotLayout, Thresholds, Variant, of_scene,
};
use sha2::{Digest, Sha256};

use crate::WireError;
use crate::error::check_finite;

/// Known rewards, by their names in messages.
const REWARDS: [(&str, Variant); 2] = [("benchmark", Variant::Benchmark), ("training", Variant::Training)];

/// The sizes of an episode's rows.
///
/// # Errors
/// [`WireError::Value`] for a header without joints, or with an odd number of hand bodies.
pub fn layout_of(header: &EpisodeHeader) -> Result<RobotLayout, WireError> {
    let (joints, bodies) = (header.joint_names.len(), header.hand_bodies.len());
    if joints == 0 {
        return Err(WireError::Missing { field: "joint_names" });
    }
    if !bodies.is_multiple_of(2) {
        let problem = format!("has {bodies} names; both hands have the same number of bodies");
        return Err(WireError::Value { field: "hand_bodies", problem });
    }
    Ok(RobotLayout { joints, hand_bodies_per_side: bodies / 2 })
}

/// The joints that terms of rewards read; none where the header names none.
///
/// # Errors
/// [`WireError`] for an index beyond the header's joints, or ankles without a lower and an upper limit each.
pub fn joint_groups_of(header: &EpisodeHeader) -> Result<JointGroups, WireError> {
    let groups = header.joint_groups.clone().unwrap_or_default();
    let list = |field, indices: Vec<u32>| {
        let joints = header.joint_names.len();
        let list: Vec<usize> = indices.into_iter().map(|index| index as usize).collect();
        match list.iter().find(|index| **index >= joints) {
            Some(index) => {
                let problem = format!("has index {index}; the robot has {joints} joints, counted from 0");
                Err(WireError::Value { field, problem })
            }
            None => Ok(list),
        }
    };
    let ankles = list("joint_groups.ankles", groups.ankles)?;
    let (field, limits) = ("joint_groups.ankle_limits", groups.ankle_limits);
    if limits.len() != 2 * ankles.len() {
        return Err(WireError::Length { field, found: limits.len(), expected: 2 * ankles.len() });
    }
    check_finite(field, &limits)?;
    Ok(JointGroups {
        legs: list("joint_groups.legs", groups.legs)?,
        ankles: ankles.into_iter().zip(limits.as_chunks::<2>().0.iter().copied()).collect(),
        waist: list("joint_groups.waist", groups.waist)?,
        fingers: list("joint_groups.fingers", groups.fingers)?,
    })
}

pub fn joint_groups_message(groups: &JointGroups) -> v3::JointGroups {
    let list = |joints: &[usize]| joints.iter().map(|joint| *joint as u32).collect();
    let (ankles, limits): (Vec<usize>, Vec<[f64; 2]>) = groups.ankles.iter().copied().unzip();
    v3::JointGroups {
        legs: list(&groups.legs),
        ankles: list(&ankles),
        ankle_limits: limits.into_flattened(),
        waist: list(&groups.waist),
        fingers: list(&groups.fingers),
    }
}

/// SHA-256 over the header as it is encoded, hexadecimal: what [`EpisodeResult`](v3::EpisodeResult) says of its header.
pub fn header_digest(header: &EpisodeHeader) -> String {
    HEXLOWER.encode(&Sha256::digest(header.encode_to_vec()))
}

/// The reward that an episode pays.
///
/// # Errors
/// [`WireError::Value`] for a name that is not known.
pub fn reward_of(header: &EpisodeHeader) -> Result<Variant, WireError> {
    let known = REWARDS.into_iter().find(|(name, _)| *name == header.reward);
    known.map(|(_, variant)| variant).ok_or_else(|| {
        let problem =
            format!("'{}' is not known; known ones are {}", header.reward, REWARDS.map(|(name, _)| name).join(", "));
        WireError::Value { field: "reward", problem }
    })
}

/// Identity of the episode: the header's digest_context must be the digest of this.
///
/// # Errors
/// [`WireError`], with the field: one is missing, or names what this version does not know.
pub fn read_identity(header: &EpisodeHeader) -> Result<EpisodeIdentity, WireError> {
    let value =
        |field| move |problem: String| WireError::Value { field, problem: format!("cannot be read: {problem}") };
    let sample = header.domain_sample.as_ref().ok_or(WireError::Missing { field: "domain_sample" })?;
    let scale = sample.prop_scale.as_ref().ok_or(WireError::Missing { field: "domain_sample.prop_scale" })?;
    let random = header.randomization.unwrap_or_default();
    let mut thresholds = Thresholds::default();
    for (key, number) in &header.thresholds {
        thresholds.set(&format!("{key}={number}")).map_err(|error| value("thresholds")(error.to_string()))?;
    }
    let ends_on: Result<Causes, _> = header.end_on.iter().map(|name| name.parse::<Cause>()).collect();
    let drives: Vec<JointDrive> = header.drives.iter().map(drive).collect();
    if drives.len() != header.joint_names.len() {
        return Err(WireError::Length { field: "drives", found: drives.len(), expected: header.joint_names.len() });
    }
    let prop_scale = [scale.ladder_x, scale.ladder_y, scale.ladder_z, scale.socket, scale.fresh_bulb];
    check_finite("domain_sample.prop_scale", &prop_scale)?;
    Ok(EpisodeIdentity {
        task: header.task.parse().map_err(|error: fiatlux_rules::UnknownTask| value("task")(error.to_string()))?,
        seed: header.seed,
        episode: header.episode,
        layout_seed: if random.fixed_layout { 0 } else { header.seed },
        drives,
        hand_friction: sample.hand_friction.as_ref().map(|friction| friction.dynamic_friction),
        prop_scale,
        is_start_drawn: !random.fixed_start,
        varied: of_scene(&sample.varied),
        thresholds,
        protocol: header
            .episode_protocol
            .parse()
            .map_err(|error: fiatlux_rules::UnknownProtocol| value("episode_protocol")(error.to_string()))?,
        ends_on: ends_on.map_err(|error| value("end_on")(error.to_string()))?,
        model_digest: header.model_digest.clone(),
        scene_digest: header.scene_digest.clone(),
        // A generator named after it draws the rooms, which the layout seed stands for.
        generator: header.random.split(", ").next().unwrap_or_default().into(),
    })
}

fn drive(drive: &v3::JointDrive) -> JointDrive {
    JointDrive {
        stiffness: drive.stiffness,
        damping: drive.damping,
        effort_limit: drive.effort_limit,
        speed_limit: drive.speed_limit.unwrap_or(f64::INFINITY),
        armature: drive.armature,
    }
}

pub fn drive_message(drive: &JointDrive) -> v3::JointDrive {
    v3::JointDrive {
        stiffness: drive.stiffness,
        damping: drive.damping,
        effort_limit: drive.effort_limit,
        speed_limit: drive.speed_limit.is_finite().then_some(drive.speed_limit),
        armature: drive.armature,
    }
}
