//! What a policy in training may see beside what the robot senses: exact, of the things around it.

use fiatlux_rules::{Bulb, Geometry, Row, Task};
use nalgebra::{Isometry3, Vector3};

/// The privileged terms of every task but `climb`: 48 numbers. Poses are of link origins in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Privileged {
    /// The pelvis.
    pub robot: Isometry3<f64>,
    /// The ladder.
    pub ladder: Isometry3<f64>,
    /// The socket.
    pub socket: Isometry3<f64>,
    /// The fresh bulb.
    pub fresh_bulb: Isometry3<f64>,
    /// The old bulb.
    pub old_bulb: Isometry3<f64>,
    /// The crate.
    pub crate_: Isometry3<f64>,
    /// d1 to d4, those of the full errand's rewards, m: the ladder's top point from the seat, the fresh bulb's plug from
    /// the seat, the old bulb's plug from the seat, the old bulb's origin from the crate's. A seated bulb changes none.
    pub distances: [f64; 4],
    /// Whether the old and the fresh bulb are held in the socket.
    pub seated: [bool; 2],
}

impl Privileged {
    /// Count of its numbers.
    pub const LENGTH: usize = 48;

    /// Reads them off a row.
    pub fn measure(geometry: &Geometry, row: &Row) -> Self {
        let old_bulb = row.bulbs[Bulb::Old as usize].pose;
        Self {
            robot: row.robot.pose,
            ladder: row.ladder.pose,
            socket: row.fixture,
            fresh_bulb: row.bulbs[Bulb::Fresh as usize].pose,
            old_bulb,
            crate_: row.crate_,
            distances: [
                (geometry.ladder_top(row) - geometry.seat(row)).norm(),
                geometry.plug_distance(row, Bulb::Fresh),
                geometry.plug_distance(row, Bulb::Old),
                (old_bulb.translation.vector - row.crate_.translation.vector).norm(),
            ],
            seated: Bulb::ALL.map(|bulb| row.attachments[bulb as usize].seated),
        }
    }

    /// In the order of the fields; a pose is x, y, z, then the quaternion w, x, y, z; a flag is 0 or 1.
    pub fn flat(&self) -> [f64; Self::LENGTH] {
        let poses = [&self.robot, &self.ladder, &self.socket, &self.fresh_bulb, &self.old_bulb, &self.crate_];
        let poses = poses.into_iter().flat_map(flat_pose);
        fill(poses.chain(self.distances).chain(self.seated.map(|seated| f64::from(u8::from(seated)))))
    }
}

/// The privileged terms of `climb`: 17 numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct ClimbPrivileged {
    /// The pelvis.
    pub robot: Isometry3<f64>,
    /// Velocity of the pelvis link's origin, pelvis frame, m/s, without noise.
    pub linear_velocity: Vector3<f64>,
    /// The ladder.
    pub ladder: Isometry3<f64>,
}

impl ClimbPrivileged {
    /// Count of its numbers.
    pub const LENGTH: usize = 17;

    /// Reads them off a row.
    pub fn measure(row: &Row) -> Self {
        Self {
            robot: row.robot.pose,
            linear_velocity: row.robot.pose.rotation.inverse_transform_vector(&row.robot.linear_velocity),
            ladder: row.ladder.pose,
        }
    }

    /// In the order of the fields, poses as in [`Privileged::flat`].
    pub fn flat(&self) -> [f64; Self::LENGTH] {
        let velocity: [f64; 3] = self.linear_velocity.into();
        fill(flat_pose(&self.robot).into_iter().chain(velocity).chain(flat_pose(&self.ladder)))
    }
}

/// The privileged vector of a task: 48 numbers, and 17 in `climb`.
pub fn flat_privileged(geometry: &Geometry, row: &Row, task: Task) -> Vec<f32> {
    let single = |numbers: &[f64]| numbers.iter().map(|number| *number as f32).collect();
    match task {
        Task::Climb => single(&ClimbPrivileged::measure(row).flat()),
        _ => single(&Privileged::measure(geometry, row).flat()),
    }
}

fn flat_pose(pose: &Isometry3<f64>) -> [f64; 7] {
    let (at, turn) = (&pose.translation.vector, pose.rotation.quaternion());
    [at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]
}

fn fill<const N: usize>(numbers: impl Iterator<Item = f64>) -> [f64; N] {
    let mut flat = [0.0; N];
    flat.iter_mut().zip(numbers).for_each(|(place, number)| *place = number);
    flat
}
