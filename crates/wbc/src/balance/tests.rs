use nalgebra::UnitQuaternion;

use super::*;

/// The feet's forces carry the weight, act at the wanted point and exert no torque about the centre of mass, on both
/// sides of the limits.
#[test]
fn the_ground_carries_and_does_not_turn() {
    for (x, y) in [(0.0, 0.0), (0.02, -0.03), (-0.01, 0.05), (0.3, 0.0), (0.0, -0.3)] {
        let soles = [Vector3::new(0.03, 0.11, -0.75), Vector3::new(0.01, -0.13, -0.75)];
        let middle = (soles[0] + soles[1]) / 2.0;
        let position = Vector2::new(x, y);
        let pendulum = Pendulum {
            level_from_pelvis: UnitQuaternion::identity(),
            com: Vector3::new(middle.x + x, middle.y + y, -0.1),
            soles,
            mass: 35.0,
            position,
            velocity: Vector2::new(0.0, 0.01),
        };
        let GroundForces { pressure, feet } = ground_forces(&pendulum);
        assert!(pressure.x.abs() <= SOLE_REACH && pressure.y.abs() <= LARGEST_SHIFT * 0.12);
        assert!(feet.iter().all(|(force, _)| force.z > 0.0));
        let weight: f64 = feet.iter().map(|(force, _)| force.z).sum();
        assert!((weight - 35.0 * GRAVITY).abs() < 1e-9, "{weight} N");
        let at = feet.iter().map(|(force, at)| at * force.z).sum::<Vector3<f64>>() / weight;
        assert!((at.xy() - middle.xy() - pressure).norm() < 1e-12, "({x}, {y}): {at}");
        let torque: Vector3<f64> = feet.iter().map(|(force, at)| (at - pendulum.com).cross(force)).sum();
        assert!(torque.norm() < 1e-9, "({x}, {y}): {torque} N m");
    }
}
