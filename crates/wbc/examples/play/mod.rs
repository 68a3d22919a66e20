//! A robot that the controller moves on an empty floor, for the examples.
#![allow(dead_code)] // Each of them uses a part.

use fiatlux_rules::errand;
use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wbc::{BodyCommand, Controller, MOVED, Network};
use fiatlux_world::{AppliedWrench, ControlInput, Push, Random, Scene, SceneConfig, SceneSpec, Stream, World};
use nalgebra::{UnitQuaternion, Vector3};

/// The floor, and `g1_bare` with the benchmark's gains.
pub fn floor() -> Arc<Scene> {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let spec = SceneSpec::floor(robot.gains(GainSet::default()));
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

/// A robot on a floor, whose arms go where the targets say.
pub struct Play {
    pub world: World,
    observer: Observer,
    seen: Proprioception,
    pub controller: Controller,
    pub targets: Vec<f64>,
    pub wrenches: Vec<AppliedWrench>,
    pub push: Option<Push>,
    pub random: Random,
    pub stood: usize,
    pub steps: usize,
    pub unloaded: usize,
}

impl Play {
    pub fn new(scene: &Arc<Scene>, network: &Arc<Network>, seed: u64, exact: bool) -> Self {
        let mut world = World::new(scene.clone());
        let mut row = world.row().clone();
        let q0 = scene.robot.q0();
        row.joint_position.copy_from_slice(q0);
        row.robot.pose.translation.z = scene.robot.height_on_soles(q0, &UnitQuaternion::identity()).unwrap();
        world.reset_to(&row).unwrap();
        Self {
            world,
            observer: Observer::new(q0.to_vec(), (!exact).then_some(NoiseSeed { seed, episode: 0 })),
            seen: Proprioception::zeros(q0.len()),
            controller: Controller::new(network.clone()),
            targets: q0.to_vec(),
            wrenches: Vec::new(),
            push: None,
            random: Random::of_term(Stream::Noise, "example", seed, 1),
            stood: 0,
            steps: 0,
            unloaded: 0,
        }
    }

    /// Pelvis and hand, m, or none where it has fallen.
    pub fn step(&mut self, command: &BodyCommand) -> Option<[Vector3<f64>; 2]> {
        self.observer.observe(self.world.row(), &mut self.seen);
        self.controller.step(&self.seen.view(), command, &mut self.targets[..MOVED]).unwrap();
        self.stood += usize::from(self.controller.is_standing());
        self.steps += 1;
        let action = vec![0.0; self.targets.len()];
        let input = ControlInput {
            action: &action,
            joint_target: &self.targets,
            wrenches: &self.wrenches,
            push: self.push.take(),
        };
        let row = self.world.step_with(&input).unwrap();
        self.unloaded += usize::from(row.load(errand::FLOOR_LOAD).iter().take(2).any(|load| *load < 1.0));
        let pelvis = row.robot.pose.translation.vector;
        let palm = self.world.world_from_link(self.world.scene().robot.palms()[1]).translation.vector;
        (pelvis.z > 0.4).then_some([pelvis, palm])
    }

    fn heading(&self) -> UnitQuaternion<f64> {
        let ahead = self.world.row().robot.pose.rotation * Vector3::x();
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ahead.y.atan2(ahead.x))
    }

    pub fn torso(&self) -> [f64; 3] {
        let link = self.world.scene().robot.link_index("torso_link").unwrap();
        let (roll, pitch, yaw) = (self.heading().inverse() * self.world.world_from_link(link).rotation).euler_angles();
        [roll, pitch, yaw]
    }

    /// Distance between the feet to the side, m.
    pub fn feet_apart(&self) -> f64 {
        let [left, right] =
            [0, 1].map(|side| self.world.world_from_link(self.world.scene().robot.feet()[side]).translation.vector);
        self.heading().inverse_transform_vector(&(left - right)).y
    }
}
