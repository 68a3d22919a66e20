//! The room's walls: a coupled ladder that would stand in one is moved out of it.
//!
//! The floor on which the published code places things is a box. The room's southern wall, the slanted panels across its
//! southern corners and the blocks in its northern ones are within reach of a ladder at the edge of that box: about one
//! published ladder in fifty stands in them.

use nalgebra::{Point3, Vector2};

use super::Place;
use crate::SceneConfig;

/// A ladder's place, moved the shortest way out of the walls that its footprint reaches into.
pub(super) fn clear_of_walls(config: &SceneConfig, mut place: Place) -> Place {
    let room = &config.room;
    let (west, east) = ([-room.wall_x[0], -room.wall_south_x[0]], [room.wall_x[1], room.wall_south_x[1]]);
    for (side, [wall, edge]) in [(-1.0, west), (1.0, east)] {
        let panel_end = Vector2::new(wall, room.wall_side_y[0]);
        let along_panel = Vector2::new(edge, room.wall_south_y) - panel_end;
        // A point of each wall, and its normal out of the room; x counts towards the side.
        for (point, outwards) in [
            (Vector2::new(0.0, room.wall_south_y), -Vector2::y()),
            (Vector2::new(wall, 0.0), Vector2::x()),
            (panel_end, Vector2::new(-along_panel.y, along_panel.x).normalize()),
        ] {
            let depths = outline(config, &place, side).map(|corner| outwards.dot(&(corner - point)));
            let out = outwards * depths.into_iter().fold(0.0, f64::max);
            place.position -= Vector2::new(side * out.x, out.y);
        }
        let block = Vector2::new(edge, room.wall_side_y[1]);
        let from_block = outline(config, &place, side).map(|corner| corner - block);
        let [x, y] = [0, 1].map(|axis| reach_beside(&from_block, axis));
        if x > 0.0 && y > 0.0 {
            place.position -= if x < y { Vector2::new(side * x, 0.0) } else { Vector2::new(0.0, y) };
        }
    }
    place
}

/// Corners of the footprint, a clearance wider all around; x counts towards the side.
fn outline(config: &SceneConfig, place: &Place, side: f64) -> [Vector2<f64>; 4] {
    let [half_x, half_y] = [0, 1].map(|axis| config.ladder.size[axis] / 2.0 + config.start.clearance);
    let world_from_ladder = place.world_from_place(0.0);
    [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)].map(|(x, y)| {
        let corner = world_from_ladder * Point3::new(x, y, 0.0);
        Vector2::new(side * corner.x, corner.y)
    })
}

/// Reach of an outline along one axis where its other coordinate is positive.
fn reach_beside(outline: &[Vector2<f64>; 4], axis: usize) -> f64 {
    let other = 1 - axis;
    let mut most = f64::NEG_INFINITY;
    for (k, a) in outline.iter().enumerate() {
        let b = outline[(k + 1) % outline.len()];
        if a[other] >= 0.0 {
            most = most.max(a[axis]);
        }
        if (a[other] >= 0.0) != (b[other] >= 0.0) {
            most = most.max(a[axis] + (b[axis] - a[axis]) * a[other] / (a[other] - b[other]));
        }
    }
    most
}
