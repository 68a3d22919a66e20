//! Puts a robot into a model of the dynamics engine.

use fiatlux_dynamics::{BodyId, BodySpec, Coupling, Hinge, Joint as EngineJoint, Model, ModelBuilder, ShapeSpec};
use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::robot::HAND_SURFACE;
use crate::{Follows, GainSet, Gains, Robot, RobotError};

/// Options for adding a robot to a model.
#[derive(Debug, Clone)]
pub struct BuildOptions {
    /// Drives, by joint index.
    pub gains: Gains,
    /// Reference pose of the root.
    pub world_from_pelvis: Isometry3<f64>,
    /// Replaces the friction coefficient of the surface named `hand`.
    pub hand_friction: Option<f64>,
    /// Label of the shapes of link 0; those of link `i` get `first_label + i`.
    pub first_label: u32,
    /// Number in the model of cull group 0; group `i` gets `first_cull_group + i`.
    pub first_cull_group: u16,
}

impl BuildOptions {
    /// The default gains, the robot upright on the floor at the origin, labels and cull groups from 0.
    pub fn new(robot: &Robot) -> Self {
        Self {
            gains: robot.gains(GainSet::default()),
            world_from_pelvis: Isometry3::translation(0.0, 0.0, robot.standing_height()),
            hand_friction: None,
            first_label: 0,
            first_cull_group: 0,
        }
    }
}

/// Where a link is in a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkIds {
    /// Body that the link is, or is part of.
    pub body: BodyId,
    /// Pose of the link in that body.
    pub body_from_link: Isometry3<f64>,
}

/// A robot in a builder. Indices into `qpos` and the drives are known once the model is built: [`PlacedRobot::ids`].
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedRobot {
    /// Body of the root.
    pub root: BodyId,
    /// Where each link is, by link index.
    pub links: Vec<LinkIds>,
    /// Body below each joint, by joint index.
    pub joint_bodies: Vec<BodyId>,
    /// Label of the shapes of link 0.
    pub first_label: u32,
    /// First cull group number that is still free.
    pub next_cull_group: u16,
}

/// Where a joint is in a model and in its arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JointIds {
    /// Body below the joint.
    pub body: BodyId,
    /// Index of its angle in `qpos`.
    pub qpos: usize,
    /// Index of its speed in `qvel`.
    pub dof: usize,
    /// Index in the targets and efforts.
    pub drive: usize,
}

/// Where a robot is in a finished model.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotIds {
    /// Body of the root.
    pub root: BodyId,
    /// First of the root's 7 entries in `qpos`.
    pub root_qpos: usize,
    /// First of the root's 6 entries in `qvel`.
    pub root_dof: usize,
    /// Where each joint is, by joint index.
    pub joints: Vec<JointIds>,
    /// Where each link is, by link index.
    pub links: Vec<LinkIds>,
    /// Label of the shapes of link 0; those of link `i` have `first_label + i`.
    pub first_label: u32,
}

/// Mass properties of a body that is one link or several welded together, in the body's frame.
struct Lump {
    mass: f64,
    com: Vector3<f64>,
    inertia: Matrix3<f64>,
}

impl Robot {
    /// Adds the robot's bodies and shapes. Links without a joint are merged into the body above them; their shapes keep
    /// the label of the link, so that contact forces can be summed per link. Bodies are added in link order.
    ///
    /// # Errors
    /// Gains for another number of joints, or whatever the engine refuses: a name that is taken, too many degrees of
    /// freedom, a gain or friction out of range.
    pub fn add_to(&self, builder: &mut ModelBuilder, options: &BuildOptions) -> Result<PlacedRobot, RobotError> {
        if options.gains.0.len() != self.joints.len() {
            return Err(RobotError::Gains { expected: self.joints.len(), found: options.gains.0.len() });
        }
        let welded = self.welded();
        let mut links: Vec<LinkIds> = Vec::with_capacity(self.links.len());
        let mut joint_bodies = vec![BodyId::WORLD; self.joints.len()];
        for (index, link) in self.links.iter().enumerate() {
            let (carrier, body_from_link) = welded[index];
            if carrier != index {
                links.push(LinkIds { body: links[carrier].body, body_from_link });
                continue;
            }
            let (parent, parent_from_body) = match link.parent {
                Some(parent) => (links[parent].body, links[parent].body_from_link * link.parent_from_link),
                None => (BodyId::WORLD, options.world_from_pelvis),
            };
            let lump = self.lump(index, &welded);
            let body = builder.add_body(BodySpec {
                name: link.name.clone(),
                parent,
                parent_from_body,
                joint: self.engine_joint(link.joint, &options.gains),
                mass: lump.mass,
                com: lump.com,
                inertia: lump.inertia,
            })?;
            if let Some(joint) = link.joint {
                joint_bodies[joint] = body;
            }
            links.push(LinkIds { body, body_from_link });
        }
        for (joint, &follower) in self.joints.iter().zip(&joint_bodies) {
            if let Some(Follows { leader, ratio, offset }) = joint.follows {
                builder.couple(Coupling { follower, leader: joint_bodies[leader], ratio, offset })?;
            }
        }
        self.add_shapes(builder, options, &links)?;
        for &(a, b) in &self.excluded {
            if links[a].body != links[b].body {
                builder.exclude(links[a].body, links[b].body);
            }
        }
        Ok(PlacedRobot {
            root: links[0].body,
            links,
            joint_bodies,
            first_label: options.first_label,
            next_cull_group: options.first_cull_group + self.groups.len() as u16,
        })
    }

    fn engine_joint(&self, joint: Option<usize>, gains: &Gains) -> EngineJoint {
        let Some(index) = joint else { return EngineJoint::Free };
        let (joint, gains) = (&self.joints[index], gains.0[index]);
        EngineJoint::Hinge(Hinge {
            axis: joint.axis,
            lower: joint.lower,
            upper: joint.upper,
            armature: gains.armature,
            drive: Some(gains.drive()),
        })
    }

    fn add_shapes(
        &self,
        builder: &mut ModelBuilder,
        options: &BuildOptions,
        links: &[LinkIds],
    ) -> Result<(), RobotError> {
        for shape in &self.shapes {
            let surface = &self.surfaces[shape.surface];
            let mut material = surface.material;
            if surface.name == HAND_SURFACE {
                material.friction = options.hand_friction.unwrap_or(material.friction);
            }
            let LinkIds { body, body_from_link } = links[shape.link];
            builder.add_shape(ShapeSpec {
                name: shape.name.clone(),
                body,
                body_from_shape: body_from_link * shape.link_from_shape,
                geometry: shape.geometry.clone(),
                material,
                cull_group: options.first_cull_group + shape.group,
                label: options.first_label + shape.link as u32,
            })?;
        }
        Ok(())
    }

    /// For each link, the link whose body it is part of and its pose in that one.
    fn welded(&self) -> Vec<(usize, Isometry3<f64>)> {
        let mut welded: Vec<(usize, Isometry3<f64>)> = Vec::with_capacity(self.links.len());
        for (index, link) in self.links.iter().enumerate() {
            welded.push(match link.parent {
                Some(parent) if link.joint.is_none() => {
                    let (carrier, carrier_from_parent) = welded[parent];
                    (carrier, carrier_from_parent * link.parent_from_link)
                }
                _ => (index, Isometry3::identity()),
            });
        }
        welded
    }

    fn lump(&self, carrier: usize, welded: &[(usize, Isometry3<f64>)]) -> Lump {
        let parts = || self.links.iter().zip(welded).filter(|(link, (c, _))| *c == carrier && link.mass > 0.0);
        let mass: f64 = parts().map(|(link, _)| link.mass).sum();
        let com_of = |link: &crate::Link, pose: &Isometry3<f64>| (pose * nalgebra::Point3::from(link.com)).coords;
        let com = parts().map(|(link, (_, pose))| link.mass * com_of(link, pose)).sum::<Vector3<f64>>() / mass;
        let mut inertia = Matrix3::zeros();
        for (link, (_, pose)) in parts() {
            let rotation = pose.rotation.to_rotation_matrix();
            let arm = com_of(link, pose) - com;
            inertia += rotation.matrix() * link.inertia * rotation.matrix().transpose();
            inertia += link.mass * (Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose());
        }
        Lump { mass, com, inertia: (inertia + inertia.transpose()) / 2.0 }
    }
}

impl PlacedRobot {
    /// Indices into the arrays of the finished model.
    ///
    /// # Errors
    /// [`RobotError::OtherModel`] when the model does not hold this robot's bodies.
    pub fn ids(&self, model: &Model) -> Result<RobotIds, RobotError> {
        let body = |id: BodyId| model.bodies().get(id.0).ok_or(RobotError::OtherModel(id.0));
        let mut joints = Vec::with_capacity(self.joint_bodies.len());
        for &id in &self.joint_bodies {
            let drive = model.drives().iter().position(|(b, _)| *b == id).ok_or(RobotError::OtherModel(id.0))?;
            joints.push(JointIds { body: id, qpos: body(id)?.qpos_start, dof: body(id)?.dof_start, drive });
        }
        let root = body(self.root)?;
        Ok(RobotIds {
            root: self.root,
            root_qpos: root.qpos_start,
            root_dof: root.dof_start,
            joints,
            links: self.links.clone(),
            first_label: self.first_label,
        })
    }
}
