//! A model as MJCF, the scene format of MuJoCo 4: for a viewer, and for an independent judge of our dynamics.
//!
//! The model is exported as it is; what MuJoCo itself does differently is the softness of its contacts and limits. What
//! acts on a model from outside is not part of it: the socket's hold on a bulb, a wrench law, stays with the world, so a
//! seated bulb drops out of a ceiling socket in MuJoCo.
//! Bodies, geoms and sites keep their names; joints, their actuators and cameras have those of the contract ([`Names`]). MuJoCo
//! orders bodies depth first, so the tuple `bodies` lists
//! them in the order of [`Model::bodies`], and actuators are in the order of [`Model::drives`].
#![allow(missing_docs)] // Used in this repository alone.

mod grasp;
mod scene;
#[cfg(test)]
mod tests;
mod xml;

use std::fmt::Display;

use fiatlux_dynamics::{BodyId, Geometry, Hinge, Joint, Material, Model, ShapeSpec, Site, State};
use fiatlux_robot::{CameraMount, LinkIds, Robot, RobotIds};
use fiatlux_world::Scene;
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

pub use grasp::Grasp;
pub use scene::{ExportError, ExportScene};
use xml::{Attribute, Xml};

/// Stands for an infinite joint limit if the other one is finite, rad: MJCF has no one-sided ranges.
const NO_LIMIT: f64 = 1e6;

/// MuJoCo's `impratio`: how much stiffer friction is than the normal force. At its default of 1 a held bulb creeps out of
/// the hand.
const IMPRATIO: f64 = 100.0;

/// Site of the robot's root, whose motion sensors are written where the site is.
const ROOT: &str = "imu";

/// Kinds of MuJoCo's sensors at [`ROOT`], and their names. They sense what proprioception does, in the root's axes, and what an inertial
/// unit has besides: the acceleration without gravity's pull, 9.81 upwards at rest, and the turn, w first.
const SENSORS: [(&str, &str); 4] = [
    ("gyro", "base_angular_velocity"),
    ("velocimeter", "base_linear_velocity"),
    ("accelerometer", "base_acceleration"),
    ("framequat", "base_quaternion"),
];

/// Which of MuJoCo's options for friction and damping to export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OptionSet {
    /// The closest to ours: true friction cones, stiff friction, and damping in the drive, so that the effort limit clamps
    /// stiffness and damping together. That needs the integrator `implicitfast`, because an explicit damper would shake
    /// links of a few grams apart.
    #[default]
    Nearest,
    /// MuJoCo's defaults: friction pyramids, and passive damping in the joint, which the default integrator treats
    /// implicitly; the effort limit then clamps only the stiffness.
    Defaults,
}

/// Settings of an export besides the model and its state.
#[derive(Debug, Clone, PartialEq)]
pub struct MjcfOptions {
    pub name: String,
    /// Length of a physics step, s.
    pub timestep: f64,
    /// Options for friction and damping.
    pub option_set: OptionSet,
    /// Sites, cameras and joints.
    pub names: Names,
}

/// Names that are not those of bodies and shapes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Names {
    pub sites: Vec<(String, Site)>,
    /// Cameras, which look along +x with +z up, each with its angle of view from the lower to the upper edge, rad.
    pub cameras: Vec<(String, Site, f64)>,
    /// Joints and their actuators, by the body below; a joint that is not listed has its body's name.
    pub joints: Vec<(BodyId, String)>,
}

impl Names {
    /// Those of a robot in a model.
    pub fn of_robot(robot: &Robot, ids: &RobotIds) -> Self {
        let camera = |mount: &CameraMount| {
            let LinkIds { body, body_from_link } = ids.links[mount.link];
            let site = Site { body, body_from_site: body_from_link * mount.link_from_camera };
            // Pictures are square.
            (mount.name.clone(), site, mount.horizontal_fov)
        };
        let sites = robot.sites().into_iter().map(|site| (site.name.clone(), ids.site(&site)));
        Self {
            sites: sites.chain([root(ids)]).collect(),
            cameras: robot.cameras().iter().map(camera).collect(),
            joints: ids.joints.iter().zip(robot.joints()).map(|(ids, joint)| (ids.body, joint.name.clone())).collect(),
        }
    }

    /// Those of a scene, with the grasp of its robot's right hand.
    pub fn of_scene(scene: &Scene) -> Self {
        let grasp = Grasp::of_scene(scene).map(|grasp| (Grasp::SITE.to_owned(), grasp.site));
        let sites = scene.sites().into_iter().chain([root(&scene.robot_ids)]).chain(grasp).collect();
        Self { sites, ..Self::of_robot(&scene.robot, &scene.robot_ids) }
    }

    fn joint<'a>(&'a self, model: &'a Model, body: usize) -> &'a str {
        let named = self.joints.iter().find(|(id, _)| id.0 == body);
        named.map_or(&model.bodies()[body].spec.name, |(_, name)| name)
    }
}

/// The site of the root, with its name.
fn root(ids: &RobotIds) -> (String, Site) {
    (ROOT.to_owned(), Site { body: ids.root, body_from_site: Isometry3::identity() })
}

/// Writes a model, with `state` and `targets` as its keyframe `start`.
///
/// # Panics
/// If `state` or `targets` (rad, in the order of [`Model::drives`]) does not have the model's size.
pub fn to_mjcf(model: &Model, state: &State, targets: &[f64], options: &MjcfOptions) -> String {
    assert_eq!(state.qpos.len(), model.nq(), "qpos must have the model's size");
    assert_eq!(state.qvel.len(), model.nv(), "qvel must have the model's size");
    assert_eq!(targets.len(), model.drives().len(), "there must be one target for each drive");
    let mut children = vec![Vec::new(); model.bodies().len()];
    let mut shapes = vec![Vec::new(); model.bodies().len()];
    for (index, body) in model.bodies().iter().enumerate().skip(1) {
        children[body.spec.parent.0].push(index);
    }
    for shape in model.shapes() {
        shapes[shape.body.0].push(shape);
    }
    let mut writer = Writer { model, options, children, shapes, xml: Xml::default(), depth_first: Vec::new() };
    writer.document(state, targets);
    writer.xml.out
}

/// Indices of the model's bodies in MuJoCo's order: depth first, the world left out.
pub fn body_order(model: &Model) -> Vec<usize> {
    let mut children = vec![Vec::new(); model.bodies().len()];
    for (index, body) in model.bodies().iter().enumerate().skip(1) {
        children[body.spec.parent.0].push(index);
    }
    let (mut order, mut open) = (Vec::new(), std::mem::take(&mut children[BodyId::WORLD.0]));
    open.reverse();
    while let Some(body) = open.pop() {
        order.push(body);
        open.extend(std::mem::take(&mut children[body]).into_iter().rev());
    }
    order
}

struct Writer<'a> {
    model: &'a Model,
    options: &'a MjcfOptions,
    children: Vec<Vec<usize>>,
    shapes: Vec<Vec<&'a ShapeSpec>>,
    xml: Xml,
    /// Bodies in MuJoCo's order.
    depth_first: Vec<usize>,
}

impl Writer<'_> {
    fn document(&mut self, state: &State, targets: &[f64]) {
        self.xml.open("mujoco", &[("model", &self.options.name)]);
        self.settings();
        self.assets();
        self.xml.open("worldbody", &[]);
        self.xml.leaf(
            "light",
            &[("type", &"directional"), ("pos", &"0 0 4"), ("dir", &"-0.3 0.3 -1"), ("castshadow", &"false")],
        );
        self.contents(BodyId::WORLD.0);
        self.xml.close("worldbody");
        self.exclusions();
        self.couplings();
        self.actuators();
        self.sensors();
        self.order();
        self.keyframe(state, targets);
        self.xml.close("mujoco");
    }

    fn settings(&mut self) {
        let compiler: &[Attribute] = &[
            ("angle", &"radian"),
            ("autolimits", &"true"),
            ("inertiafromgeom", &"false"),
            ("balanceinertia", &"false"),
        ];
        self.xml.leaf("compiler", compiler);
        let gravity = numbers(self.model.gravity().as_slice());
        let mut option: Vec<Attribute> = vec![("timestep", &self.options.timestep), ("gravity", &gravity)];
        if self.options.option_set == OptionSet::Nearest {
            let laws: [Attribute; 3] =
                [("integrator", &"implicitfast"), ("cone", &"elliptic"), ("impratio", &IMPRATIO)];
            option.extend(laws);
        }
        self.xml.leaf("option", &option);
    }

    fn assets(&mut self) {
        self.xml.open("asset", &[]);
        let colours: [Attribute; 2] = [("rgb1", &"0.75 0.82 0.9"), ("rgb2", &"0.35 0.4 0.5")];
        let sky: [Attribute; 4] = [("type", &"skybox"), ("builtin", &"gradient"), ("width", &256), ("height", &256)];
        self.xml.leaf("texture", &[&sky[..], &colours].concat());
        let colours: [Attribute; 2] = [("rgb1", &"0.62 0.62 0.6"), ("rgb2", &"0.52 0.52 0.5")];
        let checker: [Attribute; 5] =
            [("name", &"checker"), ("type", &"2d"), ("builtin", &"checker"), ("width", &256), ("height", &256)];
        self.xml.leaf("texture", &[&checker[..], &colours].concat());
        let floor: &[Attribute] =
            &[("name", &"floor"), ("texture", &"checker"), ("texrepeat", &"1 1"), ("texuniform", &"true")];
        self.xml.leaf("material", floor);
        for (name, rgba) in MATERIALS {
            self.xml.leaf("material", &[("name", &name), ("rgba", &rgba)]);
        }
        for shape in self.model.shapes() {
            if let Geometry::Hull(hull) = &shape.geometry {
                let vertices: Vec<f64> = hull.vertices().iter().flatten().copied().collect();
                self.xml.leaf("mesh", &[("name", &shape.name), ("vertex", &numbers(&vertices))]);
            }
        }
        self.xml.close("asset");
    }

    /// Shapes and sites of a body, then the bodies below it.
    fn contents(&mut self, index: usize) {
        for shape in std::mem::take(&mut self.shapes[index]) {
            self.shape(shape);
        }
        let names = &self.options.names;
        for (name, site) in names.sites.iter().filter(|(_, site)| site.body.0 == index) {
            let (pos, quat) = pose(&site.body_from_site);
            self.xml.leaf("site", &[("name", name), ("pos", &pos), ("quat", &quat)]);
        }
        for (name, site, fov) in names.cameras.iter().filter(|(_, site, _)| site.body.0 == index) {
            // MuJoCo's look along -z with +y up.
            let axes = Matrix3::new(0.0, 0.0, -1.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
            let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
            let (pos, quat) = pose(&(site.body_from_site * turn));
            let degrees = fov.to_degrees();
            self.xml.leaf("camera", &[("name", name), ("pos", &pos), ("quat", &quat), ("fovy", &degrees)]);
        }
        for child in std::mem::take(&mut self.children[index]) {
            self.body(child);
        }
    }

    fn body(&mut self, index: usize) {
        self.depth_first.push(index);
        let spec = &self.model.bodies()[index].spec;
        let (pos, quat) = pose(&spec.parent_from_body);
        self.xml.open("body", &[("name", &spec.name), ("pos", &pos), ("quat", &quat)]);
        let com = numbers(spec.com.as_slice());
        let i = &spec.inertia;
        let off_diagonal = [i[(0, 1)], i[(0, 2)], i[(1, 2)]];
        let diagonal = numbers(i.diagonal().as_slice());
        let (field, moments) = if off_diagonal == [0.0; 3] {
            ("diaginertia", diagonal)
        } else {
            ("fullinertia", format!("{diagonal} {}", numbers(&off_diagonal)))
        };
        self.xml.leaf("inertial", &[("pos", &com), ("mass", &spec.mass), (field, &moments)]);
        match &spec.joint {
            Joint::Free => self.xml.leaf("freejoint", &[("name", &spec.name)]),
            Joint::Hinge(hinge) => self.hinge(index, hinge),
        }
        self.contents(index);
        self.xml.close("body");
    }

    fn hinge(&mut self, body: usize, hinge: &Hinge) {
        let name = self.options.names.joint(self.model, body);
        let axis = numbers(hinge.axis.as_slice());
        let range = numbers(&[hinge.lower.max(-NO_LIMIT), hinge.upper.min(NO_LIMIT)]);
        let damping = hinge.drive.map_or(0.0, |drive| drive.damping);
        let mut attributes: Vec<Attribute> = vec![("name", &name), ("type", &"hinge"), ("axis", &axis)];
        if hinge.lower.is_finite() || hinge.upper.is_finite() {
            attributes.push(("range", &range));
            // Its leader's range keeps a follower within its own.
            if self.model.couplings().any(|coupling| coupling.follower.0 == body) {
                attributes.push(("limited", &"false"));
            }
        }
        if hinge.armature > 0.0 {
            attributes.push(("armature", &hinge.armature));
        }
        if self.options.option_set == OptionSet::Defaults && damping > 0.0 {
            attributes.push(("damping", &damping));
        }
        self.xml.leaf("joint", &attributes);
    }

    fn shape(&mut self, shape: &ShapeSpec) {
        let (kind, field, size) = match &shape.geometry {
            // The third number is only the spacing of drawn grid lines.
            Geometry::HalfSpace => ("plane", "size", "0 0 1".to_owned()),
            Geometry::Sphere { radius } => ("sphere", "size", numbers(&[*radius])),
            Geometry::Capsule { radius, half_length } => ("capsule", "size", numbers(&[*radius, *half_length])),
            Geometry::Cuboid { half_extents } => ("box", "size", numbers(half_extents.as_slice())),
            Geometry::Hull(_) => ("mesh", "mesh", shape.name.clone()),
        };
        let (pos, quat) = pose(&shape.body_from_shape);
        let owner = &self.model.bodies()[self.model.bodies()[shape.body.0].root.0].spec.name;
        let material = material(shape, owner);
        let mut attributes: Vec<Attribute> =
            vec![("name", &shape.name), ("type", &kind), (field, &size), ("pos", &pos), ("quat", &quat)];
        let Material { friction, torsion, rolling, .. } = shape.material;
        // All three, since of two geoms the larger numbers hold, and MuJoCo's defaults are not 0.
        let frictions = numbers(&[friction, torsion, rolling]);
        let dimensions = match (torsion > 0.0, rolling > 0.0) {
            (_, true) => 6,
            (true, false) => 4,
            (false, false) => 3,
        };
        attributes.extend([("friction", &frictions as &dyn Display), ("condim", &dimensions)]);
        if shape.material.priority != 0 {
            attributes.push(("priority", &shape.material.priority));
        }
        attributes.push(("material", &material));
        self.xml.leaf("geom", &attributes);
    }

    fn exclusions(&mut self) {
        if self.model.excluded().is_empty() {
            return;
        }
        self.xml.open("contact", &[]);
        for &(a, b) in self.model.excluded() {
            let [a, b] = [a, b].map(|body| &self.model.bodies()[body.0].spec.name);
            self.xml.leaf("exclude", &[("body1", a), ("body2", b)]);
        }
        self.xml.close("contact");
    }

    fn couplings(&mut self) {
        let couplings: Vec<_> = self.model.couplings().collect();
        if couplings.is_empty() {
            return;
        }
        self.xml.open("equality", &[]);
        // As stiff as MuJoCo integrates it, where ours is exact.
        let time = numbers(&[2.0 * self.options.timestep, 1.0]);
        for coupling in couplings {
            let [follower, leader] =
                [coupling.follower, coupling.leader].map(|body| self.options.names.joint(self.model, body.0));
            let polynomial = numbers(&[coupling.offset, coupling.ratio, 0.0, 0.0, 0.0]);
            let mut attributes: Vec<Attribute> =
                vec![("joint1", &follower), ("joint2", &leader), ("polycoef", &polynomial)];
            if self.options.option_set == OptionSet::Nearest {
                attributes.extend([("solref", &time as &dyn Display), ("solimp", &"0.9999 0.9999 0.001")]);
            }
            self.xml.leaf("joint", &attributes);
        }
        self.xml.close("equality");
    }

    fn actuators(&mut self) {
        if self.model.drives().is_empty() {
            return;
        }
        self.xml.open("actuator", &[]);
        for &(body, drive) in self.model.drives() {
            let name = self.options.names.joint(self.model, body.0);
            let range = numbers(&[-drive.effort_limit, drive.effort_limit]);
            let mut attributes: Vec<Attribute> = vec![("name", &name), ("joint", &name), ("kp", &drive.stiffness)];
            if self.options.option_set == OptionSet::Nearest {
                attributes.push(("kv", &drive.damping));
            }
            if drive.effort_limit.is_finite() {
                attributes.push(("forcerange", &range));
            }
            self.xml.leaf("position", &attributes);
        }
        self.xml.close("actuator");
    }

    fn sensors(&mut self) {
        if self.options.names.sites.iter().all(|(name, _)| name != ROOT) {
            return;
        }
        self.xml.open("sensor", &[]);
        for (kind, name) in SENSORS {
            let mut attributes: Vec<Attribute> = vec![("name", &name)];
            match kind {
                "framequat" => attributes.extend([("objtype", &"site" as &dyn Display), ("objname", &ROOT)]),
                _ => attributes.push(("site", &ROOT)),
            }
            self.xml.leaf(kind, &attributes);
        }
        self.xml.close("sensor");
    }

    fn order(&mut self) {
        self.xml.open("custom", &[]);
        self.xml.open("tuple", &[("name", &"bodies")]);
        for body in self.model.bodies() {
            self.xml.leaf("element", &[("objtype", &"body"), ("objname", &body.spec.name)]);
        }
        self.xml.close("tuple");
        self.xml.close("custom");
    }

    /// The start state in MuJoCo's order and terms: angular velocity of a free body in its own axes.
    fn keyframe(&mut self, state: &State, targets: &[f64]) {
        let (mut qpos, mut qvel) = (Vec::new(), Vec::new());
        for &index in &self.depth_first {
            let body = &self.model.bodies()[index];
            let (q, v) = (&state.qpos[body.qpos_start..], &state.qvel[body.dof_start..]);
            if body.spec.joint == Joint::Free {
                qpos.extend(&q[..7]);
                let world_from_body = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[4], q[5], q[6]));
                qvel.extend(&v[..3]);
                qvel.extend((world_from_body.inverse() * Vector3::new(v[3], v[4], v[5])).iter());
            } else {
                qpos.push(q[0]);
                qvel.push(v[0]);
            }
        }
        let (qpos, qvel, ctrl) = (numbers(&qpos), numbers(&qvel), numbers(targets));
        let mut attributes: Vec<Attribute> = vec![("name", &"start"), ("qpos", &qpos), ("qvel", &qvel)];
        if !targets.is_empty() {
            attributes.push(("ctrl", &ctrl));
        }
        self.xml.open("keyframe", &[]);
        self.xml.leaf("key", &attributes);
        self.xml.close("keyframe");
    }
}

/// Walls are nearly transparent, so that a camera outside can see in.
const MATERIALS: [(&str, &str); 6] = [
    ("room", "0.8 0.78 0.74 0.15"),
    ("robot", "0.55 0.57 0.6 1"),
    ("aluminium", "0.8 0.83 0.86 1"),
    ("glass", "1 0.9 0.45 0.8"),
    ("crate", "0.95 0.75 0.1 1"),
    ("wood", "0.6 0.42 0.26 1"),
];

/// Appearance of a shape, from its name or that of its tree's root.
fn material(shape: &ShapeSpec, root: &str) -> &'static str {
    let is = |word: &str| shape.name.contains(word) || root.contains(word);
    match shape.geometry {
        Geometry::HalfSpace => "floor",
        _ if is("bulb") => "glass",
        _ if is("ladder") || is("fixture") => "aluminium",
        _ if is("crate") => "crate",
        _ if is("bench") => "wood",
        _ if shape.body == BodyId::WORLD => "room",
        _ => "robot",
    }
}

/// Numbers that read back to the same bits.
fn numbers(values: &[f64]) -> String {
    // Adding 0 turns -0 into 0.
    values.iter().map(|value| (value + 0.0).to_string()).collect::<Vec<_>>().join(" ")
}

fn pose(isometry: &Isometry3<f64>) -> (String, String) {
    let q = isometry.rotation.quaternion();
    (numbers(isometry.translation.vector.as_slice()), numbers(&[q.w, q.i, q.j, q.k]))
}
