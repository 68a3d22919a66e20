//! The step ladder as a LiDAR meets it: rods and blocks, in its own frame, on a level floor.

use fiatlux_room::ladder as numbers;
use nalgebra::Vector3;

/// A part of the ladder.
#[derive(Debug, Clone, Copy)]
enum Part {
    /// A rod with round ends.
    Rod { from: Vector3<f64>, to: Vector3<f64> },
    /// A block along the axes: its middle and half extents.
    Block { middle: Vector3<f64>, half: Vector3<f64> },
}

/// The surfaces of ladder and floor, or of one of them.
pub(super) struct Shape {
    ladder: Vec<Part>,
    floor: bool,
}

/// The surface that is nearest to a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    /// Distance from it, m, negative within.
    pub distance: f64,
    /// Outwards, of length 1.
    pub normal: Vector3<f64>,
}

impl Shape {
    pub fn new() -> Self {
        let radius = numbers::RAIL_RADIUS;
        let [x, y] = [numbers::SIZE[0] / 2.0 - radius, numbers::SIZE[1] / 2.0 - radius];
        let rod = |from: [f64; 3], to: [f64; 3]| Part::Rod { from: from.into(), to: to.into() };
        let block = |low: [f64; 3], high: [f64; 3]| {
            let (low, high) = (Vector3::from(low), Vector3::from(high));
            Part::Block { middle: (low + high) / 2.0, half: (high - low) / 2.0 }
        };
        let ([rail_y, rail_z], [leg_y, leg_z]) = (numbers::RAIL_TOP, numbers::LEG_TOP);
        let (bar_y, bar_z) = (numbers::GUARD_Y, numbers::SIZE[2] - radius);
        let mut parts = vec![rod([-x, bar_y, bar_z], [x, bar_y, bar_z])];
        for x in [-x, x] {
            parts.push(rod([x, -y, radius], [x, rail_y, rail_z]));
            parts.push(rod([x, y, radius], [x, leg_y, leg_z]));
            parts.push(rod([x, leg_y, leg_z], [x, bar_y, bar_z]));
        }
        for top in numbers::TREAD_HEIGHTS {
            let low = top - numbers::TREAD_THICKNESS;
            let middle = -y + ((low + top) / 2.0 - radius) * (rail_y + y) / (rail_z - radius);
            let (wide, deep) = (numbers::TREAD_HALF_WIDTH, numbers::TREAD_DEPTH / 2.0);
            parts.push(block([-wide, middle - deep, low], [wide, middle + deep, top]));
        }
        let ([x0, x1], [y0, y1]) = (numbers::PLATFORM_X, numbers::PLATFORM_Y);
        let top = numbers::PLATFORM_HEIGHT;
        parts.push(block([x0, y0, top - numbers::PLATFORM_THICKNESS], [x1, y1, top]));
        Self { ladder: parts, floor: true }
    }

    /// Without the ladder.
    pub fn floor() -> Self {
        Self { ladder: Vec::new(), floor: true }
    }

    /// Without the floor.
    pub fn ladder() -> Self {
        Self { floor: false, ..Self::new() }
    }

    /// The surface that is nearest to a point, in the ladder's frame.
    pub fn nearest(&self, point: &Vector3<f64>) -> Surface {
        let distance = if self.floor { point.z } else { f64::INFINITY };
        let floor = Surface { distance, normal: Vector3::z() };
        let surfaces = self.ladder.iter().map(|part| part.nearest(point));
        surfaces.fold(floor, |best, next| if next.distance.abs() < best.distance.abs() { next } else { best })
    }
}

impl Part {
    fn nearest(&self, point: &Vector3<f64>) -> Surface {
        match self {
            Part::Rod { from, to } => {
                let along = to - from;
                let part = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                let away = point - (from + along * part);
                let length = away.norm();
                let normal = if length > 0.0 { away / length } else { Vector3::x() };
                Surface { distance: length - numbers::RAIL_RADIUS, normal }
            }
            Part::Block { middle, half } => {
                let local = point - middle;
                let beyond = local.abs() - half;
                let outside = beyond.map(|part| part.max(0.0));
                let distance = outside.norm();
                if distance > 0.0 {
                    let normal = outside.component_mul(&local.map(f64::signum)) / distance;
                    return Surface { distance, normal };
                }
                let axis = beyond.imax();
                let mut normal = Vector3::zeros();
                normal[axis] = 1.0_f64.copysign(local[axis]);
                Surface { distance: beyond[axis], normal }
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use fiatlux_robot::Robot;
    use fiatlux_rules::{Task, errand};
    use fiatlux_sensing::{Lidar, Sight};
    use fiatlux_world::{EpisodeSpec, Scene, SceneConfig, StartOptions, start_drawn};
    use nalgebra::Point3;

    use super::*;
    use crate::see::reckoning::hits;

    #[test]
    fn what_the_lidar_hits_is_on_it() {
        let robot = Arc::new(Robot::benchmark().unwrap());
        let spec = EpisodeSpec::new(Task::S02, 1100, 0);
        let of_scene = spec.scene(robot.gains(Default::default()));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, of_scene).unwrap());
        let (world, _) = start_drawn(Arc::clone(&scene), spec.task, 0, &StartOptions::default()).unwrap();
        let mut lidar = Lidar::new(&scene, Sight::Published).unwrap();
        let row = world.row();
        let ladder_from_lidar = row.things[errand::LADDER].pose.inverse() * lidar.world_from_sensor(row);
        let (shape, mut above) = (Shape::new(), 0);
        for hit in hits(lidar.scan(row)) {
            let point = (ladder_from_lidar * Point3::from(hit)).coords;
            let Surface { distance, normal } = shape.nearest(&point);
            assert!(distance.abs() < 1e-3 && (normal.norm() - 1.0).abs() < 1e-9, "{point}: {distance} m");
            above += usize::from(point.z > 0.01);
        }
        assert!(above > 100, "{above} hits above the floor");
    }
}
