//! The arm that works, and its hand.

use std::ops::Range;

use fiatlux_robot::Robot;
use fiatlux_wbc::{ARMS, MOVED};

/// The frame of a right hand whose robot has no grasp of its own. Its x axis comes out of the back of the hand, the fingers point
/// along -y; that of the left hand is its mirror image through z.
pub(super) const HAND: &str = "right_hand_base_link";

/// The arm that works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Side {
    Left,
    #[default]
    Right,
}

impl Side {
    /// Joints of the arm in the session's order.
    pub fn joints(self) -> Range<usize> {
        let first = MOVED + self as usize * (ARMS / 2);
        first..first + ARMS / 2
    }

    /// A number of the right side of which the left one has the mirror image: a way to the left, or a turn about an axis ahead or up.
    pub fn mirrored(self, number: f64) -> f64 {
        match self {
            Self::Left => -number,
            Self::Right => number,
        }
    }
}

/// The link in whose frame grasps of the right hand are given.
pub(crate) fn hand_link(robot: &Robot) -> Option<usize> {
    robot.bulb_grasp().map(|grasp| grasp.link).or_else(|| robot.link_index(HAND))
}

/// The same of either hand.
pub(super) fn hand_of(robot: &Robot, side: Side) -> Option<usize> {
    let right = hand_link(robot)?;
    match side {
        Side::Right => Some(right),
        Side::Left => robot.link_index(&robot.links()[right].name.replacen("right", "left", 1)),
    }
}
