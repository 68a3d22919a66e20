//! The rows of an episode as a block of bytes: postures and forces of kept rows, conditions of all.
//!
//! Links are not stored: the page computes their poses from the pelvis and the joints, by [`LinkInfo`]. Numbers are whole multiples
//! of a [`Grid`], fine enough that a link is off by less than 0.1 mm, and stored by [`planes`], which gzip makes small.
//!
//! The longest task has 72,001 rows. Memory is limited in a single pass: when there are too many kept rows, every second one is
//! dropped and the distance between them doubles. Conditions and the force on the hands are small and kept for every row, so that
//! nothing that lasts for one row is lost.

use std::ops::Range;

use fiatlux_robot::Robot;
use fiatlux_rules::{Bulb, Group, Measure, Partner, RobotLayout, Row, errand, manifest, measure};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

use crate::conditions::flag;
use crate::planes::planes;
use crate::scene::framed_things;

pub const MAGIC: [u8; 4] = *b"FLTR";
pub const TRACK_VERSION: u32 = 2;
/// Numbers of a pose: position x, y, z in m, then the quaternion w, x, y, z.
pub const POSE: usize = 7;
/// Maximum number of rows whose poses are kept: 42 MB in the page for the benchmark's robot.
pub const MAX_KEPT_ROWS: usize = 20_000;

/// The numbers of a track are whole multiples of these.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Grid {
    /// Of positions (m), parts of quaternions, and angles (rad).
    pub pose: f64,
    /// N.
    pub force: f64,
    /// N m.
    pub effort: f64,
}

/// Powers of two, so that single precision holds each multiple that occurs.
pub const GRID: Grid = Grid { pose: 1.0 / 131_072.0, force: 1.0 / 256.0, effort: 1.0 / 512.0 };

/// A contact force that every kept row has, in the world frame, N.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ForceName {
    /// The thing that exerts the force, such as `floor`.
    pub by: &'static str,
    /// Index of the frame on which it acts; it is drawn from the origin of that frame.
    pub frame: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointName {
    pub name: String,
    /// Limit on the effort of its drive, N m.
    pub effort_limit: f64,
}

/// The pose of a link follows from this, the pose of its parent and an angle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkInfo {
    /// Index of the parent, which is smaller; `None` for the pelvis, whose pose is in the rows.
    pub parent: Option<usize>,
    /// Pose in the parent at angle 0.
    pub at: [f64; POSE],
    /// Index of the joint that then turns it; `None` for a fixed link.
    pub joint: Option<usize>,
    /// Axis of that turn in the link's own frame.
    pub axis: [f64; 3],
}

pub(crate) fn link_infos(robot: &Robot) -> Vec<LinkInfo> {
    let info = |link: &fiatlux_robot::Link| LinkInfo {
        parent: link.parent,
        at: pose(&link.parent_from_link),
        joint: link.joint,
        axis: link.joint.map_or([0.0; 3], |joint| robot.joints()[joint].axis.into_inner().into()),
    };
    robot.links().iter().map(info).collect()
}

pub(crate) fn joint_names(robot: &Robot) -> Vec<JointName> {
    let name =
        |joint: &fiatlux_robot::Joint| JointName { name: joint.name.clone(), effort_limit: joint.gains.effort_limit };
    robot.joints().iter().map(name).collect()
}

/// Collects rows into a track, and thins out their poses.
#[derive(Debug)]
pub(crate) struct Track {
    most: usize,
    width: usize,
    joint_count: usize,
    forces: Vec<Force>,
    /// Distance in rows between two kept ones.
    stride: usize,
    kept_steps: Vec<u32>,
    /// Of each kept row: pose of the pelvis, angles, poses of things, forces.
    kept: Vec<i32>,
    /// Targets and efforts of all joints, of each kept row.
    joints: Vec<i32>,
    steps: Vec<u32>,
    flags: Vec<u32>,
    hand_force: Vec<f32>,
}

/// A force that is kept: the sum of some forces of a row.
#[derive(Debug, Clone)]
struct Force {
    name: ForceName,
    of: Range<usize>,
}

impl Track {
    pub fn new(robot: &Robot, most: usize) -> Self {
        let (forces, joint_count) = (forces(robot), robot.joints().len());
        Self {
            most: most.max(2),
            width: POSE * (1 + framed_things().count()) + joint_count + 3 * forces.len(),
            joint_count,
            forces,
            stride: 1,
            kept_steps: Vec::new(),
            kept: Vec::new(),
            joints: Vec::new(),
            steps: Vec::new(),
            flags: Vec::new(),
            hand_force: Vec::new(),
        }
    }

    /// Adds the next row, of the robot's layout, with the flags of its conditions.
    pub fn push(&mut self, row: &Row, conditions: u32) {
        // The caller reads no rows of later steps.
        let step = u32::try_from(row.step).unwrap_or(u32::MAX);
        if self.steps.len().is_multiple_of(self.stride) {
            self.kept_steps.push(step);
            let things = framed_things().flat_map(|(thing, _)| pose(&row.things[thing].pose));
            let numbers = pose(&row.robot.pose).into_iter().chain(row.joint_position.iter().copied()).chain(things);
            self.kept.extend(numbers.map(|number| on(number, GRID.pose)));
            for force in &self.forces {
                let sum: Vector3<f64> = row.forces[force.of.clone()].iter().sum();
                self.kept.extend(sum.iter().map(|newtons| on(*newtons, GRID.force)));
            }
            self.joints.extend(row.joint_target.iter().map(|angle| on(*angle, GRID.pose)));
            self.joints.extend(row.joint_effort.iter().map(|effort| on(*effort, GRID.effort)));
        }
        let seats = [(Bulb::Old, flag::OLD_SEATED), (Bulb::Fresh, flag::FRESH_SEATED)];
        let seated = seats.iter().filter(|(bulb, _)| row.attachments[*bulb as usize].seated);
        self.steps.push(step);
        self.flags.push(seated.fold(conditions, |flags, (_, bit)| flags | bit));
        let force = measure::largest(errand::HAND_FORCE.map(|force| measure::largest_norm(row.force(force))));
        self.hand_force.push(force as f32);
        if self.kept_steps.len() > self.most {
            self.thin_out();
        }
    }

    /// Drops every second kept row.
    fn thin_out(&mut self) {
        let (width, joints) = (self.width, 2 * self.joint_count);
        let kept = self.kept_steps.len().div_ceil(2);
        for index in 1..kept {
            self.kept_steps[index] = self.kept_steps[2 * index];
            self.kept.copy_within(2 * index * width..(2 * index + 1) * width, index * width);
            self.joints.copy_within(2 * index * joints..(2 * index + 1) * joints, index * joints);
        }
        self.kept_steps.truncate(kept);
        self.kept.truncate(kept * width);
        self.joints.truncate(kept * joints);
        self.stride *= 2;
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn kept(&self) -> usize {
        self.kept_steps.len()
    }

    pub fn rows(&self) -> usize {
        self.steps.len()
    }

    /// Control steps of the first and the last row; `None` without rows.
    pub fn span(&self) -> Option<[u32; 2]> {
        Some([*self.steps.first()?, *self.steps.last()?])
    }

    pub fn stride(&self) -> usize {
        self.stride
    }

    pub fn force_names(&self) -> Vec<ForceName> {
        self.forces.iter().map(|force| force.name.clone()).collect()
    }

    /// The joints of the kept rows as bytes, in the layout that [`Replay::joints`](crate::Replay::joints) describes.
    pub fn joint_bytes(&self) -> Vec<u8> {
        planes(&self.joints, 2 * self.joint_count)
    }

    /// The track as bytes, in the layout that [`Replay::track`](crate::Replay::track) describes.
    pub fn bytes(&self) -> Vec<u8> {
        let counts = [TRACK_VERSION, self.rows() as u32, self.kept() as u32, self.width as u32];
        let mut bytes = Vec::with_capacity(20 + 12 * self.rows() + 4 * self.kept() + 4 * self.kept.len());
        bytes.extend(MAGIC);
        for words in [&counts[..], &self.steps, &self.flags] {
            bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        }
        bytes.extend(self.hand_force.iter().flat_map(|force| force.to_le_bytes()));
        bytes.extend(self.kept_steps.iter().flat_map(|step| step.to_le_bytes()));
        bytes.extend(planes(&self.kept, self.width));
        bytes
    }
}

/// All forces of the manifest: those on hand bodies summed by hand, all others part by part.
fn forces(robot: &Robot) -> Vec<Force> {
    let side = |of: &[usize], side: usize| of.get(side).copied();
    let layout = RobotLayout { joints: robot.joints().len(), hand_bodies_per_side: robot.hand_links().len() / 2 };
    let mut forces = Vec::new();
    for contact in manifest().contacts.iter().filter(|contact| contact.measure == Measure::Force) {
        let by = match contact.with {
            Partner::Nothing => continue,
            Partner::Floor => "floor",
            Partner::Others => "others",
            Partner::Thing { thing, .. } => &manifest().things[thing].name,
        };
        let frames = match contact.of {
            // In rows the right hand comes first, on the robot the left palm.
            Group::HandBodies => vec![side(robot.palms(), 1), side(robot.palms(), 0)],
            Group::Limbs | Group::Supports => {
                vec![side(robot.feet(), 0), side(robot.feet(), 1), side(robot.palms(), 0), side(robot.palms(), 1)]
            }
            Group::Robot => vec![Some(0)],
            Group::Thing(thing) => {
                let place = framed_things().position(|(index, _)| index == thing);
                vec![place.map(|place| robot.links().len() + place)]
            }
        };
        let range = contact.range(layout);
        let each = range.len() / frames.len();
        for (part, frame) in frames.into_iter().enumerate() {
            let first = range.start + part * each;
            forces.extend(frame.map(|frame| Force { name: ForceName { by, frame }, of: first..first + each }));
        }
    }
    forces
}

fn pose(pose: &Isometry3<f64>) -> [f64; POSE] {
    let (at, turn) = (&pose.translation.vector, pose.rotation.quaternion());
    [at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k]
}

/// The nearest multiple of a step; the last one that fits for a number far outside of what occurs, 0 for NaN.
fn on(number: f64, step: f64) -> i32 {
    (number / step).round() as i32
}
