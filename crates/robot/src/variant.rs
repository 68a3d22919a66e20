//! A robot made from another one: joints welded, others that follow, drives with another limit. The files of `robots/` that name a base state
//! the rules.

use std::collections::BTreeMap;

use nalgebra::UnitQuaternion;
use serde::Deserialize;

use crate::digest::{digested, sha256_hex};
use crate::file::CoupleDef;
use crate::locate::{Step, line_at};
use crate::refuse::Refuse;
use crate::{Follows, Gains, JointGroups, Robot, RobotError};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariantFile {
    name: String,
    base: String,
    hand: String,
    #[serde(default)]
    weld_below: Vec<String>,
    #[serde(default)]
    effort_limits: BTreeMap<String, f64>,
    #[serde(default)]
    couple: Vec<CoupleDef>,
    checks: VariantChecks,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariantChecks {
    joint_count: usize,
    hand_links: usize,
    #[serde(default)]
    followers: usize,
}

/// Reads a file that names a base; `text_of` gives the text of a robot by its name.
pub(crate) fn load(
    text: &str,
    text_of: impl Fn(&str) -> Result<&'static str, RobotError>,
) -> Result<Robot, RobotError> {
    let file: VariantFile = toml::from_str(text).map_err(|error| RobotError::Syntax {
        line: error.span().map_or(1, |span| line_at(text, span.start)),
        problem: error.message().trim_end().into(),
    })?;
    let refuse = Refuse { text, robot: &file.name };
    let base_text = text_of(&file.base).map_err(|e| refuse.at(&[Step::Key("base")], "base", e.to_string()))?;
    let base = crate::load::load(base_text)?;
    let names: Vec<&str> = base.links.iter().map(|link| link.name.as_str()).collect();
    let mut roots = Vec::new();
    for (i, name) in file.weld_below.iter().enumerate() {
        let path = [Step::Key("weld_below"), Step::Index(i)];
        roots.push(refuse.find(&names, name, "link", "weld_below", &path)?);
    }
    let mut robot = Robot {
        name: file.name.clone(),
        hand: file.hand,
        digest: sha256_hex(&[text, digested(base_text)]),
        ..weld(base, &roots)
    };
    couple(&mut robot, &file.couple, &refuse)?;
    limit(&mut robot, &file.effort_limits, &refuse)?;
    let followers = robot.joints.iter().filter(|joint| joint.follows.is_some()).count();
    for (key, stated, found) in [
        ("joint_count", file.checks.joint_count, robot.joints.len()),
        ("hand_links", file.checks.hand_links, robot.hand_links.len()),
        ("followers", file.checks.followers, followers),
    ] {
        if stated != found {
            let problem = format!("is {stated}, the rules leave {found}; correct one of them");
            return Err(refuse.at(&[Step::Key("checks"), Step::Key(key)], key, problem));
        }
    }
    Ok(robot)
}

/// Lets joints follow others: they lose their drives, their angle in the standing posture and their part in a grasp.
fn couple(robot: &mut Robot, defs: &[CoupleDef], refuse: &Refuse<'_>) -> Result<(), RobotError> {
    crate::couple::couple(&mut robot.joints, &robot.links, defs, refuse)?;
    for (index, joint) in robot.joints.iter_mut().enumerate().filter(|(_, joint)| joint.follows.is_some()) {
        for gains in [&mut joint.gains, &mut robot.sonic.0[index]] {
            (gains.stiffness, gains.damping) = (0.0, 0.0);
        }
    }
    for (joint, q0) in robot.joints.iter().zip(&mut robot.q0) {
        *q0 = q0.clamp(joint.lower, joint.upper);
    }
    let mut q0 = std::mem::take(&mut robot.q0);
    robot.follow(&mut q0);
    robot.q0 = q0;
    if let Some(grasp) = &mut robot.bulb_grasp {
        grasp.grip.retain(|(joint, _)| robot.joints[*joint].follows.is_none());
        for (joint, angle) in &mut grasp.grip {
            *angle = angle.clamp(robot.joints[*joint].lower, robot.joints[*joint].upper);
        }
    }
    Ok(())
}

/// Gives drives another effort limit, in all sets of gains.
fn limit(robot: &mut Robot, limits: &BTreeMap<String, f64>, refuse: &Refuse<'_>) -> Result<(), RobotError> {
    const TABLE: &str = "effort_limits";
    for (name, &limit) in limits {
        let path = [Step::Key(TABLE), Step::Key(name)];
        let names: Vec<&str> = robot.joints.iter().map(|joint| joint.name.as_str()).collect();
        let index = refuse.find(&names, name, "joint", TABLE, &path)?;
        refuse.follower(&robot.joints, index, TABLE, &path)?;
        if !(limit > 0.0 && limit <= 1e6) {
            let problem = format!("gives joint '{name}' {limit} N m; it must be positive and at most 1e6");
            return Err(refuse.at(&path, TABLE, problem));
        }
        for gains in [&mut robot.joints[index].gains, &mut robot.sonic.0[index]] {
            gains.effort_limit = limit;
        }
    }
    Ok(())
}

/// Fixes every joint below the given links at its angle of the standing posture, without the shapes and the sensed links
/// there.
fn weld(mut robot: Robot, roots: &[usize]) -> Robot {
    // Parents stand above their children. A root carries what is fixed to it: nothing there is welded.
    let (mut is_root, mut below) = (vec![false; robot.links.len()], vec![false; robot.links.len()]);
    for (index, link) in robot.links.iter().enumerate() {
        let (parent_is_root, parent_below) = link.parent.map_or((false, false), |p| (is_root[p], below[p]));
        is_root[index] = roots.contains(&index) || (parent_is_root && link.joint.is_none());
        below[index] = parent_below || (parent_is_root && link.joint.is_some());
    }
    let mut kept_joints = Vec::new();
    for (index, link) in robot.links.iter_mut().enumerate() {
        let Some(joint) = link.joint else { continue };
        if below[index] {
            let turn = UnitQuaternion::from_axis_angle(&robot.joints[joint].axis, robot.q0[joint]);
            link.parent_from_link *= turn;
            link.joint = None;
        } else {
            kept_joints.push(joint);
        }
    }
    kept_joints.sort_unstable();
    let JointGroups { legs, ankles, waist, fingers } = &mut robot.joint_groups;
    for group in [legs, ankles, waist, fingers] {
        *group = group.iter().filter_map(|joint| kept_joints.binary_search(joint).ok()).collect();
    }
    for link in &mut robot.links {
        link.joint = link.joint.and_then(|joint| kept_joints.binary_search(&joint).ok());
    }
    robot.joints = kept_joints.iter().map(|&joint| robot.joints[joint].clone()).collect();
    for joint in &mut robot.joints {
        // A follower hangs below its leader, so it is welded where that one is.
        joint.follows = joint.follows.and_then(|of| {
            let leader = kept_joints.binary_search(&of.leader).ok()?;
            Some(Follows { leader, ..of })
        });
    }
    robot.q0 = kept_joints.iter().map(|&joint| robot.q0[joint]).collect();
    robot.sonic = Gains(kept_joints.iter().map(|&joint| robot.sonic.0[joint]).collect());
    robot.shapes.retain(|shape| !below[shape.link]);
    robot.hand_links.retain(|&link| !below[link]);
    robot
}
