//! Fixed things seen from above, which is enough to plan a path without the scene's shapes.

use fiatlux_dynamics::{BodyId, ShapeSpec};
use nalgebra::{Vector2, Vector3};

use crate::owner::ShapeOwner;
use crate::scene::Scene;

/// A rectangle on the floor, and the heights between which a thing occupies all or part of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    /// `bench`, a thing that cannot move, such as `crate`, or the name of a wall, a corner or the ceiling.
    pub name: String,
    /// Corners, counter-clockwise seen from above, world, m.
    pub outline: [Vector2<f64>; 4],
    /// Height of its lowest point, m. A robot can pass under hanging things.
    pub bottom: f64,
    /// Height of its highest point, m.
    pub top: f64,
}

impl Scene {
    /// Footprints of everything that never moves, except the floor, with each wall by itself. A rectangle is aligned
    /// with the thing's own axes and contains all of its shapes.
    pub fn footprints(&self) -> Vec<Footprint> {
        let mut found: Vec<(Bounds, Footprint)> = Vec::new();
        for shape in self.model.shapes().iter().filter(|shape| shape.body == BodyId::WORLD) {
            let (name, yaw) = match ShapeOwner::from_label(shape.label) {
                ShapeOwner::Room => (shape.name.trim_start_matches("room_"), heading(shape)),
                ShapeOwner::LADDER => ("ladder", self.layout.ladder.yaw),
                owner @ (ShapeOwner::Bench | ShapeOwner::Thing(_)) => (owner.name(), 0.0),
                ShapeOwner::Floor | ShapeOwner::Robot(_) => continue,
            };
            let bounds = Bounds::of(shape, yaw);
            match found.iter_mut().find(|(_, footprint)| footprint.name == name) {
                Some((all, footprint)) => {
                    all.grow(&bounds);
                    *footprint = all.footprint(name);
                }
                None => {
                    let footprint = bounds.footprint(name);
                    found.push((bounds, footprint));
                }
            }
        }
        found.into_iter().map(|(_, footprint)| footprint).collect()
    }
}

/// Bounds along the axes of a frame that is turned about the vertical.
struct Bounds {
    axes: [Vector3<f64>; 3],
    low: [f64; 3],
    high: [f64; 3],
}

impl Bounds {
    fn of(shape: &ShapeSpec, yaw: f64) -> Self {
        let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
        let axes = [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0), Vector3::z()];
        let center = shape.body_from_shape.translation.vector;
        let reach = axes.map(|axis| {
            let local = shape.body_from_shape.inverse_transform_vector(&axis);
            [-local, local].map(|along| shape.geometry.reach(&along))
        });
        let at = |k: usize| center.dot(&axes[k]);
        Self { low: [0, 1, 2].map(|k| at(k) - reach[k][0]), high: [0, 1, 2].map(|k| at(k) + reach[k][1]), axes }
    }

    fn grow(&mut self, other: &Self) {
        for k in 0..3 {
            self.low[k] = self.low[k].min(other.low[k]);
            self.high[k] = self.high[k].max(other.high[k]);
        }
    }

    fn footprint(&self, name: &str) -> Footprint {
        let corner = |x: f64, y: f64| (self.axes[0] * x + self.axes[1] * y).xy();
        let ([x0, y0, bottom], [x1, y1, top]) = (self.low, self.high);
        let outline = [corner(x0, y0), corner(x1, y0), corner(x1, y1), corner(x0, y1)];
        Footprint { name: name.into(), outline, bottom, top }
    }
}

/// Of a shape that is turned about the vertical alone, rad.
fn heading(shape: &ShapeSpec) -> f64 {
    let ahead = shape.body_from_shape.rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}
