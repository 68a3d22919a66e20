//! The scene of a recorded episode.

use std::sync::Arc;

use fiatlux_proto::v3;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Task, of_scene};
use fiatlux_world::{Scene, SceneConfig, SceneError, SceneKind, SceneSpec};
use thiserror::Error;

use crate::WireError;
use crate::domain_sample::{layout, prop_scale};

/// Why a header gives no scene.
#[derive(Debug, Error)]
pub enum RebuildError {
    #[error("cannot read the bag's header; the bag is of another version, or damaged")]
    Header(#[from] WireError),
    #[error("cannot build the scene of the bag's header")]
    Scene(#[from] SceneError),
}

impl RebuildError {
    fn header(field: &'static str, problem: impl ToString) -> Self {
        Self::Header(WireError::Value { field, problem: format!("is wrong: {}", problem.to_string()) })
    }
}

fn robot_name(header: &v3::EpisodeHeader) -> Result<&'static str, RebuildError> {
    Robot::known(&header.robot).map_err(|error| RebuildError::header("robot", error))
}

/// The robot of a recorded episode.
///
/// # Errors
/// [`RebuildError::Header`] for a robot that is not known here.
pub fn robot_of(header: &v3::EpisodeHeader) -> Result<Robot, RebuildError> {
    Robot::by_name(robot_name(header)?).map_err(|error| RebuildError::header("robot", error))
}

/// The scene of a recorded episode, from what was drawn for it: nothing is drawn again.
///
/// # Errors
/// [`RebuildError`]: a header that lacks a part, that is of another robot, or that makes no scene.
pub fn scene_of(header: &v3::EpisodeHeader, robot: Arc<Robot>) -> Result<Scene, RebuildError> {
    let task: Task = header.task.parse().map_err(|error| RebuildError::header("task", error))?;
    let gains: GainSet = header.gains.parse().map_err(|error| RebuildError::header("gains", error))?;
    if robot_name(header)? != robot.name() {
        let problem = format!("it is '{}', not '{}'", header.robot, robot.name());
        return Err(RebuildError::header("robot", problem));
    }
    let sample = header.domain_sample.as_ref().ok_or(WireError::Missing { field: "domain_sample" })?;
    let config = match header.scene_config.as_str() {
        "" => SceneConfig::default(),
        text => SceneConfig::from_toml(text)?,
    };
    let fixed_layout = header.randomization.is_some_and(|random| random.fixed_layout);
    let spec = SceneSpec {
        parts: SceneKind::of(task).into(),
        seed: if fixed_layout { 0 } else { header.seed },
        gains: robot.gains(gains),
        hand_friction: sample.hand_friction.as_ref().map(|friction| friction.dynamic_friction),
        scale: prop_scale(&sample.prop_scale.unwrap_or_default()),
        layout: Some(layout(sample)?),
        varied: of_scene(&sample.varied),
    };
    Ok(Scene::build(&config, robot, spec)?)
}
