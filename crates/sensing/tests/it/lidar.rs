//! The LiDAR against ranges worked out another way, and against Parry's ray casts.

use std::f64::consts::PI;
use std::sync::Arc;

use crate::common::{Rig, start_row};
use fiatlux_dynamics::Geometry;
use fiatlux_robot::Robot;
use fiatlux_rules::{Row, Task, errand};
use fiatlux_sensing::{LIDAR_COLUMNS, LIDAR_RAYS, LIDAR_ROWS, Lidar, Sensor, Sensors, Sight};
use fiatlux_world::{Random, Scene, ShapeOwner, Stream};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::query::Ray;
use parry3d_f64::shape::SharedShape;

const RANGE: f64 = 10.0;

/// Starts of tasks, and the robot and a ladder that moves in any pose, often close or overlapping.
fn cases() -> Vec<(Arc<Scene>, Row)> {
    let mut cases: Vec<_> = [Task::S01, Task::S02, Task::S03, Task::Climb].map(start_row).into();
    let (scene, start) = start_row(Task::S02);
    let mut random = Random::new(Stream::Reset, 11, 0);
    for _ in 0..20 {
        let mut row = start.clone();
        let mut draw = |half: f64| random.uniform(-half, half);
        let mut vector = |half: f64| Vector3::new(draw(half), draw(half), draw(half));
        row.things[errand::LADDER].pose = Isometry3::new(vector(1.0) + Vector3::z(), vector(2.0));
        row.robot.pose = Isometry3::new(vector(0.8) + Vector3::z(), vector(2.5));
        for (angle, joint) in row.joint_position.iter_mut().zip(scene.robot.joints()) {
            *angle = random.uniform(joint.lower, joint.upper);
        }
        cases.push((Arc::clone(&scene), row));
    }
    cases
}

/// The ladder's shapes in the world.
fn ladder(scene: &Scene, row: &Row) -> Vec<(Isometry3<f64>, Geometry)> {
    let shapes = scene.model.shapes().iter().filter(|s| ShapeOwner::from_label(s.label) == ShapeOwner::LADDER);
    let world_from_body =
        if scene.body(errand::LADDER).is_some() { row.things[errand::LADDER].pose } else { Isometry3::identity() };
    shapes.map(|shape| (world_from_body * shape.body_from_shape, shape.geometry.clone())).collect()
}

/// Pose of the sensor by the robot's own kinematics.
fn sensor(scene: &Scene, row: &Row) -> Isometry3<f64> {
    let links = scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose).unwrap();
    links[scene.robot.link_index("mid360_link").unwrap()]
}

/// Direction of a ray in the sensor's frame: x turned up by the elevation, then about z by the azimuth.
fn direction(row: usize, column: usize) -> Vector3<f64> {
    let elevation = (-25.0 + 50.0 * row as f64 / 31.0).to_radians();
    let azimuth = (-180.0 + 2.0 * column as f64).to_radians();
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), azimuth)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -elevation);
    turned * Vector3::x()
}

/// Range to a box, found face by face.
fn to_box(eye: &Point3<f64>, along: &Vector3<f64>, pose: &Isometry3<f64>, half: &Vector3<f64>) -> f64 {
    let local = pose.inverse_transform_point(eye);
    if (0..3).all(|axis| local[axis].abs() <= half[axis]) {
        return 0.0;
    }
    let mut nearest = f64::INFINITY;
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let mut normal = Vector3::zeros();
        normal[axis] = side;
        let normal = pose.rotation * normal;
        let face = pose.translation.vector + normal * half[axis];
        let distance = (face - eye.coords).dot(&normal) / along.dot(&normal);
        let hit = pose.inverse_transform_point(&(eye + along * distance));
        let on_face = (0..3).filter(|other| *other != axis).all(|other| hit[other].abs() <= half[other]);
        if distance >= 0.0 && on_face {
            nearest = nearest.min(distance);
        }
    }
    nearest
}

/// Step by step, each as long as the capsule is far.
fn to_capsule(eye: &Point3<f64>, along: &Vector3<f64>, pose: &Isometry3<f64>, radius: f64, half_length: f64) -> f64 {
    let (eye, along) = (pose.inverse_transform_point(eye), pose.inverse_transform_vector(along));
    let mut distance = 0.0;
    for _ in 0..100_000 {
        let at = eye + along * distance;
        let axis = Vector3::new(0.0, 0.0, at.z.clamp(-half_length, half_length));
        let gap = (at.coords - axis).norm() - radius;
        if gap < 1e-9 {
            return distance;
        }
        distance += gap;
        if distance > RANGE {
            return f64::INFINITY;
        }
    }
    distance
}

#[test]
fn ranges_are_those_of_the_scene() {
    let (mut worst, mut hits) = (0.0_f64, [0_usize; 3]);
    for (scene, row) in cases() {
        let (world_from_sensor, shapes) = (sensor(&scene, &row), ladder(&scene, &row));
        let mut lidar = Lidar::new(&scene, Sight::Published).unwrap();
        let ranges = lidar.scan(&row);
        let eye = Point3::from(world_from_sensor.translation.vector);
        for (ray, range) in ranges.iter().enumerate() {
            let along = world_from_sensor * direction(ray / LIDAR_COLUMNS, ray % LIDAR_COLUMNS);
            let floor = -eye.z / along.z;
            let floor = if floor >= 0.0 { floor } else { f64::INFINITY };
            let (mut boxes, mut capsules) = (f64::INFINITY, f64::INFINITY);
            for (pose, geometry) in &shapes {
                match geometry {
                    Geometry::Cuboid { half_extents } => boxes = boxes.min(to_box(&eye, &along, pose, half_extents)),
                    Geometry::Capsule { radius, half_length } => {
                        capsules = capsules.min(to_capsule(&eye, &along, pose, *radius, *half_length));
                    }
                    other => panic!("the ladder has a {other:?}"),
                }
            }
            let expected = floor.min(boxes).min(capsules).min(RANGE);
            for (hit, kind) in hits.iter_mut().zip([floor, boxes, capsules]) {
                *hit += usize::from(kind == expected);
            }
            let error = (f64::from(*range) - expected).abs();
            worst = worst.max(error);
            assert!(error < 1e-3, "step {}, ray {ray}: {range} m, not {expected} m", row.step);
        }
    }
    println!("largest error {worst:.2e} m; hits on floor, boxes, capsules {hits:?}");
    assert!(hits.iter().all(|hits| *hits > 1000), "the scenes show too little: {hits:?}");
}

#[test]
fn ranges_are_those_of_parry() {
    compare_with_parry(Sight::Published, ladder);
}

/// With walls, ceiling, bench, crate and fixture too, the sensor among them and inside them.
#[test]
fn ranges_in_the_room_are_those_of_parry() {
    let everything = |scene: &Scene, row: &Row| {
        let fast = [ShapeOwner::Room, ShapeOwner::Bench, ShapeOwner::CRATE, ShapeOwner::FIXTURE];
        let shapes = scene.model.shapes().iter().filter(|s| fast.contains(&ShapeOwner::from_label(s.label)));
        ladder(scene, row)
            .into_iter()
            .chain(shapes.map(|shape| (shape.body_from_shape, shape.geometry.clone())))
            .collect()
    };
    compare_with_parry(Sight::Room, everything);
}

/// The room hides nothing that the published LiDAR sees nearer, and the flat vector keeps the published ranges.
#[test]
fn the_room_is_seen_only_where_it_is_asked_for() {
    let (scene, row) = start_row(Task::S08);
    let sensors = Sensors::of(&[Sensor::Lidar, Sensor::Flat]);
    let [mut published, mut room] =
        [Sight::Published, Sight::Room].map(|sight| Rig::with_sight(&scene, &row, Task::S08, sensors, None, sight));
    let [before, after] = [&mut published, &mut room].map(|rig| rig.compute(Sensor::Lidar, &row));
    assert!(before.iter().zip(&after).all(|(before, after)| after <= before));
    assert!(before.iter().zip(&after).filter(|(before, after)| after < before).count() > 1000);
    assert_eq!(published.compute(Sensor::Flat, &row), room.compute(Sensor::Flat, &row));
    assert_eq!(room.compute(Sensor::Lidar, &row), after);
}

fn compare_with_parry(sight: Sight, shapes: impl Fn(&Scene, &Row) -> Vec<(Isometry3<f64>, Geometry)>) {
    let mut worst = 0.0_f64;
    for (scene, row) in cases() {
        let world_from_sensor = sensor(&scene, &row);
        let shapes: Vec<(Pose, SharedShape)> = shapes(&scene, &row)
            .into_iter()
            .map(|(pose, geometry)| {
                let shape = match geometry {
                    Geometry::Cuboid { half_extents: h } => SharedShape::cuboid(h.x, h.y, h.z),
                    Geometry::Capsule { radius, half_length } => SharedShape::capsule_z(half_length, radius),
                    other => panic!("the ladder has a {other:?}"),
                };
                let (at, turn) = (pose.translation.vector, pose.rotation.coords);
                let rotation = Rotation::from_xyzw(turn.x, turn.y, turn.z, turn.w);
                (Pose { rotation, translation: Vector::new(at.x, at.y, at.z) }, shape)
            })
            .collect();
        let mut lidar = Lidar::new(&scene, sight).unwrap();
        let ranges = lidar.scan(&row);
        let eye = world_from_sensor.translation.vector;
        for (ray, range) in ranges.iter().enumerate() {
            let along = world_from_sensor * direction(ray / LIDAR_COLUMNS, ray % LIDAR_COLUMNS);
            let line = Ray::new(Vector::new(eye.x, eye.y, eye.z), Vector::new(along.x, along.y, along.z));
            let floor = -eye.z / along.z;
            let floor = if floor >= 0.0 { floor } else { RANGE };
            let hits = shapes.iter().filter_map(|(pose, shape)| shape.cast_ray(pose, &line, RANGE, true));
            let expected = hits.fold(floor.min(RANGE), f64::min);
            worst = worst.max((f64::from(*range) - expected).abs());
        }
    }
    println!("largest difference from Parry {worst:.2e} m");
    assert!(worst < 1e-3, "{worst}");
}

/// The standing robot's sensor is upside down: row 0 looks 25 degrees up, columns turn to the right, column 90 ahead; and
/// it leans back by the mount's 2.9 degrees, which is down at the front of an upside-down frame.
#[test]
fn the_sensor_hangs_upside_down_in_the_head() {
    let (scene, mut row) = start_row(Task::S01);
    row.robot.pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.79), UnitQuaternion::identity());
    row.joint_position = crate::common::q0(&scene);
    row.things[errand::LADDER].pose = Isometry3::translation(0.0, 50.0, 0.0);
    let mut lidar = Lidar::new(&scene, Sight::Published).unwrap();
    let pose = lidar.world_from_sensor(&row);
    // The published place of the mount on the standing robot.
    assert!((pose.translation.z - 1.260).abs() < 0.005, "{pose}");
    assert!((pose.rotation * Vector3::z()).z < -0.99 && (pose.rotation * Vector3::x()).x > 0.99, "{pose}");
    assert!((pose.rotation * Vector3::y()).y < -0.99, "{pose}");
    let ranges = lidar.scan(&row);
    assert_eq!(ranges[..LIDAR_COLUMNS], [10.0; LIDAR_COLUMNS]);
    // Straight ahead and straight behind, the mount's pitch adds to the ray's own.
    for (column, pitch) in [(90, 0.051120693791), (0, -0.051120693791)] {
        let below = 25.0 * PI / 180.0 + pitch;
        let expected = pose.translation.z / below.sin();
        let found = f64::from(ranges[(LIDAR_ROWS - 1) * LIDAR_COLUMNS + column]);
        assert!((found - expected).abs() < 1e-5, "column {column}: {found}, not {expected}");
    }
}

#[test]
fn points_are_the_hits() {
    let (scene, row) = start_row(Task::S02);
    let mut lidar = Lidar::new(&scene, Sight::Published).unwrap();
    lidar.scan(&row);
    let world_from_sensor = lidar.world_from_sensor(&row);
    let ladder_top = scene.config.ladder.size[2] as f32;
    let points: Vec<[f32; 3]> = lidar.points().collect();
    assert_eq!(points.len(), lidar.ranges().iter().filter(|range| **range < 10.0).count());
    assert!(points.len() > 1000 && points.len() < LIDAR_RAYS);
    let hits = lidar.ranges().iter().filter(|range| **range < 10.0);
    for (point, range) in points.iter().zip(hits) {
        let point = Point3::from(point.map(f64::from));
        assert!((point.coords.norm() - f64::from(*range)).abs() < 1e-5);
        let height = (world_from_sensor * point).z as f32;
        assert!(height > -1e-4 && height < ladder_top + 1e-4, "{height}");
    }
}

#[test]
fn a_robot_without_a_lidar_is_refused() {
    let published = include_str!("../../../robot/robots/g1_inspire.toml");
    let without = published.replace("lidar = \"mid360_link\"\n", "");
    assert!(without.len() < published.len());
    let robot = Arc::new(Robot::from_toml(&without).unwrap());
    let (scene, _) = start_row(Task::S02);
    let blind = Scene::build(&scene.config, robot, scene.spec.clone()).unwrap();
    let message = Lidar::new(&blind, Sight::Published).unwrap_err().to_string();
    assert!(message.contains("'g1_inspire' has 0 LiDAR mounts"), "{message}");
}

/// In `climb` a row's ladder pose cannot move the ladder that stands fast, and one scan leaves nothing for the next.
#[test]
fn a_fixed_ladder_stays_and_scans_are_independent() {
    let (scene, row) = start_row(Task::Climb);
    let mut moved = row.clone();
    moved.things[errand::LADDER].pose = Isometry3::identity();
    let mut lidar = Lidar::new(&scene, Sight::Published).unwrap();
    let first = *lidar.scan(&row);
    assert_eq!(first, *lidar.scan(&moved));
    let mut elsewhere = row.clone();
    elsewhere.robot.pose.translation.x += 0.3;
    assert_ne!(first, *lidar.scan(&elsewhere));
    assert_eq!(first, *lidar.scan(&row));
}
