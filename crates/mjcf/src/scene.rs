//! A scene to export: a model with its start state.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Geometry, Material, Model, ModelBuilder, ModelError, ShapeSpec, State};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotError, RobotIds};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneError, SceneKind, SceneSpec, StartError, StartOptions, start};
use nalgebra::Isometry3;
use thiserror::Error;

use crate::Names;

/// Why a scene could not be built.
#[derive(Debug, Error)]
pub enum ExportError {
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    #[error("cannot build the model")]
    Model(#[from] ModelError),
    #[error("cannot build the scene")]
    Scene(#[from] SceneError),
    #[error("cannot stage the start")]
    Start(#[from] StartError),
}

/// A model, its start state and the targets of its drives.
#[derive(Debug, Clone)]
pub struct ExportScene {
    /// Name that the file will carry.
    pub name: String,
    /// The bodies, joints and shapes of the scene.
    pub model: Model,
    /// The state that the exported simulation starts from.
    pub state: State,
    /// Joint targets, rad, in the order of [`Model::drives`].
    pub targets: Vec<f64>,
    /// Names of the robot, and of the scene where there is one.
    pub names: Names,
}

impl ExportScene {
    /// A task's start state: the room of the seed, with robot and bulbs as at the beginning of the first episode
    /// without noise.
    pub fn task(task: Task, seed: u64, robot: &str) -> Result<Self, ExportError> {
        let robot = Arc::new(Robot::by_name(robot)?);
        let gains = robot.gains(GainSet::default());
        let spec = SceneSpec::new(SceneKind::of(task), seed, gains);
        let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec)?);
        let world =
            start(Arc::clone(&scene), task, 0, &StartOptions { reset_noise: false, ..StartOptions::default() })?;
        let mut targets = vec![0.0; scene.model.drives().len()];
        for (ids, target) in scene.robot_ids.joints.iter().zip(&world.row().joint_target) {
            targets[ids.drive] = *target;
        }
        let name = format!("{} seed {seed}", task.short_id());
        let names = Names::of_scene(&scene);
        Ok(Self { name, model: scene.model.clone(), state: world.state().clone(), targets, names })
    }

    /// The robot alone in its standing posture, soles at z = 0, over a floor of friction 1 or in the air.
    pub fn robot_only(robot: &str, floor: bool) -> Result<Self, ExportError> {
        let robot = Robot::by_name(robot)?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
        if floor {
            builder.add_shape(ShapeSpec {
                name: "floor".into(),
                body: BodyId::WORLD,
                body_from_shape: Isometry3::identity(),
                geometry: Geometry::HalfSpace,
                material: Material::new(1.0, 0),
                cull_group: placed.next_cull_group,
                label: u32::MAX,
            })?;
        }
        let model = builder.build()?;
        let ids = placed.ids(&model)?;
        Ok(Self::standing(robot.name().to_owned(), model, &robot, &ids))
    }

    fn standing(name: String, model: Model, robot: &Robot, ids: &RobotIds) -> Self {
        let mut state = model.reference_state();
        let mut targets = vec![0.0; model.drives().len()];
        for (joint, q0) in ids.joints.iter().zip(robot.q0()) {
            state.qpos[joint.qpos] = *q0;
            targets[joint.drive] = *q0;
        }
        Self { name, model, state, targets, names: Names::of_robot(robot, ids) }
    }
}
