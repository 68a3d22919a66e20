//! Frames on the floor.

use fiatlux_skills::path::{Point, wrapped};
use nalgebra::{Isometry3, Vector3};

/// x, y and heading of one frame in another, on the floor.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Planar {
    pub at: Point,
    pub heading: f64,
}

impl Planar {
    /// Of a pose.
    pub fn of(pose: &Isometry3<f64>) -> Self {
        let ahead = pose.rotation * Vector3::x();
        Self { at: [pose.translation.x, pose.translation.y], heading: libm::atan2(ahead.y, ahead.x) }
    }

    /// A point of this frame.
    pub fn point(&self, [x, y]: Point) -> Point {
        let turned = turned(self.heading, [x, y]);
        [self.at[0] + turned[0], self.at[1] + turned[1]]
    }

    /// A frame of this frame in the one that this frame is in.
    pub fn times(&self, other: &Self) -> Self {
        Self { at: self.point(other.at), heading: wrapped(self.heading + other.heading) }
    }

    /// The other frame in this one.
    pub fn inverse(&self) -> Self {
        let [x, y] = turned(-self.heading, self.at);
        Self { at: [-x, -y], heading: -self.heading }
    }
}

pub(super) fn turned(angle: f64, [x, y]: Point) -> Point {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    [cos * x - sin * y, sin * x + cos * y]
}
