use super::{Part, walls};
use crate::config::{CrateConfig, Surfaces};

/// The inner floor reaches this far below the crate, into the room's floor, so that nothing is pushed out downwards, m.
const FLOOR_DEPTH: f64 = 0.05;

/// Floor and four walls.
pub(crate) fn crate_(config: &CrateConfig, surfaces: &Surfaces) -> Vec<Part> {
    let material = surfaces.crate_.material();
    let [x, y] = config.interior_half;
    let mut parts = vec![Part::cuboid("floor", [-x, -y, -FLOOR_DEPTH], [x, y, config.floor_height], material)];
    parts.extend(walls("wall", [0.0; 2], config.interior_half, config.outer_half, [0.0, config.rim_height], material));
    parts
}
