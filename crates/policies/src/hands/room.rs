//! Obstacles of the arm on the platform: guard rail, fixture, the wall that it stands out of, and the bulb in the socket
//! or in the hand.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_rules::Bulb;
use nalgebra::{Isometry3, Vector3};

use super::arm::hand_link;
use super::shape::{BULB_NAME, SOCKET_NAME, Shape, Surroundings};
use super::skill::{CAP, Seen};

/// Heights above the seat: of the stop for the plug, and of the mouth, m. These and all sizes below are those of
/// `crates/world/scene.toml`.
pub(super) const STOP: f64 = 0.002;
pub(super) const MOUTH: f64 = 0.0342;
/// Height of the glass's centre on the bulb's axis, m.
pub(super) const GLASS: f64 = 0.1531;
/// Balls swept along the bulb's axis: from, to, radius, m.
const BULB: [[f64; 3]; 4] =
    [[0.0533, 0.0715, 0.0170], [0.0858, 0.1140, 0.0248], [0.1375, 0.1375, 0.0345], [0.1531, 0.1531, 0.0396]];
/// Half extents of the fixture's housing and of its collar, m.
const HOUSING: [f64; 2] = [0.074, 0.081];
const COLLAR: f64 = 0.034;
/// Of rods and bars, m, and length of the rod, which ends above the ceiling.
const ROD: f64 = 0.012;
const ROD_LENGTH: f64 = 1.9;
const RAIL: f64 = 0.016;
/// Guard rail in the ladder's frame: half its width, y, lower and upper end of its uprights, m.
const GUARD: [f64; 4] = [0.288, 0.27, 1.15, 1.845];
/// Half extents of a wall, m.
const WALL: [f64; 3] = [3.0, 3.0, 0.05];

/// A bulb in its own frame.
pub(super) fn bulb() -> Vec<Shape> {
    let axial = |z: f64| Vector3::new(0.0, 0.0, z);
    let part = |(index, [from, to, radius]): (usize, [f64; 3])| {
        Shape::capsule(format!("{BULB_NAME}{index}"), axial(from), axial(to), radius)
    };
    BULB.into_iter().enumerate().map(part).collect()
}

/// The guard rail in the ladder's frame.
pub(super) fn guard_rail() -> Vec<Shape> {
    let [x, y, low, high] = GUARD;
    let end = |x: f64, z: f64| Vector3::new(x, y, z);
    vec![
        Shape::capsule("upright_left", end(-x, low), end(-x, high), RAIL),
        Shape::capsule("upright_right", end(x, low), end(x, high), RAIL),
        Shape::capsule("guard_bar", end(-x, high), end(x, high), RAIL),
    ]
}

/// The fixture in its frame, and the wall behind it unless it hangs.
pub(super) fn fixture(hangs: bool) -> Vec<Shape> {
    let [x, y] = HOUSING;
    let (stop, mouth) = (CAP + STOP, CAP + MOUTH);
    let mut shapes = vec![
        Shape::cuboid(&format!("{SOCKET_NAME}housing"), Vector3::z() * stop / 2.0, Vector3::new(x, y, stop / 2.0)),
        Shape::cuboid(
            &format!("{SOCKET_NAME}collar"),
            Vector3::z() * (stop + mouth) / 2.0,
            Vector3::new(COLLAR, COLLAR, (mouth - stop) / 2.0),
        ),
    ];
    shapes.push(if hangs {
        Shape::capsule("rod", Vector3::z() * -ROD, Vector3::z() * -ROD_LENGTH, ROD)
    } else {
        Shape::cuboid("wall", Vector3::z() * -WALL[2], Vector3::from(WALL))
    });
    shapes
}

/// Surroundings of a robot on the platform that has the fresh bulb in its hand, or the old one before it in the socket.
pub(super) fn on_platform(
    info: &SessionInfo,
    first: &Observation,
    seen: &Seen,
    handled: Bulb,
) -> Result<Surroundings, PolicyError> {
    let at = |pose: Isometry3<f64>| move |shape: Shape| (shape, pose);
    let hangs = (seen.socket.rotation * Vector3::z()).z.abs() > 0.5;
    let mut around = Surroundings::default();
    around.in_world.extend(guard_rail().into_iter().map(at(seen.ladder)));
    around.in_world.extend(fixture(hangs).into_iter().map(at(seen.socket)));
    match handled {
        Bulb::Old => around.in_world.extend(bulb().into_iter().map(at(seen.socket))),
        Bulb::Fresh => {
            let hand_from_bulb = world_from_hand(info, first, seen)?.inv_mul(&seen.fresh_bulb);
            around.in_hand.extend(bulb().into_iter().map(at(hand_from_bulb)));
        }
    }
    Ok(around)
}

fn world_from_hand(info: &SessionInfo, first: &Observation, seen: &Seen) -> Result<Isometry3<f64>, PolicyError> {
    let names = info.joints.iter().map(|joint| joint.name.as_str());
    let robot = Robot::with_joints(names).map_err(PolicyError::of("hands"))?;
    let turned = first.proprioception.as_ref().map(|body| body.joint_position.as_slice()).unwrap_or_default();
    let angles: Vec<f64> =
        info.joints.iter().zip(turned).map(|(joint, turned)| joint.q0 + f64::from(*turned)).collect();
    let links = robot.forward_kinematics(&angles, &seen.pelvis).map_err(PolicyError::of("hands"))?;
    Ok(hand_link(&robot).map_or(seen.pelvis, |link| links[link]))
}
