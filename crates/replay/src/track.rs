//! The rows of an episode as a block of bytes: poses and forces of kept rows, conditions of all.
//!
//! A row takes 2 kB here, and the longest task has 72,001 rows. Memory is limited in a single pass: when there are too
//! many kept rows, every second one is dropped and the distance between them doubles. Conditions and the force on the
//! hands are small and kept for every row, so that nothing that lasts for one row is lost.

use std::ops::Range;

use fiatlux_robot::{Robot, RobotError};
use fiatlux_rules::{Bulb, Group, Measure, Partner, RobotLayout, Row, errand, manifest, measure};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

use crate::conditions::flag;
use crate::scene::framed_things;

pub const MAGIC: [u8; 4] = *b"FLTR";
pub const TRACK_VERSION: u32 = 1;
/// Numbers of a pose: position x, y, z in m, then the quaternion w, x, y, z.
pub const POSE: usize = 7;
/// Maximum number of rows whose poses are kept: 42 MB for the benchmark's robot.
pub const MAX_KEPT_ROWS: usize = 20_000;

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

pub(crate) fn joint_names(robot: &Robot) -> Vec<JointName> {
    let name =
        |joint: &fiatlux_robot::Joint| JointName { name: joint.name.clone(), effort_limit: joint.gains.effort_limit };
    robot.joints().iter().map(name).collect()
}

/// Collects rows into a track, and thins out their poses.
#[derive(Debug)]
pub(crate) struct Track {
    most: usize,
    frames: usize,
    forces: Vec<Force>,
    /// Distance in rows between two kept ones.
    stride: usize,
    kept_steps: Vec<u32>,
    /// Poses of all frames, then forces, of each kept row.
    kept: Vec<f32>,
    /// Angle, target and effort of all joints, of each kept row.
    joints: Vec<f32>,
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
        Self {
            most: most.max(2),
            frames: robot.links().len() + framed_things().count(),
            forces: forces(robot),
            stride: 1,
            kept_steps: Vec::new(),
            kept: Vec::new(),
            joints: Vec::new(),
            steps: Vec::new(),
            flags: Vec::new(),
            hand_force: Vec::new(),
        }
    }

    /// Adds the next row, with the flags of its conditions.
    ///
    /// # Errors
    /// The row is not a posture of the robot; nothing is added then.
    pub fn push(&mut self, row: &Row, robot: &Robot, conditions: u32) -> Result<(), RobotError> {
        // The caller reads no rows of later steps.
        let step = u32::try_from(row.step).unwrap_or(u32::MAX);
        if self.steps.len().is_multiple_of(self.stride) {
            let links = robot.forward_kinematics(&row.joint_position, &row.robot.pose)?;
            self.kept_steps.push(step);
            let things = framed_things().map(|(thing, _)| &row.things[thing].pose);
            self.kept.extend(links.iter().chain(things).flat_map(pose));
            let joints = [&row.joint_position, &row.joint_target, &row.joint_effort];
            self.joints.extend(joints.into_iter().flatten().map(|number| *number as f32));
            for force in &self.forces {
                let sum: Vector3<f64> = row.forces[force.of.clone()].iter().sum();
                self.kept.extend(sum.iter().map(|number| *number as f32));
            }
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
        Ok(())
    }

    /// Drops every second kept row.
    fn thin_out(&mut self) {
        let (width, joints) = (self.width(), self.joints.len() / self.kept_steps.len().max(1));
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
        POSE * self.frames + 3 * self.forces.len()
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
        self.joints.iter().flat_map(|number| number.to_le_bytes()).collect()
    }

    /// The track as bytes, in the layout that [`Replay::track`](crate::Replay::track) describes.
    pub fn bytes(&self) -> Vec<u8> {
        let counts = [TRACK_VERSION, self.rows() as u32, self.kept() as u32, self.width() as u32];
        let mut bytes = Vec::with_capacity(20 + 12 * self.rows() + 4 * self.kept() + 4 * self.kept.len());
        bytes.extend(MAGIC);
        for words in [&counts[..], &self.steps, &self.flags] {
            bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
        }
        bytes.extend(self.hand_force.iter().flat_map(|force| force.to_le_bytes()));
        bytes.extend(self.kept_steps.iter().flat_map(|step| step.to_le_bytes()));
        bytes.extend(self.kept.iter().flat_map(|number| number.to_le_bytes()));
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

fn pose(pose: &Isometry3<f64>) -> [f32; POSE] {
    let (at, turn) = (&pose.translation.vector, pose.rotation.quaternion());
    [at.x, at.y, at.z, turn.w, turn.i, turn.j, turn.k].map(|number| number as f32)
}
