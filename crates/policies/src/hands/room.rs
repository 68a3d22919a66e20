//! Obstacles of the arm on the platform: guard rail, fixture, the wall that it stands out of, and the bulb in the socket
//! or in the hand.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_room::{bulb, fixture, ladder};
use fiatlux_skills::path::Map;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::shape::{BULB_NAME, SOCKET_NAME, Shape, Surroundings};
use super::side::hand_link;
use super::skill::{CAP, Seen};

/// Length of the rod from which a fixture hangs, m: it ends above the ceiling.
const ROD_LENGTH: f64 = 1.9;
/// Half extents of a wall, m.
const WALL: [f64; 3] = [3.0, 3.0, 0.05];
/// Heights between which things are in the way of the arms of a robot on the platform, m.
pub(crate) const AT_THE_PLATFORM: [f64; 2] = [1.2, 2.6];
/// Reach of an arm from the pelvis, m; distance of a socket from the wall that it is at; and where the left arm is held out, from the pelvis,
/// with the room that it needs there.
const REACH: f64 = 0.9;
const ON_WALL: f64 = 0.1;
const TO_THE_LEFT: f64 = 0.35;
const LEFT_ARM: f64 = 0.3;
/// Least half extent of a wall, and largest coordinate of a corner, m.
const MIN_M: f64 = 1e-3;
const MAX_M: f64 = 100.0;

/// A bulb in its own frame.
pub(super) fn bulb_shapes() -> Vec<Shape> {
    let axial = |z: f64| Vector3::new(0.0, 0.0, z);
    let part = |(index, [from, to, radius]): (usize, [f64; 3])| {
        Shape::capsule(format!("{BULB_NAME}{index}"), axial(from), axial(to), radius)
    };
    bulb::SOLIDS.into_iter().enumerate().map(part).collect()
}

/// The guard rail in the ladder's frame.
pub(super) fn guard_rail() -> Vec<Shape> {
    let rail = ladder::RAIL_RADIUS;
    let [x, low, high] = [ladder::SIZE[0] / 2.0 - rail, ladder::LEG_TOP[1], ladder::SIZE[2] - rail];
    let end = |x: f64, z: f64| Vector3::new(x, ladder::GUARD_Y, z);
    vec![
        Shape::capsule("upright_left", end(-x, low), end(-x, high), rail),
        Shape::capsule("upright_right", end(x, low), end(x, high), rail),
        Shape::capsule("guard_bar", end(-x, high), end(x, high), rail),
    ]
}

/// The fixture in its frame, and the wall behind it unless it hangs.
pub(super) fn fixture_shapes(hangs: bool) -> Vec<Shape> {
    let ([x, y], collar) = (fixture::BASE_HALF, fixture::COLLAR_HALF);
    let (stop, mouth) = (CAP + fixture::STOP_HEIGHT, CAP + fixture::MOUTH_HEIGHT);
    let mut shapes = vec![
        Shape::cuboid(&format!("{SOCKET_NAME}housing"), Vector3::z() * stop / 2.0, Vector3::new(x, y, stop / 2.0)),
        Shape::cuboid(
            &format!("{SOCKET_NAME}collar"),
            Vector3::z() * (stop + mouth) / 2.0,
            Vector3::new(collar, collar, (mouth - stop) / 2.0),
        ),
    ];
    shapes.push(if hangs {
        Shape::capsule("rod", Vector3::z() * -fixture::ROD_RADIUS, Vector3::z() * -ROD_LENGTH, fixture::ROD_RADIUS)
    } else {
        Shape::cuboid("wall", Vector3::z() * -WALL[2], Vector3::from(WALL))
    });
    shapes
}

/// Surroundings of a robot on the platform, without a bulb.
fn platform(seen: &Seen) -> Surroundings {
    let mut around = Surroundings::default();
    around.in_world.extend(guard_rail().into_iter().map(at(seen.ladder)));
    around.in_world.extend(fixture_shapes(seen.hangs()).into_iter().map(at(seen.socket)));
    around
}

/// Walls and pillars that the arms of a robot on the platform may reach, but for the one of the fixture.
#[derive(Clone, Default)]
pub(super) struct Walls {
    shapes: Vec<(Shape, Isometry3<f64>)>,
    are_at_the_left: bool,
}

impl Walls {
    pub fn of(info: &SessionInfo, seen: &Seen) -> Self {
        let at = |pose: &Isometry3<f64>| [pose.translation.x, pose.translation.y];
        let left = seen.pelvis.translation.vector + seen.pelvis.rotation * (Vector3::y() * TO_THE_LEFT);
        let mut walls = Self::default();
        for (index, (name, corners)) in
            Map::outlines(info, AT_THE_PLATFORM).enumerate().filter(|(_, (name, _))| name != "fixture")
        {
            let Some(block) = block(&format!("room_{index}"), &corners) else { continue };
            let outline = Map::new(std::iter::once((name, corners)), 0.0);
            if outline.clearance(at(&seen.socket)) > ON_WALL && outline.clearance(at(&seen.pelvis)) < REACH {
                walls.are_at_the_left |= outline.clearance([left.x, left.y]) < LEFT_ARM;
                walls.shapes.push(block);
            }
        }
        walls
    }

    /// Surroundings with these walls.
    pub fn and(&self, mut around: Surroundings) -> Surroundings {
        around.in_world.extend(self.shapes.iter().cloned());
        around.left_is_drawn_in = self.are_at_the_left;
        around
    }
}

/// A block around the corners of an outline, its sides along the first of its edges. `None` for one that no room has.
fn block(name: &str, corners: &[[f64; 2]]) -> Option<(Shape, Isometry3<f64>)> {
    let [first, second, ..] = corners else { return None };
    let turn = libm::atan2(second[1] - first[1], second[0] - first[0]);
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    let [mut low, mut high] = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
    for corner in
        corners.iter().flat_map(|[x, y]| AT_THE_PLATFORM.map(|z| rotation.inverse() * Vector3::new(*x, *y, z)))
    {
        (low, high) = (low.inf(&corner), high.sup(&corner));
    }
    let (half, middle) = ((high - low) / 2.0, rotation * ((low + high) / 2.0));
    let is_block = corners.as_flattened().iter().all(|number| number.abs() < MAX_M) && half.min() > MIN_M;
    is_block.then(|| (Shape::cuboid(name, Vector3::zeros(), half), Isometry3::from_parts(middle.into(), rotation)))
}

fn at(pose: Isometry3<f64>) -> impl Fn(Shape) -> (Shape, Isometry3<f64>) {
    move |shape| (shape, pose)
}

/// Surroundings of a robot on the platform that has a bulb before it in the socket.
pub(super) fn with_bulb_in_socket(seen: &Seen) -> Surroundings {
    let mut around = platform(seen);
    around.in_world.extend(bulb_shapes().into_iter().map(at(seen.socket)));
    around
}

/// Surroundings of a robot on the platform that has a bulb in its hand.
pub(super) fn with_bulb_in_hand(seen: &Seen, hand_from_bulb: Isometry3<f64>) -> Surroundings {
    let mut around = platform(seen);
    around.in_hand.extend(bulb_shapes().into_iter().map(at(hand_from_bulb)));
    around
}

/// Pose of the hand in an observation.
pub(super) fn world_from_hand(
    info: &SessionInfo,
    first: &Observation,
    seen: &Seen,
) -> Result<Isometry3<f64>, PolicyError> {
    let names = info.joints.iter().map(|joint| joint.name.as_str());
    let robot = Robot::of_session(&info.robot, names).map_err(PolicyError::of("hands"))?;
    let turned = first.proprioception.as_ref().map(|body| body.joint_position.as_slice()).unwrap_or_default();
    let angles: Vec<f64> =
        info.joints.iter().zip(turned).map(|(joint, turned)| joint.q0 + f64::from(*turned)).collect();
    let links = robot.forward_kinematics(&angles, &seen.pelvis).map_err(PolicyError::of("hands"))?;
    Ok(hand_link(&robot).map_or(seen.pelvis, |link| links[link]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_around_a_turned_wall_and_around_nothing_else() {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.4);
        let corners = [[-1.0, -0.1], [1.0, -0.1], [1.0, 0.1], [-1.0, 0.1]];
        let placed = corners.map(|[x, y]| turned * Vector3::new(x, y, 0.0) + Vector3::new(3.0, 2.0, 0.0));
        let (_, pose) = block("wall", &placed.map(|corner| [corner.x, corner.y])).expect("a wall");
        let [low, high] = AT_THE_PLATFORM;
        assert!((pose.translation.vector - Vector3::new(3.0, 2.0, (low + high) / 2.0)).norm() < 1e-9);
        assert!(pose.rotation.angle_to(&turned) < 1e-9);
        let outlines: [&[[f64; 2]]; 6] = [
            &[],
            &[[0.0, 0.0]],
            &[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
            &[[0.0, f64::NAN], [1.0, 0.0], [1.0, 1.0]],
            &[[0.0, 0.0], [f64::INFINITY, 0.0], [1.0, 1.0]],
            &[[0.0, 0.0], [1e300, 0.0], [1.0, 1.0]],
        ];
        assert!(outlines.iter().all(|outline| block("wall", outline).is_none()));
    }
}
