//! The rays of a LiDAR's scan. The index of one is [`COLUMNS`] row + column; rows are elevations and columns azimuths in the frame of the
//! link that carries the sensor. That link hangs upside down, so the columns go behind, left, ahead, right.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

/// Elevations of a scan, from minus to plus [`ELEVATION`].
pub const ROWS: usize = 32;
/// Azimuths of a scan, 2 degrees apart from -180 degrees.
pub const COLUMNS: usize = 180;
/// Rays of a scan.
pub const RAYS: usize = ROWS * COLUMNS;
/// Range, m; also what a ray reads that hits nothing.
pub const RANGE: f64 = 10.0;
/// Greatest elevation, rad; the least is its negative.
pub const ELEVATION: f64 = 25.0 * PI / 180.0;

/// Unit vector along a ray in the sensor's frame.
pub fn direction(ray: usize) -> Vector3<f64> {
    let (row, column) = ((ray / COLUMNS) as f64, (ray % COLUMNS) as f64);
    let elevation = ELEVATION * (2.0 * row / (ROWS - 1) as f64 - 1.0);
    let azimuth = TAU * column / COLUMNS as f64 - PI;
    let level = libm::cos(elevation);
    Vector3::new(level * libm::cos(azimuth), level * libm::sin(azimuth), libm::sin(elevation))
}
