//! Domain samples, as messages and back.

use fiatlux_proto::v3;
use fiatlux_world::{
    DomainSample, EpisodeRanges, Layout, Light, Mount, Place, PropScale, Randomization, RangeError, StartOffset,
};
use nalgebra::Vector2;

use crate::WireError;
use crate::pose::{pose_message, read_pose};

/// The light of a recorded episode; nominal where the header does not say.
pub fn light_of(header: &v3::EpisodeHeader) -> Light {
    let light = header.domain_sample.as_ref().and_then(|sample| sample.light.as_ref());
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

pub fn randomization(asked: &v3::Randomization) -> Randomization {
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
pub fn prop_scale(asked: &v3::PropScale) -> PropScale {
    let factor = |factor: f64| if factor == 0.0 { 1.0 } else { factor };
    PropScale {
        ladder: [asked.ladder_x, asked.ladder_y, asked.ladder_z].map(factor),
        socket: factor(asked.socket),
        fresh_bulb: factor(asked.fresh_bulb),
    }
}

/// Ranges of a session.
///
/// # Errors
/// [`RangeError`] for a name that is not known, or a range that is empty or beyond its limits.
pub fn episode_ranges(asked: &v3::OpenRequest) -> Result<EpisodeRanges, RangeError> {
    EpisodeRanges::new(asked.ranges.iter().map(|(name, range)| (name.clone(), [range.least, range.most])))
}

pub fn domain_sample_message(sample: &DomainSample) -> v3::DomainSample {
    let DomainSample { layout, scale, hand_friction, light, start, varied } = sample;
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
        hand_friction: hand_friction.as_ref().map(|friction| v3::HandFriction {
            dynamic_friction: friction.dynamic_friction,
            static_friction: friction.static_friction,
            bucket: friction.bucket,
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
        start: Some(v3::StartNoise { x: *x, y: *y, yaw: *turn, joint_position: joints.clone() }),
        varied: varied.clone(),
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

/// The layout in a message.
pub(crate) fn layout(sample: &v3::DomainSample) -> Result<Layout, WireError> {
    let layout = sample.layout.as_ref().ok_or(WireError::Missing { field: "domain_sample.layout" })?;
    let mount = MOUNTS.into_iter().find(|mount| mount_name(*mount) == layout.mount);
    let place = |field, place: &Option<v3::Place>| {
        let place = place.as_ref().ok_or(WireError::Missing { field })?;
        Ok::<_, WireError>(Place { position: point(field, &place.position)?, yaw: place.yaw })
    };
    let optional = |field, numbers: &[f64]| if numbers.is_empty() { Ok(None) } else { point(field, numbers).map(Some) };
    Ok(Layout {
        mount: mount.ok_or_else(|| unknown_mount(&layout.mount))?,
        world_from_fixture: read_pose("domain_sample.layout.fixture", &layout.fixture)?,
        anchor: place("domain_sample.layout.anchor", &layout.anchor)?,
        ladder: place("domain_sample.layout.ladder", &layout.ladder)?,
        robot: place("domain_sample.layout.robot", &layout.robot)?,
        bench: optional("domain_sample.layout.bench", &layout.bench)?,
        crate_: optional("domain_sample.layout.crate", &layout.crate_)?,
    })
}

fn point(field: &'static str, numbers: &[f64]) -> Result<Vector2<f64>, WireError> {
    match numbers {
        [x, y] => Ok(Vector2::new(*x, *y)),
        _ => Err(WireError::Length { field, found: numbers.len(), expected: 2 }),
    }
}

fn unknown_mount(name: &str) -> WireError {
    let problem = format!("'{name}' is not a known mount; known ones are {}", MOUNTS.map(mount_name).join(", "));
    WireError::Value { field: "domain_sample.layout.mount", problem }
}
