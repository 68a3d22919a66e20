//! The identity of an episode, without its rows: the start of its digest chain.

use std::collections::BTreeMap;

use fiatlux_judge::{Causes, Protocol};

use crate::digest::RowDigest;
use crate::task::Task;
use crate::thresholds::Thresholds;

/// Name of the varied width of the sensors' noise, which changes no scene.
pub const NOISE: &str = "noise";

/// Name of the varied delay of the actions, which changes no scene.
pub const ACTION_DELAY: &str = "action_delay";

/// Beginning of the names of what varies in the cameras' pictures, which changes no scene.
pub const CAMERA: &str = "camera.";

/// Those of an episode's varied values that change its scene, and with it the rows.
pub fn of_scene(varied: &BTreeMap<String, f64>) -> BTreeMap<String, f64> {
    let is_of_scene = |name: &str| ![NOISE, ACTION_DELAY].contains(&name) && !name.starts_with(CAMERA);
    varied.iter().filter(|(name, _)| is_of_scene(name)).map(|(name, value)| (name.clone(), *value)).collect()
}

/// Drive of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointDrive {
    /// Stiffness of the drive, N m/rad.
    pub stiffness: f64,
    /// Damping of the drive, N m s/rad.
    pub damping: f64,
    /// Largest torque of the drive, N m.
    pub effort_limit: f64,
    /// Rated speed, rad/s; infinite if there is none.
    pub speed_limit: f64,
    /// Inertia of the motor's rotor seen at the joint, kg m^2.
    pub armature: f64,
}

/// Everything besides the rows that must be equal for two digests to be comparable. A world takes it from what it
/// plays, a scorer from a bag's header; both start their chain with [`EpisodeIdentity::digest`].
///
/// Light, tint, the noise of sensors and what varies in pictures touch no row and are not part of it.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeIdentity {
    /// The task that is played.
    pub task: Task,
    /// Seed that draws the room and, with the index, everything else.
    pub seed: u64,
    /// Index of the episode.
    pub episode: u64,
    /// Seed of the layout in force.
    pub layout_seed: u64,
    /// Drives of the joints, by joint index.
    pub drives: Vec<JointDrive>,
    /// Friction of the hands; `None` for the robot's own.
    pub hand_friction: Option<f64>,
    /// Factors of the props' sizes: ladder x, y and z, socket, fresh bulb.
    pub prop_scale: [f64; 5],
    /// The start has noise.
    pub is_start_drawn: bool,
    /// Names of the differences from the published scene besides friction of the hands and sizes; mostly none.
    pub varied: BTreeMap<String, f64>,
    /// All thresholds in force.
    pub thresholds: Thresholds,
    /// The rulebook that ends the episode.
    pub protocol: Protocol,
    /// The causes that end the episode.
    pub ends_on: Causes,
    /// Digest of the robot's file, hexadecimal.
    pub model_digest: String,
    /// Digest of the scene config, the props in nominal size, hexadecimal.
    pub scene_digest: String,
    /// Name and version of the random generator.
    pub generator: String,
}

impl EpisodeIdentity {
    /// The digest chain before row 0.
    pub fn digest(&self) -> RowDigest {
        RowDigest::new(&self.context())
    }

    /// The identity as bytes, in the order of the fields.
    ///
    /// Texts (the task's id, names and digests) are followed by a zero byte; numbers are little-endian, whole ones of 8 bytes,
    /// others f64. Of each drive stiffness, damping, effort limit, speed limit and armature; the friction is NaN for the
    /// robot's own; the start's noise is one byte; thresholds are name and value; the conditions that end it are names
    /// and then an empty text; last come name and value of all that is varied.
    pub fn context(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(4096);
        let text = |bytes: &mut Vec<u8>, text: &str| {
            bytes.extend_from_slice(text.as_bytes());
            bytes.push(0);
        };
        let number = |bytes: &mut Vec<u8>, number: f64| bytes.extend_from_slice(&number.to_le_bytes());
        text(&mut bytes, self.task.id());
        for whole in [self.seed, self.episode, self.layout_seed] {
            bytes.extend_from_slice(&whole.to_le_bytes());
        }
        for drive in &self.drives {
            for value in [drive.stiffness, drive.damping, drive.effort_limit, drive.speed_limit, drive.armature] {
                number(&mut bytes, value);
            }
        }
        number(&mut bytes, self.hand_friction.unwrap_or(f64::NAN));
        for factor in self.prop_scale {
            number(&mut bytes, factor);
        }
        bytes.push(u8::from(self.is_start_drawn));
        for (name, value) in self.thresholds.entries() {
            text(&mut bytes, name);
            number(&mut bytes, value);
        }
        text(&mut bytes, self.protocol.name());
        for cause in self.ends_on.iter() {
            text(&mut bytes, cause.name());
        }
        for last in ["", &self.model_digest, &self.scene_digest, &self.generator] {
            text(&mut bytes, last);
        }
        for (name, value) in &self.varied {
            text(&mut bytes, name);
            number(&mut bytes, *value);
        }
        bytes
    }
}
