//! The LiDAR in the robot's head: ranges by our own closed forms. The published one sees the floor and the ladder and
//! nothing else.
//!
//! Rows are elevations from -25 to 25 degrees, columns azimuths from -180 degrees in steps of 2, both in the frame of the
//! link that carries it, with whose whole orientation it turns; the index is 180 row + column. That frame is mounted
//! upside down: row 0 looks up. The pattern and its range are those of the published benchmark (its lidar pattern and
//! sensor config).

mod cast;

use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::Arc;

use fiatlux_dynamics::ShapeSpec;
use fiatlux_robot::Robot;
pub use fiatlux_robot::lidar::{
    COLUMNS as LIDAR_COLUMNS, RANGE as LIDAR_RANGE, RAYS as LIDAR_RAYS, ROWS as LIDAR_ROWS,
};
use fiatlux_robot::lidar::{ELEVATION, direction};
use fiatlux_rules::{Row, errand};
use fiatlux_world::{Scene, SceneError, ShapeOwner};
use nalgebra::{Isometry3, Vector3};

use crate::world_from_link;
use cast::{Placed, Target};

/// Objects that a LiDAR sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sight {
    /// Floor and ladder, as the published benchmark has it.
    #[default]
    Published,
    /// Walls, ceiling, bench and all fixed things too.
    Room,
}

/// The robot's LiDAR. A scan allocates nothing.
#[derive(Debug, Clone)]
pub struct Lidar {
    robot: Arc<Robot>,
    link: usize,
    /// Where the ladder stands, where it cannot move.
    world_from_fixed_ladder: Option<Isometry3<f64>>,
    ladder: Vec<Target>,
    /// Everything but the ladder that cannot move, in the world.
    room: Vec<Target>,
    /// Of each ray in the sensor's frame: x, y, z, each by the ray's index.
    directions: [Vec<f64>; 3],
    ranges: Box<[f32; LIDAR_RAYS]>,
}

impl Lidar {
    /// The LiDAR of a scene's robot, which has scanned nothing yet.
    ///
    /// # Errors
    /// [`SceneError::RobotParts`] for a robot that has none.
    pub fn new(scene: &Scene, sight: Sight) -> Result<Self, SceneError> {
        let link = scene.robot.lidar().ok_or_else(|| SceneError::RobotParts {
            robot: scene.robot.name().into(),
            part: "LiDAR mounts",
            found: 0,
            needed: 1,
        })?;
        let world_from_fixed_ladder = scene.body(errand::LADDER).is_none().then(|| scene.world_from(errand::LADDER));
        let ladder_from_body = world_from_fixed_ladder.map_or_else(Isometry3::identity, |pose| pose.inverse());
        let targets = |is_seen: &dyn Fn(ShapeOwner) -> bool, prop_from_body: Isometry3<f64>| {
            let shapes = scene.model.shapes().iter();
            let seen = shapes.filter(|shape| is_seen(ShapeOwner::from_label(shape.label)));
            let target = |shape: &ShapeSpec| Target::new(&shape.geometry, prop_from_body * shape.body_from_shape);
            seen.filter_map(target).collect::<Vec<_>>()
        };
        let is_room = |owner| match owner {
            ShapeOwner::Room | ShapeOwner::Bench => sight == Sight::Room,
            ShapeOwner::Thing(thing) => sight == Sight::Room && thing != errand::LADDER && scene.body(thing).is_none(),
            ShapeOwner::Floor | ShapeOwner::Robot(_) => false,
        };
        Ok(Self {
            robot: Arc::clone(&scene.robot),
            link,
            world_from_fixed_ladder,
            ladder: targets(&|owner| owner == ShapeOwner::LADDER, ladder_from_body),
            room: targets(&is_room, Isometry3::identity()),
            directions: [0, 1, 2].map(|axis| (0..LIDAR_RAYS).map(|ray| direction(ray)[axis]).collect()),
            ranges: Box::new([LIDAR_RANGE as f32; LIDAR_RAYS]),
        })
    }

    /// Scans a row: range of each ray, m.
    pub fn scan(&mut self, row: &Row) -> &[f32; LIDAR_RAYS] {
        let world_from_sensor = world_from_link(&self.robot, self.link, row);
        self.scan_floor(&world_from_sensor);
        let world_from_ladder = self.world_from_fixed_ladder.unwrap_or(row.things[errand::LADDER].pose);
        let sensor_from_world = world_from_sensor.inverse();
        let sensor_from_ladder = sensor_from_world * world_from_ladder;
        let ladder = self.ladder.iter().map(|target| target.place(&sensor_from_ladder));
        let room = self.room.iter().map(|target| target.place(&sensor_from_world));
        for placed in ladder.chain(room) {
            if placed.gap() > LIDAR_RANGE {
                continue;
            }
            let (first, count) = columns(&placed);
            let end = first + count;
            // In the order of the rays; the columns may go round past the last one.
            let runs = [first..end.min(LIDAR_COLUMNS), 0..end.saturating_sub(LIDAR_COLUMNS)];
            for row in rows(&placed) {
                for run in &runs {
                    let rays = row * LIDAR_COLUMNS + run.start..row * LIDAR_COLUMNS + run.end;
                    let [x, y, z] = [0, 1, 2].map(|axis| &self.directions[axis][rays.clone()]);
                    placed.cast_all([x, y, z], &mut self.ranges[rays]);
                }
            }
        }
        &self.ranges
    }

    /// Ranges of the last scan, m.
    pub fn ranges(&self) -> &[f32; LIDAR_RAYS] {
        &self.ranges
    }

    /// Hits of the last scan, in the sensor's frame, m, in the order of the rays. A ray without a hit gives no point.
    pub fn points(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        let hit = |(ray, range): (usize, &f32)| {
            (*range < LIDAR_RANGE as f32)
                .then(|| [0, 1, 2].map(|axis| (self.directions[axis][ray] * f64::from(*range)) as f32))
        };
        self.ranges.iter().enumerate().filter_map(hit)
    }

    /// Pose of the sensor in a row, world.
    pub fn world_from_sensor(&self, row: &Row) -> Isometry3<f64> {
        world_from_link(&self.robot, self.link, row)
    }

    /// Ranges to the plane z = 0.
    fn scan_floor(&mut self, world_from_sensor: &Isometry3<f64>) {
        let height = world_from_sensor.translation.z;
        let down = world_from_sensor.inverse_transform_vector(&-Vector3::z());
        let [x, y, z] = &self.directions;
        for (range, ((x, y), z)) in self.ranges.iter_mut().zip(x.iter().zip(y).zip(z)) {
            let distance = height / (x * down.x + y * down.y + z * down.z);
            let hit = (0.0..LIDAR_RANGE).contains(&distance);
            *range = if hit { distance } else { LIDAR_RANGE } as f32;
        }
    }
}

/// Rows whose rays can hit a shape: those between the elevations of its bounding box.
fn rows(placed: &Placed<'_>) -> Range<usize> {
    /// Far more than rounding, far less than a row, rad.
    const SLACK: f64 = 1e-6;
    let corners = placed.corners();
    let level = libm::hypot(placed.center.x, placed.center.y);
    // No point of the box is nearer to the sensor's axis than its corners are along the way to its centre.
    let along = |corner: &Vector3<f64>| (corner.x * placed.center.x + corner.y * placed.center.y) / level;
    let nearest = corners.iter().map(along).fold(f64::INFINITY, f64::min);
    if level.is_nan() || level < 1e-3 || nearest < 1e-3 {
        return 0..LIDAR_ROWS;
    }
    let farthest = corners.iter().map(|corner| libm::hypot(corner.x, corner.y)).fold(nearest, f64::max);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for corner in &corners {
        (low, high) = (low.min(corner.z), high.max(corner.z));
    }
    let lowest = libm::atan2(low, if low < 0.0 { nearest } else { farthest }) - SLACK;
    let highest = libm::atan2(high, if high > 0.0 { nearest } else { farthest }) + SLACK;
    let row = |elevation: f64| (elevation / ELEVATION + 1.0) * 0.5 * (LIDAR_ROWS - 1) as f64;
    let first = libm::ceil(row(lowest)).max(0.0) as usize;
    let end = (libm::floor(row(highest)) + 1.0).clamp(0.0, LIDAR_ROWS as f64) as usize;
    first..end.max(first)
}

/// First column of those whose rays can hit a shape, and their count: all where the sensor's z axis may pass through its
/// bounding box, which else spans less than half a turn.
fn columns(placed: &Placed<'_>) -> (usize, usize) {
    /// Far more than rounding, far less than a column.
    const SLACK: f64 = 1e-6;
    let middle = libm::atan2(placed.center.y, placed.center.x);
    let (mut low, mut high) = (0.0_f64, 0.0_f64);
    for corner in placed.corners() {
        let turn = libm::atan2(corner.y, corner.x) - middle;
        let turn = turn - TAU * libm::floor((turn + PI) / TAU);
        (low, high) = (low.min(turn), high.max(turn));
    }
    if high - low >= PI - SLACK {
        return (0, LIDAR_COLUMNS);
    }
    let column = |azimuth: f64| (azimuth + PI) / TAU * LIDAR_COLUMNS as f64;
    let first = libm::ceil(column(middle + low) - SLACK) as i64;
    let last = libm::floor(column(middle + high) + SLACK) as i64;
    let first_column = first.rem_euclid(LIDAR_COLUMNS as i64) as usize;
    (first_column, (last - first + 1).clamp(0, LIDAR_COLUMNS as i64) as usize)
}
