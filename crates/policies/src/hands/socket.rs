//! Plug and socket: where a bulb is in relation to its seat, and how the hand is moved so that it gets where it is wanted.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use super::skill::CAP;

/// A plug in relation to its seat.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plug {
    /// Out of the socket, world.
    pub axis: Unit<Vector3<f64>>,
    /// Plug point, world, m.
    pub point: Vector3<f64>,
    /// Along the axis from the seat, m; positive outside.
    pub gap: f64,
    /// Across it, world, m.
    pub aside: Vector3<f64>,
    /// The shortest turn that brings the bulb's axis to that of the socket.
    pub turn: UnitQuaternion<f64>,
}

impl Plug {
    pub fn measure(socket: &Isometry3<f64>, bulb: &Isometry3<f64>) -> Self {
        let axis = socket.rotation * Vector3::z_axis();
        let end = |pose: &Isometry3<f64>| (pose * Point3::new(0.0, 0.0, CAP)).coords;
        let (point, seat) = (end(bulb), end(socket));
        let gap = (point - seat).dot(&axis);
        let turn = UnitQuaternion::rotation_between(&(bulb.rotation * Vector3::z()), &axis).unwrap_or_default();
        Self { axis, point, gap, aside: point - seat - axis.scale(gap), turn }
    }

    /// Change of poses in the world, a share of what brings the plug to a gap and beside the axis by an offset.
    pub fn change(&self, gap: f64, offset: &Vector3<f64>, share: f64) -> Isometry3<f64> {
        let shift = share * (self.axis.scale(gap - self.gap) - self.aside + offset);
        let turn = UnitQuaternion::from_scaled_axis(share * self.turn.scaled_axis());
        Translation3::from(self.point + shift) * turn * Translation3::from(-self.point)
    }
}
