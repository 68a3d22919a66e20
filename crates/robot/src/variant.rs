//! A robot made from another one by welding joints; `g1_bare.toml` states the rules.

use nalgebra::UnitQuaternion;
use serde::Deserialize;

use crate::digest::{digested, sha256_hex};
use crate::locate::{Step, line_at};
use crate::refuse::Refuse;
use crate::{Gains, JointGroups, Robot, RobotError};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariantFile {
    name: String,
    base: String,
    hand: String,
    weld_below: Vec<String>,
    checks: VariantChecks,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct VariantChecks {
    joint_count: usize,
    hand_links: usize,
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
    let robot = Robot {
        name: file.name.clone(),
        hand: file.hand,
        digest: sha256_hex(&[text, digested(base_text)]),
        ..weld(base, &roots)
    };
    for (key, stated, found) in [
        ("joint_count", file.checks.joint_count, robot.joints.len()),
        ("hand_links", file.checks.hand_links, robot.hand_links.len()),
    ] {
        if stated != found {
            let problem = format!("is {stated}, the rules leave {found}; correct one of them");
            return Err(refuse.at(&[Step::Key("checks"), Step::Key(key)], key, problem));
        }
    }
    Ok(robot)
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
    robot.q0 = kept_joints.iter().map(|&joint| robot.q0[joint]).collect();
    robot.sonic = Gains(kept_joints.iter().map(|&joint| robot.sonic.0[joint]).collect());
    robot.shapes.retain(|shape| !below[shape.link]);
    robot.hand_links.retain(|&link| !below[link]);
    robot
}
