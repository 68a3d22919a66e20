use fiatlux_dynamics::{BodyId, BodySpec, Joint};
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::Part;
use crate::config::ThingConfig;

/// A thing that can move, with the inertia of its shapes filled evenly.
pub(crate) fn thing_body(config: &ThingConfig, name: &str, world_from_thing: Isometry3<f64>) -> BodySpec {
    let solids: Vec<Solid> = config.solids().collect();
    let volume: f64 = solids.iter().map(|solid| solid.volume).sum();
    let mass_of = |solid: &Solid| config.mass * solid.volume / volume;
    let com = solids.iter().map(|solid| solid.center * (mass_of(solid) / config.mass)).sum::<Vector3<f64>>();
    let inertia = solids.iter().map(|solid| {
        let arm = solid.center - com;
        let about_com = Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
        (Matrix3::from_diagonal(&solid.inertia) + about_com) * mass_of(solid)
    });
    BodySpec {
        name: name.into(),
        parent: BodyId::WORLD,
        parent_from_body: world_from_thing,
        joint: Joint::Free,
        mass: config.mass,
        com,
        inertia: inertia.sum(),
    }
}

/// Its boxes and balls.
pub(crate) fn thing(config: &ThingConfig) -> Vec<Part> {
    let material = config.surface.material();
    let boxes = config.boxes.iter().enumerate();
    let boxes = boxes.map(|(i, [low, high])| Part::cuboid(format!("box_{i}"), *low, *high, material));
    let balls = config.balls.iter().enumerate().map(|(i, [x, y, z, radius])| {
        let center = Vector3::new(*x, *y, *z);
        Part::swept_ball(format!("ball_{i}"), center, center, *radius, material)
    });
    boxes.chain(balls).collect()
}

/// A shape filled evenly; its inertia about its own centre is for 1 kg.
struct Solid {
    volume: f64,
    center: Vector3<f64>,
    inertia: Vector3<f64>,
}

impl ThingConfig {
    fn solids(&self) -> impl Iterator<Item = Solid> + '_ {
        let boxes = self.boxes.iter().map(|[low, high]| {
            let (low, high) = (Vector3::from(*low), Vector3::from(*high));
            let size = high - low;
            let square = size.map(|side| side * side / 12.0);
            Solid {
                volume: size.product(),
                center: (low + high) / 2.0,
                inertia: Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y),
            }
        });
        let balls = self.balls.iter().map(|[x, y, z, radius]| Solid {
            volume: 4.0 / 3.0 * std::f64::consts::PI * radius * radius * radius,
            center: Vector3::new(*x, *y, *z),
            inertia: Vector3::from_element(0.4 * radius * radius),
        });
        boxes.chain(balls)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two halves of a block have the mass distribution of the block.
    #[test]
    fn inertia_does_not_depend_on_how_a_block_is_cut() {
        let of = |boxes: &str| {
            let text = format!(
                "mass = 2.0\nat = [0.0, 0.0, 0.0]\nsurface = {{ static_friction = 1.0, friction = 1.0, priority = 0 }}\nboxes = {boxes}"
            );
            thing_body(&toml::from_str(&text).expect("a thing"), "block", Isometry3::identity())
        };
        let whole = of("[[[0.0, 0.0, 0.0], [0.2, 0.4, 0.6]]]");
        let cut = of("[[[0.0, 0.0, 0.0], [0.2, 0.1, 0.6]], [[0.0, 0.1, 0.0], [0.2, 0.4, 0.6]]]");
        assert!((whole.com - Vector3::new(0.1, 0.2, 0.3)).norm() < 1e-12 && (cut.com - whole.com).norm() < 1e-12);
        assert!((whole.inertia[(0, 0)] - 2.0 / 12.0 * (0.16 + 0.36)).abs() < 1e-12);
        assert!((cut.inertia - whole.inertia).norm() < 1e-12);
    }
}
