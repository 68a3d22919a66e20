//! Exact poses and distances, which no robot senses.

use fiatlux_proto::v3;
use fiatlux_rules::{Bulb, Geometry, Row, Task, errand};
use fiatlux_wire::pose_message;
use nalgebra::{Isometry3, Vector3};

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "privileged",
    class: Class::Privileged,
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, _, out| {
        match view.task {
            Task::Climb => out.extend(&ClimbPrivileged::measure(view.row).flat()),
            _ => out.extend(&Privileged::measure(view.judge.geometry(), view.row).flat()),
        }
        Ok(())
    },
    encode: |view, _, observation| {
        observation.privileged = Some(match view.task {
            Task::Climb => ClimbPrivileged::measure(view.row).message(),
            _ => Privileged::measure(view.judge.geometry(), view.row).message(),
        });
        Ok(())
    },
};

fn terms(setup: &Setup) -> Vec<Term> {
    fn pose(
        [position, quaternion]: [&'static str; 2],
        [position_field, quaternion_field]: [&'static str; 2],
    ) -> [Term; 2] {
        [
            Term::new(position, position_field, &[3], "m", "origin in the world"),
            Term::new(quaternion, quaternion_field, &[4], "", "turn in the world: w, x, y, z").within(-1.0, 1.0),
        ]
    }
    /// The terms of a pose, by the name of its field.
    macro_rules! pose {
        ($name:literal) => {
            pose(
                [concat!($name, "_position"), concat!($name, "_quaternion")],
                [concat!("privileged.", $name, ".position"), concat!("privileged.", $name, ".quaternion")],
            )
        };
    }
    if setup.task == Task::Climb {
        let meaning = "velocity of the pelvis, pelvis frame, without noise";
        let velocity = Term::new("linear_velocity", "privileged.linear_velocity", &[3], "m/s", meaning);
        return pose!("robot").into_iter().chain([velocity]).chain(pose!("ladder")).collect();
    }
    let poses =
        [pose!("robot"), pose!("ladder"), pose!("socket"), pose!("fresh_bulb"), pose!("old_bulb"), pose!("crate")];
    let distances = "ladder's top point from the seat, fresh plug from the seat, old plug from the seat, old bulb's \
                     origin from the crate's";
    let rest = [
        Term::new("distances", "privileged.distances", &[4], "m", distances).within(0.0, f64::INFINITY),
        Term::new("seated", "privileged.seated", &[2], "", "old bulb seated, fresh bulb seated: 0 or 1")
            .within(0.0, 1.0),
    ];
    poses.into_iter().flatten().chain(rest).collect()
}

fn pose(pose: &Isometry3<f64>) -> Option<v3::Pose> {
    Some(pose_message(pose))
}

/// The privileged terms of every task but `climb`: 48 numbers. Poses are of link origins in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Privileged {
    /// Pose of the pelvis, m.
    pub robot: Isometry3<f64>,
    /// Pose of the ladder, m.
    pub ladder: Isometry3<f64>,
    /// Pose of the socket, m.
    pub socket: Isometry3<f64>,
    /// Pose of the fresh bulb, m.
    pub fresh_bulb: Isometry3<f64>,
    /// Pose of the old bulb, m.
    pub old_bulb: Isometry3<f64>,
    /// Pose of the crate, m.
    pub crate_: Isometry3<f64>,
    /// d1 to d4, those of the full errand's rewards, m: the ladder's top point from the seat, the fresh bulb's plug from
    /// the seat, the old bulb's plug from the seat, the old bulb's origin from the crate's. A seated bulb changes none.
    pub distances: [f64; 4],
    /// The old and the fresh bulb are held in the socket.
    pub seated: [bool; 2],
}

impl Privileged {
    /// Count of its numbers.
    pub const LENGTH: usize = 48;

    /// Reads them off a row.
    pub fn measure(geometry: &Geometry, row: &Row) -> Self {
        let old_bulb = row.things[errand::OLD_BULB].pose;
        Self {
            robot: row.robot.pose,
            ladder: row.things[errand::LADDER].pose,
            socket: row.things[errand::FIXTURE].pose,
            fresh_bulb: row.things[errand::FRESH_BULB].pose,
            old_bulb,
            crate_: row.things[errand::CRATE].pose,
            distances: [
                (geometry.ladder_top(row) - geometry.seat(row)).norm(),
                geometry.plug_distance(row, Bulb::Fresh),
                geometry.plug_distance(row, Bulb::Old),
                (old_bulb.translation.vector - row.things[errand::CRATE].pose.translation.vector).norm(),
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

    fn message(&self) -> v3::Privileged {
        v3::Privileged {
            robot: pose(&self.robot),
            ladder: pose(&self.ladder),
            socket: pose(&self.socket),
            fresh_bulb: pose(&self.fresh_bulb),
            old_bulb: pose(&self.old_bulb),
            crate_: pose(&self.crate_),
            distances: self.distances.into(),
            seated: self.seated.into(),
            linear_velocity: Vec::new(),
        }
    }
}

/// The privileged terms of `climb`: 17 numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct ClimbPrivileged {
    /// Pose of the pelvis, m.
    pub robot: Isometry3<f64>,
    /// Velocity of the pelvis link's origin, pelvis frame, m/s, without noise.
    pub linear_velocity: Vector3<f64>,
    /// Pose of the ladder, m.
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
            ladder: row.things[errand::LADDER].pose,
        }
    }

    /// In the order of the fields, poses as in [`Privileged::flat`].
    pub fn flat(&self) -> [f64; Self::LENGTH] {
        let velocity: [f64; 3] = self.linear_velocity.into();
        fill(flat_pose(&self.robot).into_iter().chain(velocity).chain(flat_pose(&self.ladder)))
    }

    fn message(&self) -> v3::Privileged {
        v3::Privileged {
            robot: pose(&self.robot),
            ladder: pose(&self.ladder),
            linear_velocity: self.linear_velocity.as_slice().to_vec(),
            ..v3::Privileged::default()
        }
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
