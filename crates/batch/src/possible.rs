//! Rows that a caller gives are of states that a robot in a room can reach.

use fiatlux_rules::{Motion, Row, manifest};
use fiatlux_world::{ACTION_LIMIT, Scene, World};

/// Largest angle of a joint beyond its limits, rad: impacts push it there.
const JOINT_MARGIN: f64 = 0.5;
/// Speed of a joint, rad/s, several times the rated one of any motor; a finger, which has none, may be struck to 1000 rad/s.
const JOINT_SPEED: f64 = 200.0;
const FINGER_SPEED: f64 = 1000.0;
/// Speed of a body, m/s and rad/s; a fall from the ceiling ends at 7 m/s.
const SPEED: f64 = 100.0;
const TURN: f64 = 1000.0;
/// Distance of a body from the middle of the room, m.
const DISTANCE: f64 = 1000.0;
/// Largest depth of a link's or a thing's own frame below the floor, m.
const DEPTH: f64 = 0.1;

/// Refuses a row whose numbers no episode reaches, in words that name joint or body.
pub(crate) fn check_row(scene: &Scene, row: &Row) -> Result<(), String> {
    // The world refuses what does not fit.
    if !row.fits(scene.robot_layout()) {
        return Ok(());
    }
    let drives = scene.spec.gains.0.iter();
    for ((index, joint), drive) in scene.robot.joints().iter().enumerate().zip(drives) {
        let (at, name) = (row.joint_position[index], &joint.name);
        if !(joint.lower - JOINT_MARGIN..=joint.upper + JOINT_MARGIN).contains(&at) {
            return Err(format!(
                "joint_position of '{name}' is {at}, rad; the joint goes from {} to {}",
                joint.lower, joint.upper
            ));
        }
        let most = if drive.speed_limit.is_finite() { JOINT_SPEED } else { FINGER_SPEED };
        let speed = row.joint_velocity[index];
        if !(-most..=most).contains(&speed) {
            return Err(format!("joint_velocity of '{name}' is {speed}, rad/s; give -{most} to {most}"));
        }
        let (action, effort, target) = (row.action[index], row.joint_effort[index], row.joint_target[index]);
        if !(-ACTION_LIMIT..=ACTION_LIMIT).contains(&action) {
            return Err(format!("action of '{name}' is {action}; give -{ACTION_LIMIT} to {ACTION_LIMIT}"));
        }
        if !effort.is_finite() || !target.is_finite() {
            return Err(format!("joint_target or joint_effort of '{name}' is not finite"));
        }
    }
    let things = manifest().things.iter().zip(&row.things).zip(&row.present);
    let things = things.filter(|((thing, _), present)| thing.motion == Motion::Free && **present);
    let things = things.map(|((thing, body), _)| (thing.name.as_str(), body));
    for (name, body) in [("robot", &row.robot)].into_iter().chain(things) {
        let quaternion = body.pose.rotation.coords.norm();
        let numbers = [
            ("pose is", body.pose.translation.vector.norm(), DISTANCE, "m from the middle of the room"),
            ("linear_velocity is", body.linear_velocity.norm(), SPEED, "m/s"),
            ("angular_velocity is", body.angular_velocity.norm(), TURN, "rad/s"),
        ];
        for (what, number, most, unit) in numbers {
            if !number.is_finite() {
                return Err(format!("{name}_{what} not finite"));
            }
            if number > most {
                return Err(format!("{name}_{what} {number} {unit}; give at most {most}"));
            }
        }
        if quaternion.is_nan() || (quaternion - 1.0).abs() > 1e-6 {
            return Err(format!(
                "{name}_pose has a quaternion of length {quaternion}; divide w, x, y, z by it to make it 1"
            ));
        }
    }
    Ok(())
}

/// Refuses a state in which something is below the floor. The world is at a row that was given.
pub(crate) fn check_height(world: &World) -> Result<(), String> {
    let scene = world.scene();
    let links = scene.robot.links().iter().enumerate();
    let links = links.map(|(index, link)| (link.name.as_str(), world.world_from_link(index).translation.z));
    let row = world.row();
    let things = manifest().things.iter().zip(&row.things).zip(&row.present);
    let things = things.filter(|((thing, _), present)| thing.motion == Motion::Free && **present);
    let things = things.map(|((thing, body), _)| (thing.name.as_str(), body.pose.translation.z));
    let low = links.chain(things).find(|(_, height)| *height < -DEPTH);
    low.map_or(Ok(()), |(name, height)| {
        Err(format!("'{name}' is {:.3} m below the floor; raise robot_pose or the thing's pose", -height))
    })
}
