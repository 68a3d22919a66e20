//! The socket's hold on a bulb: a snap fitting that pulls the plug to the seat and lets go after a sustained pull.
//!
//! Evaluated once per control step; the wrench is held over its physics steps. Nothing acts about the mating axis.

use fiatlux_dynamics::Wrench;
use fiatlux_rules::measure;
use nalgebra::{Isometry3, Vector3};

use crate::config::AttachmentConfig;

/// State of a bulb in a socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttachmentState {
    /// The socket does not hold the bulb.
    Free,
    /// The socket holds the bulb.
    Seated,
}

/// The socket's hold on one bulb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attachment {
    /// Held or not.
    pub state: AttachmentState,
    /// Consecutive control steps that a held bulb has spent beyond the release gap.
    pub steps_beyond: u32,
}

/// A plug in relation to the socket.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlugState {
    /// Direction out of the socket, world.
    pub axis: Vector3<f64>,
    /// Direction of the bulb's +z, world.
    pub bulb_axis: Vector3<f64>,
    /// Plug point from the seat point along the axis, m; positive outside.
    pub gap: f64,
    /// Plug point from the seat point across the axis, world, m.
    pub lateral: Vector3<f64>,
    /// Angle between the axes, rad.
    pub tilt: f64,
}

impl PlugState {
    /// Measures a bulb against a socket, whose plug and seat point are at `plug_z` and `seat_z` on their axes, m.
    pub fn measure(
        world_from_fixture: &Isometry3<f64>,
        seat_z: f64,
        world_from_bulb: &Isometry3<f64>,
        plug_z: f64,
    ) -> Self {
        let (seat, plug) = (Vector3::new(0.0, 0.0, seat_z), Vector3::new(0.0, 0.0, plug_z));
        let axis = world_from_fixture.rotation * Vector3::z();
        let bulb_axis = world_from_bulb.rotation * Vector3::z();
        let offset = measure::world_point(world_from_bulb, &plug) - measure::world_point(world_from_fixture, &seat);
        let gap = offset.dot(&axis);
        Self { axis, bulb_axis, gap, lateral: offset - gap * axis, tilt: measure::angle_between(&bulb_axis, &axis) }
    }

    /// Distance between plug and seat point, m.
    pub fn distance(&self) -> f64 {
        libm::hypot(self.gap, self.lateral.norm())
    }
}

impl Attachment {
    /// A bulb that the socket does not hold.
    pub const FREE: Self = Self { state: AttachmentState::Free, steps_beyond: 0 };
    /// A bulb that the socket holds and that has not begun to leave.
    pub const SEATED: Self = Self { state: AttachmentState::Seated, steps_beyond: 0 };

    /// True if the socket holds the bulb.
    pub fn is_seated(&self) -> bool {
        self.state == AttachmentState::Seated
    }

    /// One control step of the socket's hold: advances the state and returns the wrench that a held bulb feels over the
    /// step's physics, by [`hold_wrench`] with the velocities of its arguments.
    pub fn hold(
        &mut self,
        law: &AttachmentConfig,
        plug: &PlugState,
        socket_free: bool,
        velocity: &Vector3<f64>,
        angular_velocity: &Vector3<f64>,
    ) -> Option<Wrench> {
        self.advance(law, plug, socket_free);
        self.is_seated().then(|| hold_wrench(law, plug, velocity, angular_velocity))
    }

    /// Advances by one control step. `socket_free` says that the socket holds no other bulb. Neither twist nor speed
    /// matters. Returns the new state where it changed.
    fn advance(&mut self, law: &AttachmentConfig, plug: &PlugState, socket_free: bool) -> Option<AttachmentState> {
        match self.state {
            AttachmentState::Free => {
                let fits = plug.gap.abs() <= law.seat_gap
                    && plug.lateral.norm() < law.seat_lateral
                    && plug.tilt < law.seat_tilt;
                if !(socket_free && fits) {
                    return None;
                }
                *self = Self::SEATED;
            }
            AttachmentState::Seated => {
                self.steps_beyond = if plug.gap > law.release_gap { self.steps_beyond.saturating_add(1) } else { 0 };
                if self.steps_beyond < law.release_steps {
                    return None;
                }
                *self = Self::FREE;
            }
        }
        Some(self.state)
    }
}

/// Wrench on a seated bulb, through and about its centre of mass: a pull along the axis that falls linearly with the
/// gap, a spring across it and a righting torque, all damped and bounded. Zero beyond the hold's reach.
///
/// `velocity` is that of the bulb's centre of mass, m/s; `angular_velocity` in rad/s; both in world axes.
pub fn hold_wrench(
    law: &AttachmentConfig,
    plug: &PlugState,
    velocity: &Vector3<f64>,
    angular_velocity: &Vector3<f64>,
) -> Wrench {
    if plug.gap >= law.hold_range || plug.lateral.norm() >= law.seat_lateral {
        return Wrench { force: Vector3::zeros(), torque: Vector3::zeros() };
    }
    let across = |v: &Vector3<f64>| v - v.dot(&plug.axis) * plug.axis;
    let pull = law.hold_force * (1.0 - plug.gap.max(0.0) / law.hold_range).max(0.0);
    let axial = (-pull - law.axial_damping * velocity.dot(&plug.axis)).clamp(-law.axial_limit, law.axial_limit);
    let lateral = -law.lateral_stiffness * plug.lateral - law.lateral_damping * across(velocity);
    let torque = law.tilt_stiffness * plug.bulb_axis.cross(&plug.axis) - law.tilt_damping * across(angular_velocity);
    Wrench { force: axial * plug.axis + bounded(lateral, law.lateral_limit), torque: bounded(torque, law.torque_limit) }
}

fn bounded(v: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let norm = v.norm();
    if norm > limit { v * (limit / norm) } else { v }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::SceneConfig;

    const AT_REST: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

    fn law() -> AttachmentConfig {
        SceneConfig::default().attachment
    }

    /// A plug at (lateral x, gap) mm below a socket that opens downwards, tilted about x.
    fn plug(lateral_mm: f64, gap_mm: f64, tilt: f64) -> PlugState {
        let seat_z = 0.036259;
        let fixture = Isometry3::new(Vector3::new(1.0, 2.0, 2.2), Vector3::new(0.0, std::f64::consts::PI, 0.0));
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::x() * tilt);
        let point = Vector3::new(lateral_mm * 1e-3, 0.0, seat_z + gap_mm * 1e-3);
        let offset = point - rotation * Vector3::new(0.0, 0.0, seat_z);
        PlugState::measure(&fixture, seat_z, &(fixture * Isometry3::from_parts(offset.into(), rotation)), seat_z)
    }

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-9, "{a} is not {b}");
    }

    #[test]
    fn measures_gap_lateral_and_tilt() {
        let plug = plug(3.0, -2.0, 0.15);
        near(plug.gap, -0.002);
        near(plug.lateral.norm(), 0.003);
        near(plug.tilt, 0.15);
        near(plug.distance(), 0.002_f64.hypot(0.003));
        near(plug.axis.z, -1.0);
    }

    #[test]
    fn pull_falls_linearly_with_the_gap() {
        for (gap_mm, newton) in
            [(-2.0, 1.5), (0.0, 1.5), (5.0, 1.2), (15.0, 0.6), (24.999, 6e-5), (25.0, 0.0), (40.0, 0.0)]
        {
            let wrench = hold_wrench(&law(), &plug(0.0, gap_mm, 0.0), &AT_REST, &AT_REST);
            near(wrench.force.z, newton);
            near(wrench.force.xy().norm() + wrench.torque.norm(), 0.0);
        }
    }

    /// The published sizing: a hanging bulb's weight equals the pull at 19.3 mm.
    #[test]
    fn weight_crosses_the_pull_at_19_3_mm() {
        let pull = |gap_mm| hold_wrench(&law(), &plug(0.0, gap_mm, 0.0), &AT_REST, &AT_REST).force.z;
        let weight = 0.035 * 9.81;
        assert!(pull(19.25) > weight && pull(19.35) < weight);
    }

    #[test]
    fn forces_and_torques_are_damped_and_bounded() {
        let law = law();
        let outwards = Vector3::new(0.0, 0.0, -1.0);
        near(hold_wrench(&law, &plug(0.0, 0.0, 0.0), &outwards, &AT_REST).force.z, 3.0);
        near(hold_wrench(&law, &plug(0.0, 0.0, 0.0), &(10.0 * outwards), &AT_REST).force.z, 5.0);
        near(hold_wrench(&law, &plug(0.0, 0.0, 0.0), &(-10.0 * outwards), &AT_REST).force.z, -5.0);
        let lateral = |mm, speed: f64| {
            let force = hold_wrench(&law, &plug(mm, 0.0, 0.0), &Vector3::new(0.0, speed, 0.0), &AT_REST).force;
            force.xy().norm()
        };
        near(lateral(10.0, 0.0), 0.05);
        near(lateral(0.0, 1.0), 0.85);
        near(lateral(0.0, 2.0), 1.0);
        near(lateral(15.0001, 1.0), 0.0);
        let torque = |tilt, spin| hold_wrench(&law, &plug(0.0, 0.0, tilt), &AT_REST, &spin).torque;
        near(torque(0.1, AT_REST).norm(), 0.25 * libm::sin(0.1));
        // It turns the bulb's axis back to the socket's.
        let tilted = plug(0.0, 0.0, 0.1);
        assert!(torque(0.1, AT_REST).cross(&tilted.bulb_axis).dot(&tilted.axis) > 0.0);
        near(torque(0.0, Vector3::new(10.0, 0.0, 0.0)).x, -0.03);
        near(torque(0.0, Vector3::new(0.0, 1e3, 0.0)).norm(), 0.25);
        near(torque(0.0, Vector3::new(0.0, 0.0, 1e3)).norm(), 0.0);
    }

    #[test]
    fn seats_within_the_published_window() {
        for (lateral_mm, gap_mm, tilt, socket_free, seats) in [
            (0.0, 0.0, 0.0, true, true),
            (0.0, 3.99, 0.0, true, true),
            (0.0, -3.99, 0.0, true, true),
            (0.0, 4.01, 0.0, true, false),
            (0.0, -4.01, 0.0, true, false),
            (14.9, 0.0, 0.0, true, true),
            (15.1, 0.0, 0.0, true, false),
            (0.0, 0.0, 0.199, true, true),
            (0.0, 0.0, 0.201, true, false),
            (0.0, 0.0, 0.0, false, false),
        ] {
            let mut attachment = Attachment::FREE;
            let change = attachment.advance(&law(), &plug(lateral_mm, gap_mm, tilt), socket_free);
            assert_eq!(attachment.is_seated(), seats, "{lateral_mm} {gap_mm} {tilt} {socket_free}");
            assert_eq!(change, seats.then_some(AttachmentState::Seated));
        }
    }

    #[test]
    fn only_a_sustained_pull_releases() {
        let mut attachment = Attachment::SEATED;
        let changes: Vec<_> = [16.0, 16.0, 14.9, 16.0, -30.0, 16.0, 16.0, 16.0, 16.0]
            .map(|gap_mm| attachment.advance(&law(), &plug(0.0, gap_mm, 0.0), true))
            .into_iter()
            .collect();
        let released: Vec<usize> = (0..changes.len()).filter(|&i| changes[i].is_some()).collect();
        assert_eq!(released, [7]);
        assert_eq!(attachment, Attachment::FREE);
    }
}
