//! What was drawn for an episode, as messages, and the scene that follows from them.

use std::sync::Arc;

use fiatlux_proto::v3;
use fiatlux_robot::{GainSet, HandKind, Robot};
use fiatlux_rules::{RowError, Task, pose_message, read_pose};
use fiatlux_world::{
    DomainSample, HandFriction, Layout, Light, Mount, Place, PropScale, Randomization, Scene, SceneConfig, SceneError,
    SceneKind, SceneSpec, StartOffset,
};
use nalgebra::Vector2;
use thiserror::Error;

/// Why a header gives no scene.
#[derive(Debug, Error)]
pub enum RebuildError {
    /// A part of it is missing or cannot be read.
    #[error("the bag's header: {field} {problem}; the bag is of another version, or damaged")]
    Header {
        /// The field.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
    },
    /// A pose in it cannot be read.
    #[error("the bag's header")]
    Pose(#[from] RowError),
    /// What it says makes no scene.
    #[error("the bag's header describes no scene")]
    Scene(#[from] SceneError),
}

impl RebuildError {
    fn header(field: &'static str, problem: impl ToString) -> Self {
        Self::Header { field, problem: problem.to_string() }
    }
}

/// The scene of a recorded episode, from what was drawn for it: nothing is drawn again.
///
/// # Errors
/// [`RebuildError`]: a header that lacks a part, or one that makes no scene.
pub fn scene_of(header: &v3::EpisodeHeader, robot: Arc<Robot>) -> Result<Scene, RebuildError> {
    let task: Task = header.task.parse().map_err(|error| RebuildError::header("task", error))?;
    let gains: GainSet = header.gains.parse().map_err(|error| RebuildError::header("gains", error))?;
    header.hands.parse::<HandKind>().map_err(|error| RebuildError::header("hands", error))?;
    let drawn = header.drawn.as_ref().ok_or_else(|| RebuildError::header("drawn", "is missing"))?;
    let config = match header.scene_config.as_str() {
        "" => SceneConfig::default(),
        text => SceneConfig::from_toml(text)?,
    };
    let fixed_layout = header.randomization.is_some_and(|random| random.fixed_layout);
    let spec = SceneSpec {
        kind: SceneKind::of(task),
        seed: if fixed_layout { 0 } else { header.seed },
        gains: robot.gains(gains),
        hand_friction: drawn.hand_friction.as_ref().map(|hand_friction| hand_friction.dynamic_friction),
        scale: prop_scale(&drawn.prop_scale.unwrap_or_default()),
        layout: Some(layout(drawn)?),
    };
    Ok(Scene::build(&config, robot, spec)?)
}

/// The light of a recorded episode; nominal where the header does not say.
pub fn light_of(header: &v3::EpisodeHeader) -> Light {
    let light = header.drawn.as_ref().and_then(|drawn| drawn.light.as_ref());
    light.map_or_else(Light::default, |light| Light {
        dome: light.dome,
        dome_yaw: light.dome_yaw,
        key: light.key,
        key_pitch: light.key_pitch,
        key_yaw: light.key_yaw,
        tint_hue: light.tint_hue,
        tint_saturation: light.tint_saturation,
        tint_value: light.tint_value,
    })
}

/// What varies, from a request.
pub(crate) fn randomization(asked: &v3::Randomization) -> Randomization {
    Randomization {
        layout: !asked.fixed_layout,
        start: !asked.fixed_start,
        hand_friction: !asked.fixed_hand_friction,
        light: !asked.fixed_light,
        tint: !asked.fixed_tint,
        sensors: !asked.exact_sensors,
        prop_scale: asked.prop_scale,
    }
}

/// Sizes, from a message in which 0 stands for 1.
pub(crate) fn prop_scale(asked: &v3::PropScale) -> PropScale {
    let factor = |factor: f64| if factor == 0.0 { 1.0 } else { factor };
    PropScale {
        ladder: [asked.ladder_x, asked.ladder_y, asked.ladder_z].map(factor),
        socket: factor(asked.socket),
        fresh_bulb: factor(asked.fresh_bulb),
    }
}

/// As a message.
pub fn drawn_message(drawn: &DomainSample) -> v3::DomainSample {
    let DomainSample { layout, scale, hand_friction, light, start } = drawn;
    let point = |point: Option<Vector2<f64>>| point.map_or_else(Vec::new, |point| vec![point.x, point.y]);
    let [ladder_x, ladder_y, ladder_z] = scale.ladder;
    let StartOffset { shift: [x, y], turn, joints } = start;
    v3::DomainSample {
        layout: Some(v3::Layout {
            mount: mount_name(layout.mount).into(),
            fixture: Some(pose_message(&layout.world_from_fixture)),
            ladder: Some(place_message(&layout.ladder)),
            robot: Some(place_message(&layout.robot)),
            bench: point(layout.bench),
            crate_: point(layout.crate_),
            anchor: Some(place_message(&layout.anchor)),
        }),
        prop_scale: Some(v3::PropScale {
            ladder_x,
            ladder_y,
            ladder_z,
            socket: scale.socket,
            fresh_bulb: scale.fresh_bulb,
        }),
        hand_friction: hand_friction.as_ref().map(|hand_friction: &HandFriction| v3::HandFriction {
            dynamic_friction: hand_friction.dynamic_friction,
            static_friction: hand_friction.static_friction,
            bucket: hand_friction.bucket,
        }),
        light: Some(v3::Light {
            dome: light.dome,
            dome_yaw: light.dome_yaw,
            key: light.key,
            key_pitch: light.key_pitch,
            key_yaw: light.key_yaw,
            tint_hue: light.tint_hue,
            tint_saturation: light.tint_saturation,
            tint_value: light.tint_value,
        }),
        start: Some(v3::StartNoise { x: *x, y: *y, yaw: *turn, joint_position: joints.to_vec() }),
    }
}

const MOUNTS: [Mount; 4] = [Mount::Ceiling, Mount::West, Mount::East, Mount::South];

fn mount_name(mount: Mount) -> &'static str {
    match mount {
        Mount::Ceiling => "ceiling",
        Mount::West => "west",
        Mount::East => "east",
        Mount::South => "south",
    }
}

fn place_message(place: &Place) -> v3::Place {
    v3::Place { position: vec![place.position.x, place.position.y], yaw: place.yaw }
}

fn layout(drawn: &v3::DomainSample) -> Result<Layout, RebuildError> {
    let layout = drawn.layout.as_ref().ok_or_else(|| RebuildError::header("drawn.layout", "is missing"))?;
    let mount = MOUNTS.into_iter().find(|mount| mount_name(*mount) == layout.mount);
    let place = |field, place: &Option<v3::Place>| {
        let place = place.as_ref().ok_or_else(|| RebuildError::header(field, "is missing"))?;
        Ok::<_, RebuildError>(Place { position: point(field, &place.position)?, yaw: place.yaw })
    };
    let optional = |field, numbers: &[f64]| if numbers.is_empty() { Ok(None) } else { point(field, numbers).map(Some) };
    Ok(Layout {
        mount: mount.ok_or_else(|| RebuildError::header("drawn.layout.mount", "is none that there is"))?,
        world_from_fixture: read_pose("drawn.layout.fixture", &layout.fixture)?,
        anchor: place("drawn.layout.anchor", &layout.anchor)?,
        ladder: place("drawn.layout.ladder", &layout.ladder)?,
        robot: place("drawn.layout.robot", &layout.robot)?,
        bench: optional("drawn.layout.bench", &layout.bench)?,
        crate_: optional("drawn.layout.crate", &layout.crate_)?,
    })
}

fn point(field: &'static str, numbers: &[f64]) -> Result<Vector2<f64>, RebuildError> {
    match numbers {
        [x, y] => Ok(Vector2::new(*x, *y)),
        _ => Err(RebuildError::header(field, format!("has {} numbers instead of 2", numbers.len()))),
    }
}

#[cfg(test)]
mod tests;
