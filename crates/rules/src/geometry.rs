//! Constants of the scene that rules need besides a row.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::errand;
use crate::measure::{self, Extent};
use crate::parts::Bulb;
use crate::row::Row;

/// Sizes and points of the things in the room, in their own frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Point above the ladder's platform that rules measure to, m.
    pub ladder_top: [f64; 3],
    /// Where the ladder's feet touch the floor, m.
    pub ladder_feet: [[f64; 3]; 4],
    /// Seat point of the socket on its z axis, m.
    pub seat_z: f64,
    /// Old and fresh bulb.
    pub bulbs: [BulbGeometry; 2],
    /// Outer half extents of the crate, m.
    pub crate_outer_half: [f64; 2],
    /// Half extents of the crate's interior, m.
    pub crate_interior_half: [f64; 2],
    /// Height of the crate's rim above its origin, m.
    pub crate_rim: f64,
    /// Height of the crate's inner floor above its origin, m.
    pub crate_floor: f64,
    /// Height of the bench's surface, m.
    pub bench_surface: f64,
    /// Mass of the robot, kg.
    pub robot_mass: f64,
}

/// Size of a bulb, a solid of revolution about its +z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BulbGeometry {
    /// Plug point on the axis, m.
    pub plug_z: f64,
    /// Convex outline as (z, radius), m: of the shapes with which it collides, so that a bulb that lies free reaches into nothing.
    pub outline: Vec<[f64; 2]>,
}

impl Geometry {
    /// The ladder's top point, world, m.
    pub fn ladder_top(&self, row: &Row) -> Vector3<f64> {
        measure::world_point(&row.body(errand::LADDER).pose, &Vector3::from(self.ladder_top))
    }

    /// Heights of the ladder's feet, m.
    pub fn ladder_feet(&self, row: &Row) -> [f64; 4] {
        measure::heights(&row.body(errand::LADDER).pose, &self.ladder_feet.map(Vector3::from))
    }

    /// The socket's seat point, world, m.
    pub fn seat(&self, row: &Row) -> Vector3<f64> {
        measure::world_point(&row.body(errand::FIXTURE).pose, &Vector3::new(0.0, 0.0, self.seat_z))
    }

    /// A bulb's plug point, world, m.
    pub fn plug(&self, row: &Row, bulb: Bulb) -> Vector3<f64> {
        let plug_z = self.bulbs[bulb as usize].plug_z;
        measure::world_point(&row.body(bulb.thing()).pose, &Vector3::new(0.0, 0.0, plug_z))
    }

    /// Distance of a bulb's plug point from the seat point, m.
    pub fn plug_distance(&self, row: &Row, bulb: Bulb) -> f64 {
        (self.plug(row, bulb) - self.seat(row)).norm()
    }

    /// Height of a bulb's lowest point, m.
    pub fn lowest_point(&self, row: &Row, bulb: Bulb) -> f64 {
        measure::lowest_point(&self.bulbs[bulb as usize].outline, &row.body(bulb.thing()).pose)
    }

    /// Extents of a bulb along the crate's axes, from its origin, m.
    pub fn extents_in_crate(&self, row: &Row, bulb: Bulb) -> [Extent; 3] {
        measure::extents_in(
            &self.bulbs[bulb as usize].outline,
            &row.body(bulb.thing()).pose,
            &row.body(errand::CRATE).pose,
        )
    }
}
