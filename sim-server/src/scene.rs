//! What can be exported: a model with its start state.

use std::str::FromStr;
use std::sync::Arc;

use fiatlux_dynamics::{BodyId, Geometry, Material, Model, ModelBuilder, ModelError, ShapeSpec, State};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotError, RobotIds};
use fiatlux_world::{Scene, SceneConfig, SceneError, SceneKind, SceneSpec};
use nalgebra::Isometry3;
use thiserror::Error;

/// Why a scene could not be built.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The robot's file or its place in the model.
    #[error("cannot load the robot")]
    Robot(#[from] RobotError),
    /// The engine refused the model.
    #[error("cannot build the model")]
    Model(#[from] ModelError),
    /// The scene's config or layout.
    #[error("cannot build the scene")]
    Scene(#[from] SceneError),
}

/// A task of the benchmark: `S01` to `S12`, `replace` or `climb`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Task {
    name: String,
    kind: SceneKind,
}

impl FromStr for Task {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let kind = match name {
            "S01" | "replace" => SceneKind::FreeLadder,
            "climb" => SceneKind::Climb,
            _ if (2..=12).any(|number| name == format!("S{number:02}")) => SceneKind::CoupledLadder,
            _ => return Err("the tasks are S01 to S12, replace and climb".into()),
        };
        Ok(Self { name: name.to_owned(), kind })
    }
}

/// A model, its start state and what its drives hold there.
#[derive(Debug, Clone)]
pub struct ExportScene {
    /// Name for the file's reader.
    pub name: String,
    /// The model.
    pub model: Model,
    /// Start state.
    pub state: State,
    /// Joint targets, rad, in the order of [`Model::drives`].
    pub targets: Vec<f64>,
}

impl ExportScene {
    /// A task's room as the seed lays it out, before any staging: every prop in its place, the robot in the standing
    /// posture in its zone, the bulbs in the fixture and on the bench.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn task(task: &Task, seed: u64) -> Result<Self, ExportError> {
        let robot = Arc::new(Robot::g1_inspire()?);
        let gains = robot.gains(GainSet::default());
        let spec = SceneSpec { kind: task.kind, seed, gains, hand_friction: None };
        let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?;
        Ok(Self::standing(format!("{} seed {seed}", task.name), scene.model, &robot, &scene.robot_ids))
    }

    /// The robot alone in its standing posture, soles at z = 0, over a floor of friction 1 or in the air.
    ///
    /// # Errors
    /// [`ExportError`].
    pub fn robot_only(floor: bool) -> Result<Self, ExportError> {
        let robot = Robot::g1_inspire()?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot))?;
        if floor {
            builder.add_shape(ShapeSpec {
                name: "floor".into(),
                body: BodyId::WORLD,
                body_from_shape: Isometry3::identity(),
                geometry: Geometry::HalfSpace,
                material: Material { friction: 1.0, priority: 0 },
                cluster: placed.next_cluster,
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
        Self { name, model, state, targets }
    }
}
