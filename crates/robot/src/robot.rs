use fiatlux_dynamics::Drive;
use nalgebra::{Isometry3, Matrix3, UnitVector3, Vector3};

use crate::{GainSet, Gains, JointGains, Shape, Surface};

/// A rigid part of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name of the link, which no other link of the robot has.
    pub name: String,
    /// kg; 0 for a frame.
    pub mass: f64,
    /// Centre of mass in the link's frame, m.
    pub com: Vector3<f64>,
    /// Inertia about the centre of mass, link axes, kg m^2.
    pub inertia: Matrix3<f64>,
    /// Index of the parent, which is smaller than the link's own; `None` for the root.
    pub parent: Option<usize>,
    /// Pose in the parent at joint angle 0; the identity for the root.
    pub parent_from_link: Isometry3<f64>,
    /// Index of the joint above it; `None` when it is the root or fixed to its parent.
    pub joint: Option<usize>,
}

/// A rotary joint, driven unless it follows another.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name of the joint, which no other joint of the robot has.
    pub name: String,
    /// Index of the link below it.
    pub link: usize,
    /// Axis in that link's frame.
    pub axis: UnitVector3<f64>,
    /// Lower end of its range, rad.
    pub lower: f64,
    /// Upper end of its range, rad.
    pub upper: f64,
    /// Drive of the set [`GainSet::Fiatlux`].
    pub gains: JointGains,
    /// The joint that this one follows, by a linkage; its own drive then has no stiffness and no damping, and its target no effect.
    pub follows: Option<Follows>,
}

/// A joint's angle is `ratio` times its leader's plus `offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Follows {
    /// Index of the leader, a joint above it that follows none.
    pub leader: usize,
    /// rad per rad of the leader, not 0.
    pub ratio: f64,
    /// Angle at 0 of the leader, rad.
    pub offset: f64,
}

impl Follows {
    /// The angle of the follower, rad, at one of its leader's.
    pub fn angle(&self, of_leader: f64) -> f64 {
        self.ratio * of_leader + self.offset
    }
}

/// Where a camera is on a robot, and its lens.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraMount {
    /// Name of the camera, which no other camera of the robot has.
    pub name: String,
    /// Index of the link that carries it.
    pub link: usize,
    /// Its frame in that link: it looks along +x with +z up, m.
    pub link_from_camera: Isometry3<f64>,
    /// From the left to the right edge of its picture, rad.
    pub horizontal_fov: f64,
    /// Nothing nearer than this along its axis is in the picture, m.
    pub near: f64,
    /// Index of a link that is not in the picture: the head around a camera inside it.
    pub hidden_link: Option<usize>,
}

/// Joints as rewards name them: indices in ascending order. A group that the robot's file leaves out is empty.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct JointGroups {
    /// Hips and knees.
    pub legs: Vec<usize>,
    /// Joints between shin and foot.
    pub ankles: Vec<usize>,
    /// Joints between pelvis and torso.
    pub waist: Vec<usize>,
    /// All joints of both hands.
    pub fingers: Vec<usize>,
}

/// A hand around the glass of a bulb.
#[derive(Debug, Clone, PartialEq)]
pub struct BulbGrasp {
    /// Index of the link in whose frame the bulb is placed.
    pub link: usize,
    /// Centre of the glass in that frame, m.
    pub glass_center: [f64; 3],
    /// Height of that centre on the axis of a bulb of the published size, m.
    pub glass_height: f64,
    /// Tilt of the bulb about x, beyond half a turn, then about y, rad.
    pub glass_tilt: [f64; 2],
    /// Joints of the hand and their targets, rad; the drives press the bulb.
    pub grip: Vec<(usize, f64)>,
}

/// A checked robot. Links are indexed in the order of its file, joints in the order of its `joint_order`.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    pub(crate) name: String,
    pub(crate) hand: String,
    pub(crate) digest: String,
    pub(crate) links: Vec<Link>,
    pub(crate) joints: Vec<Joint>,
    pub(crate) joint_groups: JointGroups,
    pub(crate) shapes: Vec<Shape>,
    pub(crate) surfaces: Vec<Surface>,
    pub(crate) groups: Vec<String>,
    pub(crate) q0: Vec<f64>,
    pub(crate) sonic: Gains,
    pub(crate) excluded: Vec<(usize, usize)>,
    pub(crate) hand_links: Vec<usize>,
    pub(crate) feet: Vec<usize>,
    pub(crate) palms: Vec<usize>,
    pub(crate) lidar: Option<usize>,
    pub(crate) cameras: Vec<CameraMount>,
    pub(crate) bulb_grasp: Option<BulbGrasp>,
}

impl Robot {
    /// Name of the robot.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Name of the hands that it carries, as its file has it.
    pub fn hand(&self) -> &str {
        &self.hand
    }

    /// SHA-256 of the text that the robot was read from, up to its table of joint groups, hexadecimal; of one made from another
    /// robot, its text and then the other's.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// All links; entry 0 is the root (the pelvis).
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// All joints, in the order of every observation, action and state.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Sets the angles of joints that follow others, rad by joint index, by those of their leaders.
    ///
    /// # Panics
    /// If `q` has fewer numbers than the robot has joints.
    pub fn follow(&self, q: &mut [f64]) {
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(follows) = joint.follows {
                q[index] = follows.angle(q[follows.leader]);
            }
        }
    }

    /// Joints as rewards name them.
    pub fn joint_groups(&self) -> &JointGroups {
        &self.joint_groups
    }

    /// All collision shapes, in the order of the robot's file.
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Surfaces of the shapes; entry 0 is the default.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Joint angles of the standing posture, rad.
    pub fn q0(&self) -> &[f64] {
        &self.q0
    }

    /// Pairs of links whose bodies pass through each other, besides those joined by a joint.
    pub fn excluded(&self) -> &[(usize, usize)] {
        &self.excluded
    }

    /// Links whose contact forces are sensed: right hand (from wrist roll), then left.
    pub fn hand_links(&self) -> &[usize] {
        &self.hand_links
    }

    /// Links that carry the soles: left, right.
    pub fn feet(&self) -> &[usize] {
        &self.feet
    }

    /// Palm links: left, right.
    pub fn palms(&self) -> &[usize] {
        &self.palms
    }

    /// The right hand around a bulb, as an episode begins; `None` where the scene's own grasp is meant for the robot's hands.
    pub fn bulb_grasp(&self) -> Option<&BulbGrasp> {
        self.bulb_grasp.as_ref()
    }

    /// Link whose frame is the LiDAR's, where the robot has one.
    pub fn lidar(&self) -> Option<usize> {
        self.lidar
    }

    /// All cameras: those of the robot's file, then those of `cameras.toml`, which its digest does not cover.
    pub fn cameras(&self) -> &[CameraMount] {
        &self.cameras
    }

    /// The camera of that name.
    pub fn camera(&self, name: &str) -> Option<&CameraMount> {
        self.cameras.iter().find(|camera| camera.name == name)
    }

    /// Index of the link of that name.
    pub fn link_index(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|l| l.name == name)
    }

    /// Index of the joint of that name.
    pub fn joint_index(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|j| j.name == name)
    }

    /// True if the shapes of a link have the surface named `hand`.
    pub fn is_hand_surface(&self, link: usize) -> bool {
        self.shapes.iter().any(|shape| shape.link == link && self.surfaces[shape.surface].name == HAND_SURFACE)
    }

    /// Mass of all links together, kg.
    pub fn total_mass(&self) -> f64 {
        self.links.iter().map(|l| l.mass).sum()
    }

    /// Drives of a set, by joint index.
    pub fn gains(&self, set: GainSet) -> Gains {
        match set {
            GainSet::Fiatlux => Gains(self.joints.iter().map(|j| j.gains).collect()),
            GainSet::Sonic => self.sonic.clone(),
            GainSet::Gear | GainSet::GearLerobot => {
                let of_gear = |joint: &Joint| match joint.follows {
                    Some(_) => joint.gains,
                    None => joint.gains.of_gear(&joint.name, set),
                };
                Gains(self.joints.iter().map(of_gear).collect())
            }
        }
    }
}

impl JointGains {
    /// The drive as the engine takes it.
    pub fn drive(&self) -> Drive {
        let Self { stiffness, damping, effort_limit, speed_limit, .. } = *self;
        Drive { stiffness, damping, effort_limit, speed_limit }
    }
}

/// Surface of the hands, whose friction a scene may set.
pub(crate) const HAND_SURFACE: &str = "hand";
