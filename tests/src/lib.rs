//! Shared by the checks. A rig for checks of the world: a scene with its engine laid open, joints that can be locked and
//! forces that can be applied. [`programs`] starts our programs as processes; [`lossy`] loses messages between them.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]
#![allow(missing_docs)] // Used by tests alone.

pub mod forge;
pub mod grasp;
pub mod lossy;
pub mod posture;
pub mod programs;

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Contact, Dynamics, Input, ShapeSpec, State, StepReport, Wrench};
use fiatlux_robot::{GainSet, Gains, Robot};
use fiatlux_world::{PHYSICS_DT, Random, Scene, SceneConfig, SceneKind, SceneSpec, ShapeOwner, Stream};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// True if long checks run at full length: with `FIATLUX_SLOW_TESTS` set.
pub fn at_full_length() -> bool {
    std::env::var_os("FIATLUX_SLOW_TESTS").is_some()
}

/// Repetitions of a check: `all` with `FIATLUX_ALL_ROOMS` set, `full` at full length, and else `short`.
pub fn repeats(all: u64, full: u64, short: u64) -> u64 {
    match std::env::var_os("FIATLUX_ALL_ROOMS") {
        Some(_) => all,
        None if at_full_length() => full,
        None => short,
    }
}

/// The robot, read once per call.
pub fn robot() -> Arc<Robot> {
    Arc::new(Robot::benchmark().unwrap())
}

/// The published gains with those of the joints whose names contain one of `parts` scaled.
pub fn scaled_gains(robot: &Robot, parts: &[&str], factor: f64) -> Gains {
    let mut gains = robot.gains(GainSet::Fiatlux);
    let named = |joint: &usize| parts.iter().any(|part| robot.joints()[*joint].name.contains(part));
    gains.scale((0..robot.joints().len()).filter(named), factor);
    gains
}

/// A scene with the default config.
pub fn scene(kind: SceneKind, seed: u64, gains: Gains) -> Arc<Scene> {
    let spec = SceneSpec::new(kind, seed, gains);
    Arc::new(Scene::build(&SceneConfig::default(), robot(), spec).unwrap())
}

/// Height of a shape's lowest point, m.
fn lowest_point(shape: &ShapeSpec, world_from_body: &Isometry3<f64>) -> f64 {
    let world_from_shape = world_from_body * shape.body_from_shape;
    let down = world_from_shape.inverse_transform_vector(&-Vector3::z());
    world_from_shape.translation.z - shape.geometry.reach(&down)
}

/// One world with everything in reach.
#[derive(Debug, Clone)]
pub struct Rig {
    /// The scene that is simulated.
    pub scene: Arc<Scene>,
    /// The state, which a test may set.
    pub state: State,
    /// The engine with its scratch memory.
    pub dynamics: Dynamics,
    /// Joint targets by drive, rad.
    pub targets: Vec<f64>,
    /// Locked degrees of freedom.
    pub locked: Vec<bool>,
    /// Wrenches of the next step.
    pub wrenches: Vec<(BodyId, Wrench)>,
    /// Physics steps that did not converge.
    pub unconverged: u32,
}

impl Rig {
    /// The scene's reference state, the robot standing in its posture with its targets there.
    pub fn new(scene: &Arc<Scene>) -> Self {
        let mut rig = Self {
            state: scene.model.reference_state(),
            dynamics: Dynamics::new(&scene.model),
            targets: vec![0.0; scene.model.drives().len()],
            locked: vec![false; scene.model.nv()],
            wrenches: Vec::new(),
            unconverged: 0,
            scene: Arc::clone(scene),
        };
        let q0 = scene.robot.q0().to_vec();
        rig.set_joints(&q0);
        rig.update();
        rig
    }

    /// Sets joint positions and targets, rad in the public order.
    pub fn set_joints(&mut self, positions: &[f64]) {
        for (ids, &q) in self.scene.robot_ids.joints.iter().zip(positions) {
            self.state.qpos[ids.qpos] = q;
            self.targets[ids.drive] = q;
        }
    }

    pub fn place_robot(&mut self, world_from_pelvis: &Isometry3<f64>) {
        self.place(self.scene.robot_ids.root, world_from_pelvis);
    }

    pub fn place(&mut self, body: BodyId, pose: &Isometry3<f64>) {
        self.state.set_pose(&self.scene.model, body, pose);
        self.update();
    }

    /// Adds the reset noise of the tasks on the floor: moves the robot, and its joints within their limits, then puts its
    /// lowest sole on the floor.
    pub fn add_reset_noise(&mut self, seed: u64) {
        let scene = Arc::clone(&self.scene);
        let noise = &scene.config.start.noise;
        let mut random = Random::new(Stream::Reset, seed, 0);
        let mut draw = |half: f64| random.uniform(-half, half);
        let shift = Vector3::new(draw(noise.shift), draw(noise.shift), 0.0);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * draw(noise.turn));
        for (ids, limits) in scene.robot_ids.joints.iter().zip(scene.robot.joints()) {
            let angle = self.state.qpos[ids.qpos] + draw(noise.joint);
            self.state.qpos[ids.qpos] = angle.clamp(limits.lower, limits.upper);
        }
        self.update();
        let root = self.pose(scene.robot_ids.root);
        let moved = Isometry3::from_parts((root.translation.vector + shift).into(), turn * root.rotation);
        self.place_robot(&moved);
        let lowest = self.lowest_of(|link| scene.robot.feet().contains(&link));
        self.place_robot(&(Isometry3::translation(0.0, 0.0, -lowest) * moved));
    }

    /// Lowest point of the robot's links that `counts` picks by index, m.
    pub fn lowest_of(&self, counts: impl Fn(usize) -> bool) -> f64 {
        let shapes = self.scene.model.shapes().iter();
        let picked =
            shapes.filter(|s| matches!(ShapeOwner::from_label(s.label), ShapeOwner::Robot(link) if counts(link)));
        picked.map(|shape| lowest_point(shape, &self.pose(shape.body))).fold(f64::INFINITY, f64::min)
    }

    /// Locks or frees every degree of freedom of the robot.
    pub fn lock_robot(&mut self, locked: bool) {
        let ids = &self.scene.robot_ids;
        self.locked[ids.root_dof..ids.root_dof + 6].fill(locked);
        for joint in &ids.joints {
            self.locked[joint.dof] = locked;
        }
    }

    /// Locks or frees a free body.
    pub fn lock_body(&mut self, body: BodyId, locked: bool) {
        let dof = self.scene.model.bodies()[body.0].dof_start;
        self.locked[dof..dof + 6].fill(locked);
    }

    /// Takes one physics step of [`PHYSICS_DT`].
    pub fn step(&mut self) -> StepReport {
        let input = Input { targets: &self.targets, wrenches: &self.wrenches, locked: &self.locked };
        let report = self.dynamics.step(&self.scene.model, &mut self.state, &input, PHYSICS_DT);
        self.unconverged += u32::from(!report.converged);
        report
    }

    /// Physics steps for a time, then an update.
    pub fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / PHYSICS_DT).round() as usize {
            self.step();
        }
        self.update();
    }

    /// Brings poses and velocities up to the state.
    pub fn update(&mut self) {
        self.dynamics.update(&self.scene.model, &self.state);
    }

    /// Pose of a body at the last update.
    pub fn pose(&self, body: BodyId) -> Isometry3<f64> {
        self.dynamics.world_from_body(body)
    }

    /// Pose of a link at the last update.
    pub fn link_pose(&self, name: &str) -> Isometry3<f64> {
        let link = self.scene.robot_ids.links[self.scene.robot.link_index(name).unwrap()];
        self.pose(link.body) * link.body_from_link
    }

    /// Height of the pelvis, m.
    pub fn pelvis_height(&self) -> f64 {
        self.state.qpos[self.scene.robot_ids.root_qpos + 2]
    }

    /// Contacts of the last step between two owners, their forces turned to act on the second.
    pub fn contacts_between(
        &self,
        on: impl Fn(ShapeOwner) -> bool,
        by: impl Fn(ShapeOwner) -> bool,
    ) -> Vec<(ShapeOwner, Contact)> {
        let mut found = Vec::new();
        for contact in self.dynamics.contacts() {
            let (a, b) = (self.scene.owner(contact.shape_a), self.scene.owner(contact.shape_b));
            if on(b) && by(a) {
                found.push((b, *contact));
            } else if on(a) && by(b) {
                found.push((a, Contact { force: -contact.force, normal: -contact.normal, ..*contact }));
            }
        }
        found
    }

    /// Deepest penetration in the last step, m (0 if none).
    pub fn penetration(&self) -> f64 {
        self.dynamics.contacts().iter().map(|c| -c.distance).fold(0.0, f64::max)
    }
}
