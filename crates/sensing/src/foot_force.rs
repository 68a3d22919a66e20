//! The force on a foot as its ankle feels it.
//!
//! The robot has no force sensor in its feet. In rest the ankle's two drives bear what the ground does to the foot about
//! their axes. With the sole's centre p, an ankle axis a through o, the drive's effort e about it, and the mass m and its
//! centre c of each link below the axis, every axis i of the two gives
//!
//! ```text
//! e_i + sum over links below i of (a_i x (c - o_i)) . m g + (a_i x (p - o_i)) . f = 0
//! ```
//!
//! for a force f at p: two equations, J' f = t, for three numbers. The estimate is the smallest force that meets them,
//! f = J (J' J)^-1 t. It knows nothing of the force's part along the line from the ankle to p, and takes a force elsewhere
//! on the sole for one of another size at p: a weight straight below the ankle is not felt at all. What the foot's own
//! inertia, the ankle's friction and its end stops bear is taken for contact too. `OBSERVATIONS.md` has what comes of it.

use fiatlux_robot::{Robot, Shape};
use fiatlux_rules::{GRAVITY, Row};
use nalgebra::{Isometry3, Matrix2, Point3, Vector2, Vector3};

use crate::world_from_link;

/// Least height of the sole's centre above the floor at which a force counts, m: lower, the floor may be what bears the
/// foot, and only the ladder is asked for.
pub const FOOT_FORCE_HEIGHT: f64 = 0.10;

/// Estimated force on the left and the right foot, world axes, N; zero where the sole is near the floor.
pub fn foot_force_estimate(robot: &Robot, row: &Row) -> [Vector3<f64>; 2] {
    std::array::from_fn(|side| {
        let force = robot.feet().get(side).and_then(|&foot| estimate(robot, foot, row));
        force.unwrap_or_else(Vector3::zeros)
    })
}

/// `None` near the floor, and for a foot without two joints or without a sole.
fn estimate(robot: &Robot, foot: usize, row: &Row) -> Option<Vector3<f64>> {
    let world_from_foot = world_from_link(robot, foot, row);
    let sole = (world_from_foot * sole_center(robot, foot)?).coords;
    if sole.z <= FOOT_FORCE_HEIGHT {
        return None;
    }
    let shin_side = robot.links()[foot].parent?;
    let weight = |link: usize, world_from_link: &Isometry3<f64>| {
        let body = &robot.links()[link];
        ((world_from_link * Point3::from(body.com)).coords, -Vector3::z() * (GRAVITY * body.mass))
    };
    let world_from_shin_side = world_from_link(robot, shin_side, row);
    let weights = [weight(foot, &world_from_foot), weight(shin_side, &world_from_shin_side)];
    // Roll has the foot below it, pitch also the link between the two.
    let axes = [(foot, &world_from_foot, &weights[..1]), (shin_side, &world_from_shin_side, &weights[..])];
    let mut levers = [Vector3::zeros(); 2];
    let mut torques = Vector2::zeros();
    for (i, (link, world_from_axis, weights)) in axes.into_iter().enumerate() {
        let joint = robot.links()[link].joint?;
        let axis = world_from_axis.rotation * robot.joints()[joint].axis.into_inner();
        let origin = world_from_axis.translation.vector;
        let lever = |point: &Vector3<f64>| axis.cross(&(point - origin));
        levers[i] = lever(&sole);
        let borne: f64 = weights.iter().map(|(at, force)| lever(at).dot(force)).sum();
        torques[i] = -(row.joint_effort.get(joint)? + borne);
    }
    let mixed = levers[0].dot(&levers[1]);
    let gram = Matrix2::new(levers[0].norm_squared(), mixed, mixed, levers[1].norm_squared());
    let weights = gram.try_inverse()? * torques;
    Some(levers[0] * weights[0] + levers[1] * weights[1])
}

/// Centre of the sole in the foot's frame: of the lower face of the lowest box.
fn sole_center(robot: &Robot, foot: usize) -> Option<Point3<f64>> {
    let lower_face = |shape: &Shape| {
        let half = shape.geometry.as_cuboid()?;
        Some(shape.link_from_shape * Point3::new(0.0, 0.0, -half.z))
    };
    let faces = robot.shapes().iter().filter(|shape| shape.link == foot).filter_map(lower_face);
    faces.min_by(|a, b| a.z.total_cmp(&b.z))
}
