//! A room to move things in: the ladder below a ceiling fixture, a crate, and a fresh bulb on its bench.
#![allow(dead_code)] // Each test file uses a part of it.

use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_rules::{
    AttachmentRow, BodyRow, Bulb, JointGroups, Judge, JudgeOptions, Protocol, RobotLayout, Row, Task, Thresholds,
    errand,
};
mod geometry;

pub use geometry::geometry;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// The G1 with Inspire hands.
pub const LAYOUT: RobotLayout = RobotLayout { joints: 53, hand_bodies_per_side: 17 };

/// Its joints that rewards read, with the limits of its ankles.
pub fn joint_groups() -> JointGroups {
    #[expect(clippy::approx_constant, reason = "a rounded figure of the robot's file")]
    let (pitch, roll) = ([-0.87267, 0.5236], [-0.2618, 0.2618]);
    JointGroups {
        legs: vec![0, 1, 2, 3, 6, 7, 8, 9],
        ankles: vec![(4, pitch), (5, roll), (10, pitch), (11, roll)],
        waist: vec![12, 13, 14],
        fingers: (29..53).collect(),
    }
}

pub const LADDER: [f64; 3] = [2.0, 1.0, 0.0];
pub const FIXTURE: [f64; 3] = [2.0, 1.48, 2.2];
pub const CRATE: [f64; 3] = [-2.0, 1.0, 0.0];
pub const FRESH: [f64; 3] = [-2.1, -1.72, 0.9941 - 0.036259];
pub const OLD: usize = Bulb::Old as usize;
pub const NEW: usize = Bulb::Fresh as usize;
/// Two finger links of the right hand, one of the left.
pub const RIGHT: [usize; 2] = [10, 12];
pub const LEFT: usize = 27;

pub fn at(p: [f64; 3]) -> Isometry3<f64> {
    Isometry3::translation(p[0], p[1], p[2])
}

pub fn rotated(p: [f64; 3], axis: Vector3<f64>, angle: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(Vector3::from(p)), UnitQuaternion::from_scaled_axis(axis * angle))
}

/// Socket that opens downwards.
pub fn fixture() -> Isometry3<f64> {
    rotated(FIXTURE, Vector3::y(), PI)
}

pub fn body(pose: Isometry3<f64>) -> BodyRow {
    BodyRow { pose, linear_velocity: Vector3::zeros(), angular_velocity: Vector3::zeros() }
}

/// The old bulb in the socket, the fresh one on the bench, the robot on its feet at the origin.
pub fn room() -> Row {
    Row {
        robot: body(at([0.0, 0.0, 0.79])),
        world_from_palm: [at([0.2, 0.2, 0.7]), at([0.2, -0.2, 0.7])],
        // In the order of the manifest.
        things: [at(LADDER), fixture(), at(FRESH), fixture(), at(CRATE)].map(body).to_vec(),
        attachments: vec![AttachmentRow { seated: true, steps_beyond: 0 }, AttachmentRow::FREE],
        ..Row::zeros(LAYOUT)
    }
}

/// The robot with its pelvis at a place, turned towards another.
pub fn stand(row: &mut Row, p: [f64; 3], towards: [f64; 3]) {
    let yaw = libm::atan2(towards[1] - p[1], towards[0] - p[0]);
    row.robot = body(rotated(p, Vector3::z(), yaw));
}

/// On the platform, facing the fixture.
pub fn stand_on_platform(row: &mut Row) {
    row.robot = body(rotated([2.0, 1.1, 1.967], Vector3::z(), FRAC_PI_2));
}

/// A bulb in the right hand, in front of the pelvis.
pub fn take(row: &mut Row, bulb: usize) {
    row.attachments[bulb].seated = false;
    let world_from_bulb = row.robot.pose * rotated([0.35, -0.1, 0.2], Vector3::x(), 1.2);
    row.things[errand::BULBS[bulb]] = body(world_from_bulb);
    touch(row, bulb, RIGHT[0], 6.0);
    touch(row, bulb, RIGHT[1], -6.0);
}

pub fn touch(row: &mut Row, bulb: usize, hand_body: usize, newtons: f64) {
    row.force_mut(errand::HAND_FORCE[bulb])[hand_body] = Vector3::new(0.6, 0.0, -0.8) * newtons;
}

pub fn let_go(row: &mut Row, bulb: usize) {
    row.force_mut(errand::HAND_FORCE[bulb]).fill(Vector3::zeros());
}

/// Forces of the old, then of the fresh bulb on the hand bodies.
pub fn hand_forces(row: &mut Row) -> impl Iterator<Item = &mut Vector3<f64>> {
    let count = errand::HAND_FORCE.map(|measure| row.force(measure).len()).iter().sum();
    row.forces[..count].iter_mut()
}

pub fn put_in_crate(row: &mut Row, bulb: usize) {
    row.attachments[bulb].seated = false;
    row.things[errand::BULBS[bulb]] =
        body(rotated([CRATE[0], CRATE[1] + 0.11, 0.004 + 0.0396], Vector3::x(), FRAC_PI_2));
    let_go(row, bulb);
}

pub fn put_in_socket(row: &mut Row, bulb: usize) {
    row.things[errand::BULBS[bulb]] = body(row.things[errand::FIXTURE].pose);
    row.attachments[bulb].seated = true;
    let_go(row, bulb);
}

/// The pelvis leans over by 1.1 rad where it is.
pub fn topple(row: &mut Row) {
    row.robot.pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::y() * 1.1);
}

/// The ladder leans by 0.65 rad, its top point where it was.
pub fn lean_ladder(row: &mut Row) {
    let top = Vector3::new(0.0, 0.1, 1.18);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::x() * 0.65);
    let world_top = row.things[errand::LADDER].pose * nalgebra::Point3::from(top);
    row.things[errand::LADDER].pose = Isometry3::from_parts((world_top.coords - rotation * top).into(), rotation);
}

/// The ladder leans by 0.65 rad, its root where it was.
pub fn lean_ladder_at_root(row: &mut Row) {
    row.things[errand::LADDER].pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::x() * 0.65);
}

pub fn start_of(task: Task) -> Row {
    let mut row = room();
    let r = &mut row;
    match task {
        Task::S01 | Task::Replace => {
            r.things[errand::LADDER] = body(rotated([-1.0, 3.0, 0.0], Vector3::z(), 0.7));
            stand(r, [0.0, 0.0, 0.79], [-1.0, 3.0, 0.0]);
        }
        Task::S02 => stand(r, [2.0, 0.15, 0.79], LADDER),
        Task::S03 => stand_on_platform(r),
        Task::S04 => {
            stand_on_platform(r);
            take(r, OLD);
        }
        Task::S05 => {
            stand(r, [1.2, 0.8, 0.79], CRATE);
            take(r, OLD);
        }
        Task::S06 => {
            stand(r, [-1.5, 1.0, 0.79], CRATE);
            take(r, OLD);
        }
        Task::S07 => {
            put_in_crate(r, OLD);
            stand(r, [-1.25, 1.0, 0.79], FRESH);
        }
        Task::S08 => {
            put_in_crate(r, OLD);
            stand(r, [FRESH[0] + 0.30, FRESH[1] + 0.55, 0.79], FRESH);
        }
        Task::S09 => {
            put_in_crate(r, OLD);
            stand(r, [-1.5, -1.08, 0.79], LADDER);
            take(r, NEW);
        }
        Task::S10 => {
            put_in_crate(r, OLD);
            stand(r, [2.0, 0.15, 0.79], LADDER);
            take(r, NEW);
        }
        Task::S11 => {
            put_in_crate(r, OLD);
            stand_on_platform(r);
            take(r, NEW);
        }
        Task::S12 => {
            put_in_crate(r, OLD);
            stand_on_platform(r);
            put_in_socket(r, NEW);
        }
        Task::Climb => {
            r.things[errand::LADDER] = body(rotated([1.6, 0.0, 0.0], Vector3::z(), -FRAC_PI_2));
            r.things[errand::FIXTURE].pose = rotated([1.9, 0.0, 2.8], Vector3::y(), PI);
            r.things[errand::OLD_BULB] = body(at([0.5, -0.6, -0.036]));
            r.things[errand::FRESH_BULB] = body(at([0.5, -0.8, -0.036]));
            r.attachments[OLD].seated = false;
            stand(r, [0.75, 0.0, 0.79], [1.6, 0.0, 0.0]);
        }
    }
    row
}

/// A state in which a task's gate holds.
pub fn goal_of(task: Task) -> Row {
    let mut row = start_of(task);
    let r = &mut row;
    match task {
        Task::S01 => r.things[errand::LADDER] = body(at(LADDER)),
        Task::S02 => stand(r, [2.0, 0.75, 1.26], FIXTURE),
        Task::S03 => take(r, OLD),
        Task::S04 => {
            stand(r, [2.0, 0.45, 0.79], LADDER);
            take(r, OLD);
        }
        Task::S05 => {
            stand(r, [-1.25, 1.0, 0.79], CRATE);
            take(r, OLD);
        }
        Task::S06 => put_in_crate(r, OLD),
        Task::S07 => stand(r, [FRESH[0] + 0.3, FRESH[1] + 0.55, 0.79], FRESH),
        Task::S08 => {
            take(r, NEW);
            r.things[errand::BULBS[NEW]].pose.translation.vector.z += 0.15;
        }
        Task::S09 => {
            stand(r, [2.0, 0.2, 0.79], LADDER);
            take(r, NEW);
        }
        Task::S10 => {
            stand(r, [2.0, 0.75, 1.26], FIXTURE);
            take(r, NEW);
        }
        Task::S11 => put_in_socket(r, NEW),
        Task::S12 => stand(r, [2.0, 0.45, 0.79], LADDER),
        Task::Replace => {
            r.things[errand::LADDER] = body(at(LADDER));
            put_in_crate(r, OLD);
            put_in_socket(r, NEW);
        }
        Task::Climb => stand(r, [1.5, 0.0, 1.967], [2.0, 0.0, 0.0]),
    }
    row
}

pub fn judge(task: Task) -> Judge {
    judge_with(task, JudgeOptions::default())
}

pub fn judge_with(task: Task, options: JudgeOptions) -> Judge {
    Judge::new(Protocol::Published, task, Thresholds::default(), geometry(), options)
}

/// The same state as another row.
pub fn row_at(step: u64, state: &Row) -> Row {
    Row { step, ..state.clone() }
}

/// A small generator (splitmix64), so that tests draw the same everywhere.
pub struct Draw(pub u64);

impl Draw {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number that is uniform in [-1, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn one_in(&mut self, n: u64) -> bool {
        self.bits().is_multiple_of(n)
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::new(self.unit(), self.unit(), self.unit()) * size
    }

    /// A number that no simulator should give.
    pub fn junk(&mut self) -> f64 {
        [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -0.0][(self.bits() % 5) as usize]
    }

    pub fn pose(&mut self, size: f64) -> Isometry3<f64> {
        Isometry3::from_parts(self.vector(size).into(), UnitQuaternion::from_scaled_axis(self.vector(PI)))
    }

    pub fn body(&mut self) -> BodyRow {
        BodyRow { pose: self.pose(3.0), linear_velocity: self.vector(2.0), angular_velocity: self.vector(2.0) }
    }

    /// A row with every body, number and flag drawn at random.
    pub fn row(&mut self, step: u64) -> Row {
        let mut row = row_at(step, &room());
        row.robot = self.body();
        row.com_velocity = self.vector(1.0);
        row.things[errand::LADDER] = self.body();
        row.things[errand::OLD_BULB] = self.body();
        row.things[errand::FRESH_BULB] = self.body();
        for force in hand_forces(&mut row) {
            if self.one_in(5) {
                *force = self.vector(30.0);
            }
        }
        for q in row.joint_position.iter_mut().chain(&mut row.joint_velocity).chain(&mut row.action) {
            *q = self.unit();
        }
        row.force_mut(errand::LADDER_FORCE).fill_with(|| self.vector(3.0));
        row.attachments.fill_with(|| AttachmentRow { seated: self.one_in(2), steps_beyond: 0 });
        row
    }
}
