//! Rows that a caller gives are of states that a robot in a room can reach.

use std::ops::RangeInclusive;

use fiatlux_robot::{Joint, JointGains};
use fiatlux_rules::{By, Field, Motion, Row, manifest};
use fiatlux_world::{ACTION_LIMIT, Scene, World};

/// Largest angle of a joint, or of its target, beyond the joint's limits, rad: impacts push it there.
const JOINT_MARGIN: f64 = 0.5;
/// Largest distance of a joint that follows another from where that one has it, rad: rounding in another program.
const COUPLING: f64 = 1e-6;
/// Speed of a joint, rad/s, several times the rated one of any motor; a finger, which has none, may be struck to 1000 rad/s.
const JOINT_SPEED: f64 = 200.0;
const FINGER_SPEED: f64 = 1000.0;
/// Effort of a drive beyond its limit, as a factor: rounding.
const EFFORT_MARGIN: f64 = 1.001;
/// Speed of a body, m/s and rad/s; a fall from the ceiling ends at 7 m/s.
const SPEED: f64 = 100.0;
const TURN: f64 = 1000.0;
/// Distance of a body from the middle of the room, m.
const DISTANCE: f64 = 1000.0;
/// Depth of contact points, m.
const PENETRATION: f64 = 10.0;
/// Contact force, N: the whole robot stopped in one physics step at [`SPEED`] has a tenth of it.
const FORCE: f64 = 1e7;
/// Largest depth of a link's or a thing's own frame below the floor, m.
const DEPTH: f64 = 0.1;

/// Refuses a row whose numbers no episode reaches, in words that name joint or body. `effort_factor` is the largest factor by which a
/// drive of the world differs from its gains.
pub(crate) fn check_row(scene: &Scene, row: &Row, effort_factor: f64) -> Result<(), String> {
    // The world refuses what does not fit.
    if !row.fits(scene.robot_layout()) {
        return Ok(());
    }
    let mut found = Ok(());
    row.visit(&mut |field, numbers| {
        if found.is_ok() {
            found = match field.by {
                By::Joint => check_joints(scene, field.name, numbers, effort_factor),
                _ => check_field(field, numbers),
            };
        }
    });
    found
}

/// A list by joint.
fn check_joints(scene: &Scene, field: &str, numbers: &[f64], effort_factor: f64) -> Result<(), String> {
    let drives = &scene.spec.gains.0;
    for ((joint, drive), number) in scene.robot.joints().iter().zip(drives).zip(numbers) {
        let (range, unit, rule) = joint_bounds(field, joint, drive, effort_factor);
        if !range.contains(number) {
            let number = short(*number);
            return Err(format!("{field} of '{}' is {number}{unit}; {rule}", joint.name));
        }
        if let Some(follows) = joint.follows.filter(|_| field == "joint_position") {
            let (due, leader) = (follows.angle(numbers[follows.leader]), &scene.robot.joints()[follows.leader].name);
            if (number - due).abs() > COUPLING {
                let name = &joint.name;
                return Err(format!("{field} of '{name}' is {number}{unit}; it follows '{leader}', so make it {due}"));
            }
        }
    }
    Ok(())
}

/// Range of a joint's number, its unit, and the remedy.
fn joint_bounds(
    field: &str,
    joint: &Joint,
    drive: &JointGains,
    effort_factor: f64,
) -> (RangeInclusive<f64>, &'static str, String) {
    let within = |most: f64| (-most..=most, format!("give -{most} to {most}"));
    match field {
        "joint_velocity" => {
            let (range, rule) = within(if drive.speed_limit.is_finite() { JOINT_SPEED } else { FINGER_SPEED });
            (range, ", rad/s", rule)
        }
        "joint_effort" => {
            let most = drive.effort_limit * effort_factor;
            (-most * EFFORT_MARGIN..=most * EFFORT_MARGIN, ", N m", within(most).1)
        }
        "action" => {
            let (range, rule) = within(ACTION_LIMIT);
            (range, "", rule)
        }
        // Positions and targets.
        _ => {
            let rule = format!("the joint goes from {} to {}", joint.lower, joint.upper);
            (joint.lower - JOINT_MARGIN..=joint.upper + JOINT_MARGIN, ", rad", rule)
        }
    }
}

/// A field that no joint has: a vector has a largest length.
fn check_field(field: Field<'_>, numbers: &[f64]) -> Result<(), String> {
    let Field { of, name, .. } = field;
    let (part, most, unit) = match name {
        // A world measures these anew where it begins.
        _ if matches!(of, "left_palm" | "right_palm") => return Ok(()),
        "com_velocity" => return Ok(()),
        // Counts, flags and sizes: whole numbers of their types, which layout and world check.
        "step" | "joints" | "hand_bodies" | "present" | "seated" | "steps_beyond" | "unconverged" | "retried" => {
            return Ok(());
        }
        // Infinite where the row's physics broke; its state is the one before.
        "joint_speed_peak" => (name, f64::INFINITY, "rad/s"),
        "quaternion" => return check_quaternion(of, numbers),
        "position" => ("pose", DISTANCE, "m from the middle of the room"),
        "linear_velocity" => (name, SPEED, "m/s"),
        "angular_velocity" => (name, TURN, "rad/s"),
        "penetration" => (name, PENETRATION, "m"),
        _ => (name, FORCE, "N"),
    };
    let name = if of.is_empty() { part.to_owned() } else { format!("{of}_{part}") };
    // The largest number of a list by part, the length of a vector.
    let is_vector = matches!(field.by, By::Axis | By::Part { axes: true, .. });
    let size = if is_vector {
        numbers.iter().fold(0.0_f64, |sum, number| sum.hypot(*number))
    } else {
        numbers.iter().fold(0.0_f64, |most, number| if number.is_nan() { *number } else { most.max(number.abs()) })
    };
    let has_nan = numbers.iter().any(|number| number.is_nan());
    if has_nan || (size.is_infinite() && most.is_finite()) {
        return Err(format!("{name} is not finite"));
    }
    if size > most {
        return Err(format!("{name} is {} {unit}; give at most {most}", short(size)));
    }
    Ok(())
}

fn check_quaternion(of: &str, numbers: &[f64]) -> Result<(), String> {
    let length = numbers.iter().fold(0.0_f64, |sum, number| sum.hypot(*number));
    if length.is_nan() || (length - 1.0).abs() > 1e-6 {
        let length = short(length);
        return Err(format!("{of}_pose has a quaternion of length {length}; divide w, x, y, z by it to make it 1"));
    }
    Ok(())
}

/// A number in a few characters: 1e200 has no 201 digits.
fn short(number: f64) -> String {
    if number.abs() < 1e9 { number.to_string() } else { format!("{number:?}") }
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
