use std::collections::BTreeMap;
use std::ops::Range;

use fiatlux_dynamics::{BodyId, ModelBuilder, ModelError, ShapeId};
use fiatlux_robot::{Gains, Robot};
use fiatlux_rules::{ACTION_DELAY, CONTROL_DT, Motion, NOISE, manifest};
use nalgebra::Vector3;
use thiserror::Error;

use super::camera::{CAMERA_RANGES, DELAY, LOOK, PATTERN};
use crate::{Random, ShapeOwner, Stream};

/// Values drawn from [`EpisodeRanges`], by name.
pub type Varied = BTreeMap<String, f64>;

/// Ranges, least and greatest value, from which each episode draws what the benchmark holds constant. The names:
///
/// | name | what | limits |
/// |---|---|---|
/// | `gravity` | acceleration downwards, m/s^2 | 0 to 100 |
/// | `noise` | factor of the half-width of all noise of the sensors | 0 to 100 |
/// | `action_delay` | time from an action to its effect, ms, in steps of 20 | 0 to 100 |
/// | `floor_friction` | friction of floor and soles | 0 to 10 |
/// | `hand_friction` | friction of the hands, in place of what the episode draws | 0 to 10 |
/// | `friction.NAME` | friction of all surfaces of `floor`, `room`, `bench`, `robot` or a thing; of two materials the larger coefficient counts, but for one with priority | 0 to 10 |
/// | `thing_mass.NAME` | factor of the mass of a thing that moves | 0.01 to 100 |
/// | `robot_mass` | factor of the mass of the robot's bodies, all by the same | 0.5 to 2 |
/// | `gains` | factor of stiffness and damping of the robot's drives, all by the same | 0.5 to 2 |
/// | `camera.x`, `.y`, `.z` | shift of all cameras in their own frames: ahead, left, up, m | -0.1 to 0.1 |
/// | `camera.roll`, `.pitch`, `.yaw` | turn of all cameras in their own frames, rad | -0.5 to 0.5 |
/// | `camera.angle` | factor of the angle of view | 0.5 to 1.5 |
/// | `camera.exposure` | brightness of pictures, by powers of two | -4 to 4 |
/// | `camera.noise` | half-width of the uniform noise of each byte of a picture | 0 to 64 |
/// | `camera.blur` | standard deviation of the blur, pixels | 0 to 8 |
/// | `camera.delay` | time from a row to its picture, ms, in steps of 20 | 0 to 100 |
/// | `camera.colours` | largest change of red, green and blue of each colour, as a share | 0 to 1 |
/// | `camera.pattern` | pattern on floor and walls: 0 for none, or a number from 1 to 8 | 0 to 8 |
/// | `camera.look` | look of things: 1 for the benchmark's, 2 for that of pictures for people | 1 to 2 |
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EpisodeRanges(BTreeMap<String, [f64; 2]>);

/// A range from which nothing can be drawn.
#[derive(Debug, Clone, PartialEq, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum RangeError {
    #[error("'{name}' has no range; use {}", known_names())]
    Name { name: String },
    #[error("{name} is from {least} to {most}; give least and greatest value, from {low} to {high}{rule}")]
    Value { name: String, least: f64, most: f64, low: f64, high: f64, rule: &'static str },
}

const GRAVITY: &str = "gravity";
const FLOOR_FRICTION: &str = "floor_friction";
const HAND_FRICTION: &str = "hand_friction";
const ROBOT_MASS: &str = "robot_mass";
const GAINS: &str = "gains";
const FRICTION: &str = "friction.";
const THING_MASS: &str = "thing_mass.";

/// Largest delay of an action, ms.
const MAX_DELAY_MS: f64 = 100.0;

impl EpisodeRanges {
    /// Checks ranges by name.
    ///
    /// # Errors
    /// [`RangeError`] for the first name that is not known, or the first range that is empty or beyond its limits.
    pub fn new(ranges: impl IntoIterator<Item = (String, [f64; 2])>) -> Result<Self, RangeError> {
        let ranges: BTreeMap<_, _> = ranges.into_iter().collect();
        for (name, [least, most]) in &ranges {
            let ([low, high], rule) = limits(name).ok_or_else(|| RangeError::Name { name: name.clone() })?;
            let is_step = |value: f64| step_of(name).is_none_or(|step| value % step == 0.0);
            if !(low <= *least && least <= most && *most <= high && is_step(*least) && is_step(*most)) {
                return Err(RangeError::Value { name: name.clone(), least: *least, most: *most, low, high, rule });
            }
        }
        Ok(Self(ranges))
    }

    /// The range of that name.
    pub fn get(&self, name: &str) -> Option<[f64; 2]> {
        self.0.get(name).copied()
    }

    /// Name, least and greatest value of each, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, [f64; 2])> {
        self.0.iter().map(|(name, range)| (name.as_str(), *range))
    }

    /// Draws from each range, uniformly. Each has a stream of its own, so that one more changes no other.
    pub fn draw(&self, seed: u64, episode: u64) -> Varied {
        let value = |name: &str, [least, most]: [f64; 2]| {
            let mut random = Random::of_term(Stream::Ranges, name, seed, episode);
            if let Some(step) = step_of(name) {
                let steps = ((most - least) / step) as usize;
                return least + step * random.index(steps + 1) as f64;
            }
            // Rounding may lead past the end.
            random.uniform(least, most).clamp(least, most)
        };
        self.iter().map(|(name, range)| (name.to_owned(), value(name, range))).collect()
    }
}

/// Factor of the noise of the sensors.
pub fn noise_scale(varied: &Varied) -> f64 {
    varied.get(NOISE).copied().unwrap_or(1.0)
}

/// Delay of the actions, control steps; `None` where it is not drawn.
pub fn delay_steps(varied: &Varied) -> Option<usize> {
    varied.get(ACTION_DELAY).map(|ms| (ms / delay_step_ms()).round() as usize)
}

/// Drives with what is drawn for them.
pub(crate) fn vary_gains(varied: &Varied, gains: &Gains) -> Gains {
    let mut gains = gains.clone();
    if let Some(factor) = varied.get(GAINS) {
        gains.scale(0..gains.0.len(), *factor);
    }
    gains
}

/// Refuses a value that could not have been drawn for a scene.
pub(crate) fn check_varied(varied: &Varied) -> Result<(), RangeError> {
    EpisodeRanges::new(varied.iter().map(|(name, value)| (name.clone(), [*value; 2]))).map(drop)
}

/// Changes a finished scene, before its model is built.
///
/// `robot_bodies` are the robot's among the builder's.
pub(crate) fn vary(
    varied: &Varied,
    robot: &Robot,
    robot_bodies: Range<usize>,
    builder: &mut ModelBuilder,
) -> Result<(), ModelError> {
    for (name, value) in varied {
        if name == GRAVITY {
            builder.set_gravity(Vector3::new(0.0, 0.0, -value));
        } else if let Some(thing) = name.strip_prefix(THING_MASS) {
            let body = builder.bodies().iter().position(|body| body.spec.name == thing);
            body.map_or(Ok(()), |body| builder.scale_mass(BodyId(body), *value))?;
        } else if name == ROBOT_MASS {
            for body in robot_bodies.clone() {
                builder.scale_mass(BodyId(body), *value)?;
            }
        } else {
            let is_meant = |owner: ShapeOwner| match owner {
                ShapeOwner::Floor if name == FLOOR_FRICTION => true,
                ShapeOwner::Robot(link) if name == FLOOR_FRICTION => robot.feet().contains(&link),
                ShapeOwner::Robot(link) if name == HAND_FRICTION => robot.is_hand_surface(link),
                owner => name.strip_prefix(FRICTION) == Some(owner.name()),
            };
            for shape in 0..builder.shapes().len() {
                if is_meant(ShapeOwner::from_label(builder.shapes()[shape].label)) {
                    builder.set_friction(ShapeId(shape), *value)?;
                }
            }
        }
    }
    Ok(())
}

fn limits(name: &str) -> Option<([f64; 2], &'static str)> {
    match name {
        GRAVITY => Some(([0.0, 100.0], " m/s^2")),
        NOISE => Some(([0.0, 100.0], "")),
        ACTION_DELAY => Some(([0.0, MAX_DELAY_MS], " ms in steps of 20")),
        FLOOR_FRICTION | HAND_FRICTION => Some(([0.0, 10.0], "")),
        ROBOT_MASS | GAINS => Some(([0.5, 2.0], "")),
        name => {
            let of_camera = CAMERA_RANGES.iter().find(|(known, ..)| *known == name);
            let of_camera = of_camera.map(|(_, limits, unit)| (*limits, *unit));
            let surface = name.strip_prefix(FRICTION).filter(|name| surfaces().any(|known| known == *name));
            let thing = name.strip_prefix(THING_MASS).filter(|name| free_things().any(|(known, _)| known == *name));
            of_camera.or(surface.map(|_| ([0.0, 10.0], ""))).or(thing.map(|_| ([0.01, 100.0], "")))
        }
    }
}

/// Distance between the values that a name takes; `None` where all between the least and the greatest are.
fn step_of(name: &str) -> Option<f64> {
    match name {
        ACTION_DELAY | DELAY => Some(delay_step_ms()),
        PATTERN | LOOK => Some(1.0),
        _ => None,
    }
}

fn known_names() -> String {
    let surfaces: Vec<_> = surfaces().collect();
    let things: Vec<_> = free_things().map(|(name, _)| name).collect();
    let cameras: Vec<_> = CAMERA_RANGES.iter().map(|(name, ..)| *name).collect();
    format!(
        "{GRAVITY}, {NOISE}, {ACTION_DELAY}, {FLOOR_FRICTION}, {HAND_FRICTION}, {ROBOT_MASS}, {GAINS}, {}, {FRICTION} with {}, or {THING_MASS} with {}",
        cameras.join(", "),
        surfaces.join(", "),
        things.join(", ")
    )
}

/// Length of a control step, ms.
fn delay_step_ms() -> f64 {
    (CONTROL_DT * 1e3).round()
}

/// Names of the owners of surfaces: parts of the room, the robot, and the things of the manifest.
pub fn surfaces() -> impl Iterator<Item = &'static str> {
    let room = [ShapeOwner::Floor, ShapeOwner::Room, ShapeOwner::Bench, ShapeOwner::Robot(0)];
    room.into_iter().map(ShapeOwner::name).chain(manifest().things.iter().map(|thing| thing.name.as_str()))
}

/// Name and index of each thing that can move.
pub fn free_things() -> impl Iterator<Item = (&'static str, usize)> {
    let things = manifest().things.iter().enumerate();
    things.filter(|(_, thing)| thing.motion == Motion::Free).map(|(index, thing)| (thing.name.as_str(), index))
}
