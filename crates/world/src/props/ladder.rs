//! A platform step ladder of capsules and boxes: two front rails with treads between them, two rear legs, a platform,
//! and a guard rail at its back.

use fiatlux_dynamics::{BodyId, BodySpec, Joint};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::Part;
use crate::SceneError;
use crate::config::{LadderConfig, Surfaces};

/// Points of the ladder that measurements use, in its frame.
#[derive(Debug, Clone, PartialEq)]
pub struct LadderPoints {
    /// Where the feet touch the floor, m: front left, front right, rear left, rear right (left is -x).
    pub feet: [Vector3<f64>; 4],
    /// The point above the platform, m.
    pub top: Vector3<f64>,
}

impl LadderPoints {
    pub(crate) fn new(config: &LadderConfig) -> Self {
        let [x, y] = foot_offset(config);
        let foot = |x, y| Vector3::new(x, y, 0.0);
        Self { feet: [foot(-x, -y), foot(x, -y), foot(-x, y), foot(x, y)], top: Vector3::from(config.top_point) }
    }
}

/// x and y of the lower ends of rails and legs, whose round feet then reach the corners of the footprint.
fn foot_offset(config: &LadderConfig) -> [f64; 2] {
    [config.size[0] / 2.0 - config.rail_radius, config.size[1] / 2.0 - config.rail_radius]
}

/// The parts: first the lower ones (rails, legs, treads), then the upper ones (platform, guard rail).
pub(crate) fn ladder(config: &LadderConfig, surfaces: &Surfaces) -> Vec<Part> {
    let mut parts = lower_parts(config, surfaces);
    parts.extend(upper_parts(config, surfaces));
    parts
}

fn lower_parts(config: &LadderConfig, surfaces: &Surfaces) -> Vec<Part> {
    let (material, radius) = (surfaces.ladder.material(), config.rail_radius);
    let [x, y] = foot_offset(config);
    let [rail_y, rail_z] = config.rail_top;
    let [leg_y, leg_z] = config.leg_top;
    let mut parts = Vec::new();
    for (side, x) in [("left", -x), ("right", x)] {
        let bar = |name: &str, foot_y: f64, top_y: f64, top_z: f64| {
            let (from, to) = (Vector3::new(x, foot_y, radius), Vector3::new(x, top_y, top_z));
            Part::swept_ball(format!("{name}_{side}"), from, to, radius, material)
        };
        parts.push(bar("rail", -y, rail_y, rail_z));
        parts.push(bar("leg", y, leg_y, leg_z));
    }
    for (i, &top) in config.tread_heights.iter().enumerate() {
        // Centred on the rails at half its thickness.
        let low = top - config.tread_thickness;
        let center = -y + ((low + top) / 2.0 - radius) * (rail_y + y) / (rail_z - radius);
        let (half_x, half_y) = (config.tread_half_width, config.tread_depth / 2.0);
        let corners = ([-half_x, center - half_y, low], [half_x, center + half_y, top]);
        parts.push(Part::cuboid(format!("tread_{i}"), corners.0, corners.1, material));
    }
    parts
}

fn upper_parts(config: &LadderConfig, surfaces: &Surfaces) -> Vec<Part> {
    let (material, radius) = (surfaces.ladder.material(), config.rail_radius);
    let ([x0, x1], [y0, y1]) = (config.platform_x, config.platform_y);
    let top = config.platform_height;
    let platform = Part::cuboid("platform", [x0, y0, top - config.platform_thickness], [x1, y1, top], material);
    let [x, _] = foot_offset(config);
    let [leg_y, leg_z] = config.leg_top;
    let bar_end = |x| Vector3::new(x, config.guard_y, config.size[2] - radius);
    let rod = |name: &str, from, to| Part::swept_ball(name, from, to, radius, material);
    vec![
        platform,
        rod("upright_left", Vector3::new(-x, leg_y, leg_z), bar_end(-x)),
        rod("upright_right", Vector3::new(x, leg_y, leg_z), bar_end(x)),
        rod("guard_bar", bar_end(-x), bar_end(x)),
    ]
}

/// The ladder as a free body. Lower and upper parts are solids of one density each; the two densities follow from the
/// ladder's mass and the height of its centre of mass, and with them everything else.
///
/// # Errors
/// [`SceneError::Value`] for a centre of mass that no two positive densities give.
pub(crate) fn ladder_body(
    config: &LadderConfig,
    surfaces: &Surfaces,
    world_from_ladder: Isometry3<f64>,
) -> Result<BodySpec, SceneError> {
    let lower = Solid::sum(&lower_parts(config, surfaces));
    let upper = Solid::sum(&upper_parts(config, surfaces));
    let (low, high) = (lower.first_moment.z / lower.volume, upper.first_moment.z / upper.volume);
    let upper_share = (config.com_z - low) / (high - low);
    if !(upper_share > 0.01 && upper_share < 0.99) {
        return Err(SceneError::Value {
            field: "ladder.com_z",
            line: None,
            value: config.com_z.to_string(),
            rule: format!("it must be between {low:.3} and {high:.3}, the centres of the lower and upper parts"),
        });
    }
    let lower_density = config.mass * (1.0 - upper_share) / lower.volume;
    let upper_density = config.mass * upper_share / upper.volume;
    let com = (lower_density * lower.first_moment + upper_density * upper.first_moment) / config.mass;
    let about_origin = lower_density * lower.inertia + upper_density * upper.inertia;
    Ok(BodySpec {
        name: "ladder".into(),
        parent: BodyId::WORLD,
        parent_from_body: world_from_ladder,
        joint: Joint::Free,
        mass: config.mass,
        com,
        inertia: about_origin - steiner(config.mass, &com),
    })
}

/// Moments of a set of solids of density 1, about the prop's origin.
struct Solid {
    volume: f64,
    first_moment: Vector3<f64>,
    inertia: Matrix3<f64>,
}

impl Solid {
    fn sum(parts: &[Part]) -> Self {
        let mut sum = Self { volume: 0.0, first_moment: Vector3::zeros(), inertia: Matrix3::zeros() };
        for part in parts {
            let solid = part.geometry.solid();
            let center = (part.prop_from_part * Point3::from(solid.center)).coords;
            let rotation = part.prop_from_part.rotation.to_rotation_matrix();
            let turned = rotation.matrix() * solid.inertia * rotation.matrix().transpose();
            sum.volume += solid.volume;
            sum.first_moment += solid.volume * center;
            // The mean with its transpose makes it symmetric to the last bit.
            sum.inertia += (turned + turned.transpose()) / 2.0 + steiner(solid.volume, &center);
        }
        sum
    }
}

fn steiner(mass: f64, offset: &Vector3<f64>) -> Matrix3<f64> {
    mass * (Matrix3::from_diagonal_element(offset.norm_squared()) - offset * offset.transpose())
}

#[cfg(test)]
mod tests;
