//! What a collision shape counts as where contact forces are summed.

use fiatlux_dynamics::{Geometry, ShapeSpec};
use fiatlux_robot::Robot;
use fiatlux_rules::{Bulb, HIGH_TREAD_HEIGHT, Support};

use crate::owner::ShapeOwner;
use crate::scene::{Scene, is_below};

/// Things besides hands that press on a bulb.
pub(super) const OTHER_THINGS: usize = 5;

/// Whose a shape is, as far as forces go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Thing {
    Floor,
    /// `high`: a tread from the second on, or the platform.
    Ladder {
        high: bool,
    },
    /// Furniture, walls and socket.
    Room,
    Bulb(u8),
    Robot,
}

impl Thing {
    /// Whose forces on a bulb are summed together.
    pub fn group(self) -> usize {
        match self {
            Thing::Floor => 0,
            Thing::Ladder { .. } => 1,
            Thing::Room => 2,
            Thing::Bulb(_) => 3,
            Thing::Robot => 4,
        }
    }
}

/// A shape, and the sensed parts of the robot that it belongs to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sensed {
    pub thing: Thing,
    /// Index of the sensed hand body, if it is one.
    pub hand: Option<u8>,
    /// Index of the foot or palm, if it is one.
    pub limb: Option<u8>,
    /// Index of the foot or arm, if it may carry the robot.
    pub support: Option<u8>,
}

impl Sensed {
    pub fn new(scene: &Scene, shape: &ShapeSpec) -> Self {
        let robot = &scene.robot;
        let index = |links: &[usize], link: usize| links.iter().position(|l| *l == link).map(|i| i as u8);
        let of = |thing| Self { thing, hand: None, limb: None, support: None };
        match ShapeOwner::from_label(shape.label) {
            ShapeOwner::Floor => of(Thing::Floor),
            ShapeOwner::Ladder => of(Thing::Ladder { high: is_high_tread(scene, shape) }),
            ShapeOwner::Room | ShapeOwner::Bench | ShapeOwner::Crate | ShapeOwner::Fixture => of(Thing::Room),
            ShapeOwner::OldBulb => of(Thing::Bulb(Bulb::Old as u8)),
            ShapeOwner::FreshBulb => of(Thing::Bulb(Bulb::Fresh as u8)),
            ShapeOwner::Robot(link) => Self {
                thing: Thing::Robot,
                hand: index(robot.hand_links(), link),
                limb: index(robot.feet(), link).or_else(|| index(robot.palms(), link).map(|palm| palm + 2)),
                support: support(robot, link),
            },
        }
    }
}

/// Treads and platform are the ladder's boxes; rails, legs and guard are round. A ladder of another size has its treads
/// elsewhere: what counts is the nominal height.
fn is_high_tread(scene: &Scene, shape: &ShapeSpec) -> bool {
    let Geometry::Cuboid { half_extents } = shape.geometry else { return false };
    let in_ladder = match scene.ladder {
        Some(_) => shape.body_from_shape,
        None => scene.world_from_ladder.inverse() * shape.body_from_shape,
    };
    let top = in_ladder.translation.z + half_extents.z;
    top / scene.spec.scale.ladder[2] > HIGH_TREAD_HEIGHT - 1e-6
}

/// The foot, or the arm from the elbow down, that a link is part of.
fn support(robot: &Robot, link: usize) -> Option<u8> {
    let [left_foot, right_foot] = [0, 1].map(|i| robot.feet().get(i).copied());
    // The first hand body of a side is the wrist; the forearm carries it.
    let hands = robot.hand_links();
    let forearm = |first: usize| hands.get(first).and_then(|&wrist| robot.links()[wrist].parent);
    let supports = [
        (left_foot, Support::LeftFoot),
        (right_foot, Support::RightFoot),
        (forearm(hands.len() / 2), Support::LeftArm),
        (forearm(0), Support::RightArm),
    ];
    let is_part_of = |top: Option<usize>| top.is_some_and(|top| is_below(robot, link, top));
    supports.into_iter().find(|(top, _)| is_part_of(*top)).map(|(_, support)| support as u8)
}
