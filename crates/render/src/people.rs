//! For pictures for people alone: surfaces with a texture, and the shadow right under the feet.

use fiatlux_rules::Row;
use nalgebra::Isometry3;

use crate::Visuals;
use crate::paint::Paint;
use crate::single::SinglePose;
use crate::single::{dot, floor};
use crate::spot::{MIN_SLANT, SKIRTING, Spot, TILE};

/// Length and height of the wall's blocks, and the width of a joint between them, m.
const BLOCK: [f32; 2] = [0.4, 0.2];
const JOINT: f32 = 0.008;
/// Width of the bench's planks, m.
const PLANK: f32 = 0.095;
/// A sole: its middle ahead of the ankle, half its length and width, and its height below the ankle, m.
const SOLE: [f32; 4] = [0.035, 0.095, 0.032, 0.035];
/// Reach of the shadow under a sole, sideways and upwards, m, and the light that it takes.
const SHADOW: [f32; 3] = [0.075, 0.03, 0.7];

/// Content of a row that these depend on.
pub(crate) struct Touches {
    bench_from_world: Option<SinglePose>,
    ankle_from_world: Vec<SinglePose>,
}

impl Touches {
    pub(crate) fn of(visuals: &Visuals, row: &Row) -> Self {
        let robot = &visuals.robot;
        let links = robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap_or_default();
        let inverse = |pose: &Isometry3<f64>| SinglePose::new(&pose.inverse());
        Self {
            bench_from_world: visuals.world_from_bench.as_ref().map(inverse),
            ankle_from_world: robot.feet().iter().filter_map(|foot| links.get(*foot).map(inverse)).collect(),
        }
    }

    /// Share of its colour that a spot has by the texture of its paint.
    pub(crate) fn texture(&self, paint: Paint, spot: &Spot) -> f32 {
        let [x, y, z] = spot.point;
        let width = spot.footprint / (-dot(spot.normal, spot.ray)).max(MIN_SLANT);
        // A pattern as fine as a pixel is not seen.
        let seen = |size: f32| (1.0 - width / size).max(0.0);
        match paint {
            Paint::Floor => {
                let tile = hash(floor(x / TILE), floor(y / TILE));
                let grain = seen(0.02) * noise(90.0 * x, 90.0 * y) + seen(0.008) * noise(260.0 * x, 260.0 * y);
                1.0 + 0.035 * tile + 0.05 * grain + 0.03 * noise(1.3 * x, 1.3 * y)
            }
            Paint::Wall if z >= SKIRTING => {
                let along = if spot.normal[0].abs() > spot.normal[1].abs() { y } else { x };
                let (course, up) = (floor(z / BLOCK[1]), z / BLOCK[1]);
                let across = along / BLOCK[0] + 0.5 * (course - 2.0 * floor(0.5 * course));
                let from_joint = |at: f32, size: f32| size * (at - floor(at + 0.5)).abs();
                let near = from_joint(across, BLOCK[0]).min(from_joint(up, BLOCK[1]));
                let wide = JOINT.max(width);
                let joint = (1.0 - near / wide).max(0.0) * JOINT / wide;
                let block = hash(floor(across), course);
                1.0 - 0.1 * joint + 0.012 * block + 0.02 * seen(0.03) * noise(60.0 * along, 60.0 * z)
            }
            Paint::Wood => {
                let Some(bench) = &self.bench_from_world else { return 1.0 };
                let [u, v, w] = bench.point(spot.point);
                let plank = floor(v / PLANK);
                let (own, v) = (hash(plank, 3.0), v + 0.3 * w);
                let rings = noise(2.2 * u + 17.0 * own, 46.0 * v + 1.6 * noise(1.4 * u, 9.0 * v));
                let fibre = seen(0.006) * noise(9.0 * u, 330.0 * v);
                let from_seam = PLANK * (v / PLANK - floor(v / PLANK + 0.5)).abs();
                let seam = seen(0.01) * (1.0 - from_seam / 0.0018).max(0.0);
                1.0 + 0.07 * own + 0.10 * seen(0.05) * rings + 0.05 * fibre - 0.25 * seam
            }
            _ => 1.0,
        }
    }

    /// Share of the light that reaches a spot past the soles close above it.
    pub(crate) fn under_feet(&self, spot: &Spot) -> f32 {
        let [reach, high, most] = SHADOW;
        let mut open = 1.0;
        for ankle in &self.ankle_from_world {
            let [x, y, z] = ankle.point(spot.point);
            let (beside, below) = ([(x - SOLE[0]).abs() - SOLE[1], y.abs() - SOLE[2]], -z - SOLE[3]);
            let off = beside.map(|way| way.max(0.0));
            let far = dot([off[0], off[1], 0.0], [off[0], off[1], 0.0]).sqrt() / reach;
            // The spot's own height tells a floor from the shoe that stands on it.
            if far < 1.0 && below > -0.012 && below < high && spot.normal[2] > 0.7 {
                let near = (1.0 - far) * (1.0 - below.max(0.0) / high);
                open *= 1.0 - most * near * near * (3.0 - 2.0 * near);
            }
        }
        open
    }
}

/// A number in [-1, 1] that differs between whole numbers.
fn hash(x: f32, y: f32) -> f32 {
    let mut bits = (x as i32 as u32).wrapping_mul(0x9E37_79B1) ^ (y as i32 as u32).wrapping_mul(0x85EB_CA77);
    bits = (bits ^ (bits >> 15)).wrapping_mul(0x2C1B_3C6D);
    bits = (bits ^ (bits >> 12)).wrapping_mul(0x297A_2D39);
    (bits >> 8) as f32 / 8_388_608.0 - 1.0
}

/// The same, smooth in between.
fn noise(x: f32, y: f32) -> f32 {
    let (i, j) = (floor(x), floor(y));
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (s, t) = (ease(x - i), ease(y - j));
    let row = |j: f32| hash(i, j) + s * (hash(i + 1.0, j) - hash(i, j));
    let low = row(j);
    low + t * (row(j + 1.0) - low)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_smooth_bounded_and_even() {
        let mut sum = 0.0;
        for k in 0..4000_i16 {
            let (x, y) = (0.37 * f32::from(k) - 700.0, 0.11 * f32::from(k));
            let here = noise(x, y);
            assert!(here.abs() <= 1.0, "{here}");
            assert!((noise(x + 0.01, y) - here).abs() < 0.05, "it jumps at {x}");
            sum += here;
        }
        assert!((sum / 4000.0).abs() < 0.05, "{sum}");
    }
}
