use std::f64::consts::FRAC_PI_2;

use fiatlux_dynamics::Geometry;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::Part;
use crate::config::{RoomConfig, Surfaces};

/// A slanted panel across a corner of the room, as thick as the west wall.
fn corner(name: &str, from: Vector2<f64>, to: Vector2<f64>, config: &RoomConfig, surfaces: &Surfaces) -> Part {
    let thickness = config.wall_x[0] - config.outer_x[0];
    let along = to - from;
    let angle = libm::atan2(along.y, along.x);
    // The room is on the left of the way from `from` to `to`.
    let outwards = Vector2::new(libm::cos(angle - FRAC_PI_2), libm::sin(angle - FRAC_PI_2));
    let center = (from + to) / 2.0 + outwards * (thickness / 2.0);
    Part {
        name: name.into(),
        prop_from_part: Isometry3::from_parts(
            Translation3::new(center.x, center.y, config.wall_top / 2.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
        ),
        geometry: Geometry::Cuboid {
            half_extents: Vector3::new(along.norm() / 2.0, thickness / 2.0, config.wall_top / 2.0),
        },
        material: surfaces.room.material(),
    }
}

/// The floor, and walls and ceiling one by one: they lie too far apart to be culled together.
pub(crate) fn room(config: &RoomConfig, surfaces: &Surfaces) -> (Part, Vec<Part>) {
    let floor = Part {
        name: "floor".into(),
        prop_from_part: Isometry3::identity(),
        geometry: Geometry::HalfSpace,
        material: surfaces.floor.material(),
    };
    let wall = |name: &str, x: [f64; 2], y: [f64; 2]| {
        Part::cuboid(name, [x[0], y[0], 0.0], [x[1], y[1], config.wall_top], surfaces.room.material())
    };
    let ([x0, x1], [y0, y1]) = (config.outer_x, config.outer_y);
    let [west, east] = config.wall_x;
    let [side_south, side_north] = config.wall_side_y;
    let [south_west, south_east] = config.wall_south_x;
    let south = config.wall_south_y;
    let ceiling = config.ceiling_height;
    let parts = vec![
        wall("wall_west", [x0, west], [y0, side_north]),
        wall("wall_east", [east, x1], [y0, side_north]),
        wall("wall_south", [west, east], [y0, south]),
        corner("corner_south_west", Vector2::new(west, side_south), Vector2::new(south_west, south), config, surfaces),
        corner("corner_south_east", Vector2::new(south_east, south), Vector2::new(east, side_south), config, surfaces),
        wall("corner_north_west", [x0, south_west], [side_north, y1]),
        wall("corner_north_east", [south_east, x1], [side_north, y1]),
        Part::cuboid(
            "ceiling",
            [x0, y0, ceiling],
            [x1, y1, ceiling + config.ceiling_thickness],
            surfaces.room.material(),
        ),
    ];
    (floor, parts)
}
