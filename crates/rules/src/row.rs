//! One row of state: everything that a gate, a reward or a metric reads, and that a world needs to continue from there.

use std::fmt;

use nalgebra::{Isometry3, Vector3};

use crate::errand::{Force, HAND_FORCE, Load, manifest};
use crate::manifest::{Group, Measure, Motion};
use crate::parts::{AttachmentRow, BodyRow, Bulb, RobotLayout};

/// Length of a control step, s: the time from one row to the next.
pub const CONTROL_DT: f64 = 0.02;

/// The parts among which the numbers of a field are divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum By {
    /// A single number.
    Nothing,
    /// By axis: x, y, z.
    Axis,
    /// A quaternion: w, x, y, z.
    Quaternion,
    /// A number for each joint.
    Joint,
    /// A number, or a vector, for each part of a sensed group.
    Part {
        /// The parts that are measured.
        of: Group,
        /// Each part has a vector.
        axes: bool,
    },
}

/// Some numbers of a row that belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field<'a> {
    /// The body that they are of; empty for the row itself.
    pub of: &'a str,
    /// Name of the field.
    pub name: &'a str,
    /// Grouping of its numbers.
    pub by: By,
}

impl fmt::Display for Field<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.of.is_empty() { f.write_str(self.name) } else { write!(f, "{}.{}", self.of, self.name) }
    }
}

/// The state after a control step; row 0 is the reset state. The robot's lists have the lengths of its [`RobotLayout`], those of
/// things and contacts also follow the [manifest](crate::Manifest).
#[derive(Debug, PartialEq)]
pub struct Row {
    /// Number of control steps since reset.
    pub step: u64,
    /// The sizes of the robot's lists.
    pub layout: RobotLayout,
    /// Pose and velocity of the robot's pelvis.
    pub robot: BodyRow,
    /// Velocity of the robot's centre of mass, m/s.
    pub com_velocity: Vector3<f64>,
    /// Poses of the left and the right palm in the world, m.
    pub world_from_palm: [Isometry3<f64>; 2],
    /// Angles of the joints, rad, in the public joint order.
    pub joint_position: Vec<f64>,
    /// Speeds of the joints in the same order, rad/s.
    pub joint_velocity: Vec<f64>,
    /// Targets that led to this row, rad.
    pub joint_target: Vec<f64>,
    /// Efforts that the drives applied in the last physics step, N m.
    pub joint_effort: Vec<f64>,
    /// The action that led to this row as it was received; in row 0 the staged posture in action units.
    pub action: Vec<f64>,
    /// For each thing, true if the scene has it.
    pub present: Vec<bool>,
    /// Pose and velocity of each thing. One that the scene lacks is at the origin; rules read [`Row::body`].
    pub things: Vec<BodyRow>,
    /// The socket's hold on each thing that it can hold: the bulbs, by [`Bulb`].
    pub attachments: Vec<AttachmentRow>,
    /// Contact forces of the last physics step, world axes, N, measure by measure: [`Row::force`].
    pub forces: Vec<Vector3<f64>>,
    /// Other measures, N but for numbers of another kind: [`Row::load`]. 0 in row 0, but for the peaks of the forces that it has.
    pub loads: Vec<f64>,
    /// Physics steps of this control step whose solve did not converge, on the second try either. In row 0, as `retried`, those
    /// of the staging.
    pub unconverged: u32,
    /// Physics steps of this control step whose first solve did not converge.
    pub retried: u32,
    /// Largest speed of a joint with a rated speed (the body's; fingers have none) at the end of a physics step of this
    /// control step, rad/s; 0 in row 0. Infinite where a physics step led to a state that is not finite: the row then has the
    /// state before it.
    pub joint_speed_peak: f64,
    /// Depth of the deepest contact point in the physics steps of this control step, m; 0 in row 0.
    pub penetration: f64,
}

impl Row {
    /// A row of step 0 with every number 0, every pose the identity, everything present and no bulb in the socket.
    pub fn zeros(layout: RobotLayout) -> Self {
        let manifest = manifest();
        let joints = vec![0.0; layout.joints];
        let origin = BodyRow::at_rest(Isometry3::identity());
        Self {
            step: 0,
            layout,
            robot: origin,
            com_velocity: Vector3::zeros(),
            world_from_palm: [Isometry3::identity(); 2],
            joint_position: joints.clone(),
            joint_velocity: joints.clone(),
            joint_target: joints.clone(),
            joint_effort: joints.clone(),
            action: joints,
            present: vec![true; manifest.things.len()],
            things: vec![origin; manifest.things.len()],
            attachments: vec![AttachmentRow::FREE; manifest.held_by_socket().count()],
            forces: vec![Vector3::zeros(); manifest.forces(layout)],
            loads: vec![0.0; manifest.loads(layout)],
            unconverged: 0,
            retried: 0,
            joint_speed_peak: 0.0,
            penetration: 0.0,
        }
    }

    /// A thing as rules see it: one that the scene lacks is far from everything, at rest and upright.
    pub fn body(&self, thing: usize) -> &BodyRow {
        if self.present[thing] { &self.things[thing] } else { manifest().nowhere(thing) }
    }

    /// Forces of a measure on the parts of its group, N.
    pub fn force(&self, measure: Force) -> &[Vector3<f64>] {
        &self.forces[manifest().contacts[measure.0].range(self.layout)]
    }

    /// The same, to write.
    pub fn force_mut(&mut self, measure: Force) -> &mut [Vector3<f64>] {
        &mut self.forces[manifest().contacts[measure.0].range(self.layout)]
    }

    /// Numbers of a measure for the parts of its group, N.
    pub fn load(&self, measure: Load) -> &[f64] {
        &self.loads[manifest().contacts[measure.0].range(self.layout)]
    }

    /// The same, to write.
    pub fn load_mut(&mut self, measure: Load) -> &mut [f64] {
        &mut self.loads[manifest().contacts[measure.0].range(self.layout)]
    }

    /// Contact force of a bulb on the bodies of the right hand, then of the left hand, world axes, N.
    pub fn hands(&self, bulb: Bulb) -> [&[Vector3<f64>]; 2] {
        let forces = self.force(HAND_FORCE[bulb as usize]);
        let (right, left) = forces.split_at(forces.len() / 2);
        [right, left]
    }

    /// True if all its lists have the lengths of a layout.
    pub fn fits(&self, layout: RobotLayout) -> bool {
        let manifest = manifest();
        let joints = [&self.joint_position, &self.joint_velocity, &self.joint_target, &self.joint_effort, &self.action];
        let others = [
            (self.present.len(), manifest.things.len()),
            (self.things.len(), manifest.things.len()),
            (self.attachments.len(), manifest.held_by_socket().count()),
            (self.forces.len(), manifest.forces(layout)),
            (self.loads.len(), manifest.loads(layout)),
        ];
        self.layout == layout
            && joints.iter().all(|list| list.len() == layout.joints)
            && others.iter().all(|(found, expected)| found == expected)
    }

    /// Gives all its numbers field by field, counts and flags as numbers: the one list of a row's fields that digest and
    /// comparison use. A thing that the scene lacks and the velocity of one that is fixed are left out.
    pub fn visit<'a>(&'a self, out: &mut impl FnMut(Field<'a>, &[f64])) {
        let manifest = manifest();
        let mut field = |of, name, by, numbers: &[f64]| out(Field { of, name, by }, numbers);
        field("", "step", By::Nothing, &[self.step as f64]);
        field("", "joints", By::Nothing, &[self.layout.joints as f64]);
        field("", "hand_bodies", By::Nothing, &[self.layout.hand_bodies() as f64]);
        visit_pose("robot", &self.robot.pose, &mut field);
        visit_velocity("robot", &self.robot, &mut field);
        field("", "com_velocity", By::Axis, self.com_velocity.as_slice());
        for (name, pose) in ["left_palm", "right_palm"].into_iter().zip(&self.world_from_palm) {
            visit_pose(name, pose, &mut field);
        }
        for (name, numbers) in self.by_joint() {
            field("", name, By::Joint, numbers);
        }
        for ((thing, present), body) in manifest.things.iter().zip(&self.present).zip(&self.things) {
            field(&thing.name, "present", By::Nothing, &[flag(*present)]);
            if *present {
                visit_pose(&thing.name, &body.pose, &mut field);
                if thing.motion == Motion::Free {
                    visit_velocity(&thing.name, body, &mut field);
                }
            }
        }
        for (thing, attachment) in manifest.held_by_socket().zip(&self.attachments) {
            let name = &manifest.things[thing].name;
            field(name, "seated", By::Nothing, &[flag(attachment.seated)]);
            field(name, "steps_beyond", By::Nothing, &[attachment.steps_beyond.into()]);
        }
        for contact in &manifest.contacts {
            let (name, range) = (&contact.name, contact.range(self.layout));
            if contact.measure == Measure::Force {
                let by = By::Part { of: contact.of, axes: true };
                self.forces[range].iter().for_each(|force| field("", name, by, force.as_slice()));
            } else {
                field("", name, By::Part { of: contact.of, axes: false }, &self.loads[range]);
            }
        }
        for (name, number) in [
            ("unconverged", self.unconverged.into()),
            ("retried", self.retried.into()),
            ("joint_speed_peak", self.joint_speed_peak),
            ("penetration", self.penetration),
        ] {
            field("", name, By::Nothing, &[number]);
        }
    }

    /// The lists by joint, with their names.
    pub fn by_joint(&self) -> [(&'static str, &Vec<f64>); 5] {
        [
            ("joint_position", &self.joint_position),
            ("joint_velocity", &self.joint_velocity),
            ("joint_target", &self.joint_target),
            ("joint_effort", &self.joint_effort),
            ("action", &self.action),
        ]
    }
}

fn flag(value: bool) -> f64 {
    f64::from(u8::from(value))
}

fn visit_pose<'a>(of: &'a str, pose: &Isometry3<f64>, field: &mut impl FnMut(&'a str, &'a str, By, &[f64])) {
    let q = pose.rotation.quaternion();
    field(of, "position", By::Axis, pose.translation.vector.as_slice());
    field(of, "quaternion", By::Quaternion, &[q.w, q.i, q.j, q.k]);
}

fn visit_velocity<'a>(of: &'a str, body: &BodyRow, field: &mut impl FnMut(&'a str, &'a str, By, &[f64])) {
    field(of, "linear_velocity", By::Axis, body.linear_velocity.as_slice());
    field(of, "angular_velocity", By::Axis, body.angular_velocity.as_slice());
}

impl Clone for Row {
    fn clone(&self) -> Self {
        let mut row = Self::zeros(self.layout);
        row.clone_from(self);
        row
    }

    /// Copies into its present lists: no allocation between rows of one layout.
    fn clone_from(&mut self, source: &Self) {
        let Self {
            step,
            layout,
            robot,
            com_velocity,
            world_from_palm,
            joint_position,
            joint_velocity,
            joint_target,
            joint_effort,
            action,
            present,
            things,
            attachments,
            forces,
            loads,
            unconverged,
            retried,
            joint_speed_peak,
            penetration,
        } = self;
        *step = source.step;
        *layout = source.layout;
        *robot = source.robot;
        *com_velocity = source.com_velocity;
        *world_from_palm = source.world_from_palm;
        joint_position.clone_from(&source.joint_position);
        joint_velocity.clone_from(&source.joint_velocity);
        joint_target.clone_from(&source.joint_target);
        joint_effort.clone_from(&source.joint_effort);
        action.clone_from(&source.action);
        present.clone_from(&source.present);
        things.clone_from(&source.things);
        attachments.clone_from(&source.attachments);
        forces.clone_from(&source.forces);
        loads.clone_from(&source.loads);
        *unconverged = source.unconverged;
        *retried = source.retried;
        *joint_speed_peak = source.joint_speed_peak;
        *penetration = source.penetration;
    }
}
