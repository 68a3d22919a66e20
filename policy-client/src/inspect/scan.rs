//! Where the LiDAR's rays hit, in the robot's frame.

use std::f64::consts::PI;

use fiatlux_proto::v3::{Observation, Pose, SessionInfo};
use fiatlux_robot::Robot;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Numbers of elevations and azimuths of a scan, and its range, m, as in `observation.proto`.
pub const ROWS: usize = 32;
pub const COLUMNS: usize = 180;
pub const RANGE: f32 = 10.0;
const ELEVATION: f64 = 25.0 * PI / 180.0;

/// The hits of a scan and known things in the room, in a level frame on the floor below the pelvis: x forwards, y left,
/// z up.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Points that rays hit, m.
    pub points: Vec<[f64; 3]>,
    /// Exact positions of things, m, by name; empty without the sensor `privileged`.
    pub things: Vec<(&'static str, [f64; 3])>,
}

impl Scan {
    /// Computes the scan from an observation. `None` if the joint angles are missing or the robot is unknown.
    pub fn of(info: &SessionInfo, observation: &Observation) -> Option<Self> {
        let own = observation.proprioception.as_ref()?;
        let exact = observation.privileged.as_ref();
        let robot = Robot::with_joints(info.joints.iter().map(|joint| joint.name.as_str())).ok()?;
        let lidar = robot.lidar()?;
        let angles = own.joint_position.iter().zip(&info.joints).map(|(angle, joint)| f64::from(*angle) + joint.q0);
        let angles: Vec<f64> = angles.collect();
        let world_from_pelvis = exact.and_then(|exact| pose(exact.robot.as_ref()?));
        let level_from_pelvis = match &world_from_pelvis {
            Some(world_from_pelvis) => level_from_world(world_from_pelvis) * world_from_pelvis,
            None => {
                let [x, y, z] = <[f32; 3]>::try_from(own.projected_gravity.as_slice()).ok()?.map(f64::from);
                let turn = UnitQuaternion::rotation_between(&Vector3::new(x, y, z), &-Vector3::z())?;
                Isometry3::from_parts(Translation3::new(0.0, 0.0, f64::from(own.base_height)), turn)
            }
        };
        let level_from_sensor = *robot.forward_kinematics(&angles, &level_from_pelvis).ok()?.get(lidar)?;
        let hits = observation.lidar.iter().enumerate().filter(|(_, range)| **range < RANGE);
        let point = |(ray, range): (usize, &f32)| {
            let hit = level_from_sensor * Point3::from(direction(ray) * f64::from(*range));
            hit.coords.into()
        };
        let mut things = Vec::new();
        if let (Some(exact), Some(world_from_pelvis)) = (exact, &world_from_pelvis) {
            let level_from_world = level_from_world(world_from_pelvis);
            let all = [
                ("ladder", &exact.ladder),
                ("crate", &exact.crate_),
                ("fresh bulb", &exact.fresh_bulb),
                ("old bulb", &exact.old_bulb),
                ("socket", &exact.socket),
            ];
            for (name, thing) in all {
                if let Some(pose) = thing.as_ref().and_then(pose) {
                    things.push((name, (level_from_world * pose).translation.vector.into()));
                }
            }
        }
        Some(Self { points: hits.map(point).collect(), things })
    }
}

/// Unit vector along a ray, in the sensor's frame.
fn direction(ray: usize) -> Vector3<f64> {
    let (row, column) = ((ray / COLUMNS) as f64, (ray % COLUMNS) as f64);
    let elevation = ELEVATION * (2.0 * row / (ROWS - 1) as f64 - 1.0);
    let (up, level) = elevation.sin_cos();
    let (left, ahead) = (2.0 * PI * column / COLUMNS as f64 - PI).sin_cos();
    Vector3::new(level * ahead, level * left, up)
}

/// The level frame below the pelvis, with its heading.
fn level_from_world(world_from_pelvis: &Isometry3<f64>) -> Isometry3<f64> {
    let ahead = world_from_pelvis * Vector3::x();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ahead.y.atan2(ahead.x));
    let place = world_from_pelvis.translation.vector;
    Isometry3::from_parts(Translation3::new(place.x, place.y, 0.0), turn).inverse()
}

fn pose(pose: &Pose) -> Option<Isometry3<f64>> {
    let [x, y, z] = *pose.position.as_array()?;
    let [w, i, j, k] = *pose.quaternion.as_array()?;
    Some(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9)?))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use fiatlux_proto::v3::{Joint, Privileged, Proprioception};

    use super::*;

    /// The floor is at height 0 wherever the pelvis stands and faces, and things on its left are on the left.
    #[test]
    fn hits_of_the_floor_lie_on_the_floor() {
        let robot = Robot::g1_inspire().unwrap();
        let joint = |(joint, q0): (&fiatlux_robot::Joint, &f64)| Joint {
            name: joint.name.clone(),
            q0: *q0,
            ..Joint::default()
        };
        let joints = robot.joints().iter().zip(robot.q0()).map(joint).collect();
        let info = SessionInfo { joints, ..SessionInfo::default() };
        let turn = UnitQuaternion::from_euler_angles(0.1, -0.2, 2.0);
        let world_from_pelvis = Isometry3::from_parts(Translation3::new(3.0, -1.0, 0.7), turn);
        let poses = robot.forward_kinematics(robot.q0(), &world_from_pelvis).unwrap();
        let world_from_sensor = poses[robot.lidar().unwrap()];
        let range = |ray| {
            let down = -(world_from_sensor * direction(ray)).z;
            let range = world_from_sensor.translation.z / down;
            if range > 0.0 && range < 10.0 { range as f32 } else { RANGE }
        };
        let message = |pose: &Isometry3<f64>| Pose {
            position: pose.translation.vector.as_slice().to_vec(),
            quaternion: vec![pose.rotation.w, pose.rotation.i, pose.rotation.j, pose.rotation.k],
        };
        let left = world_from_pelvis * Isometry3::translation(0.0, 1.0, 0.0);
        let own = Proprioception {
            projected_gravity: (turn.inverse() * -Vector3::z()).iter().map(|x| *x as f32).collect(),
            base_height: 0.7,
            joint_position: vec![0.0; info.joints.len()],
            ..Proprioception::default()
        };
        let mut observation = Observation {
            lidar: (0..ROWS * COLUMNS).map(range).collect(),
            proprioception: Some(own),
            privileged: Some(Privileged {
                robot: Some(message(&world_from_pelvis)),
                crate_: Some(message(&left)),
                ..Privileged::default()
            }),
            ..Observation::default()
        };
        let exact = Scan::of(&info, &observation).unwrap();
        assert!(exact.points.len() > 1000);
        assert!(exact.points.iter().all(|point| point[2].abs() < 1e-4), "{:?}", exact.points[0]);
        let [(name, crate_)] = exact.things.as_slice() else { panic!("{:?}", exact.things) };
        assert!(*name == "crate" && crate_[1] > 0.9, "{crate_:?}");
        // Gravity and height alone give the same floor.
        observation.privileged = None;
        let felt = Scan::of(&info, &observation).unwrap();
        assert!(felt.points.iter().all(|point| point[2].abs() < 1e-3) && felt.things.is_empty());
        observation.proprioception = None;
        assert_eq!(Scan::of(&info, &observation), None);
    }
}
