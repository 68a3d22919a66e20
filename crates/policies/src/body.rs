//! Shared by the policies that use a whole-body controller, ours or a foreign one.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use fiatlux_proto::v3::{self, Observation, Pose, SessionInfo};
use fiatlux_wbc::{BodyCommand, Joint, Network, Proprioception, Sensed, WbcError};

use fiatlux_client::PolicyError;
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Joints of a session, in the form in which controllers compare them with their own.
pub(super) fn joints(info: &SessionInfo) -> Vec<Joint> {
    let joint = |joint: &v3::Joint| Joint {
        name: joint.name.clone(),
        q0: joint.q0,
        stiffness: joint.stiffness,
        damping: joint.damping,
        effort_limit: joint.effort_limit,
    };
    info.joints.iter().map(joint).collect()
}

/// Targets that keep the staged posture, for all joints, rad.
///
/// # Errors
/// The session lacks a term that a controller reads.
pub(super) fn staged(policy: &'static str, info: &SessionInfo, first: &Observation) -> Result<Vec<f64>, PolicyError> {
    if first.last_action.is_empty() {
        return Err(PolicyError::Sensor { policy, sensor: "last_action" });
    }
    if first.proprioception.is_none() {
        return Err(PolicyError::Sensor { policy, sensor: "proprioception" });
    }
    let target = |(joint, action): (&v3::Joint, &f32)| joint.q0 + info.action_scale * f64::from(*action);
    Ok(info.joints.iter().zip(&first.last_action).map(target).collect())
}

/// A pose of the privileged observation.
///
/// # Errors
/// It is missing.
pub(super) fn pose(policy: &'static str, pose: Option<&Pose>) -> Result<Isometry3<f64>, PolicyError> {
    let missing = || PolicyError::Unfit { policy, reason: "the privileged observation lacks a pose".into() };
    let pose = pose.ok_or_else(missing)?;
    let (&[x, y, z], &[w, i, j, k]) = (pose.position.as_slice(), pose.quaternion.as_slice()) else {
        return Err(missing());
    };
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Ok(Isometry3::from_parts(Vector3::new(x, y, z).into(), rotation))
}

/// The message of a pose.
pub(super) fn message(pose: &Isometry3<f64>) -> Pose {
    let rotation = pose.rotation.quaternion();
    Pose {
        position: pose.translation.vector.iter().copied().collect(),
        quaternion: vec![rotation.w, rotation.i, rotation.j, rotation.k],
    }
}

/// The proprioception of an observation.
///
/// # Errors
/// The observation has no proprioception.
pub(super) fn sensed<'a>(
    policy: &'static str,
    observation: &'a Observation,
) -> Result<&'a v3::Proprioception, PolicyError> {
    observation.proprioception.as_ref().ok_or(PolicyError::Sensor { policy, sensor: "proprioception" })
}

/// Sensed angles of all joints, rad.
pub(super) fn angles(sensed: &v3::Proprioception, q0: &[f64]) -> Vec<f64> {
    sensed.joint_position.iter().zip(q0).map(|(turned, q0)| f64::from(*turned) + q0).collect()
}

/// Converts observations for controllers.
pub(super) struct Senses {
    /// Name of the policy, for its errors.
    pub policy: &'static str,
    sensed: Proprioception,
}

impl Senses {
    pub fn new(policy: &'static str) -> Self {
        Self { policy, sensed: Proprioception::default() }
    }

    /// Reads the observation's proprioception. The controller refuses terms that are too short.
    ///
    /// # Errors
    /// The observation has no proprioception.
    pub fn read(&mut self, observation: &Observation) -> Result<Sensed<'_>, PolicyError> {
        Ok(self.sensed.read(sensed(self.policy, observation)?))
    }
}

/// Our controller with the weights of `file`, or with those of this version if that is empty, and its name for the record.
/// `text` are the policy's arguments, which begin with the file.
///
/// # Errors
/// A file that cannot be read, or that does not fit.
pub(super) fn network(kind: &str, file: &str, text: &str) -> Result<(String, Arc<Network>), PolicyError> {
    let network = if file.is_empty() { shipped() } else { Network::read(Path::new(file)).map(Arc::new) };
    let network = network.map_err(PolicyError::of("walk"))?;
    let name = match (file, text) {
        ("", "") => kind.into(),
        ("", text) => format!("{kind}:{text}"),
        (_, text) => label(kind, text, &[network.digest()]),
    };
    Ok((name, network))
}

/// The controller that comes with this version, read once: experts of many worlds share it.
fn shipped() -> Result<Arc<Network>, WbcError> {
    static SHIPPED: OnceLock<Arc<Network>> = OnceLock::new();
    if let Some(network) = SHIPPED.get() {
        return Ok(Arc::clone(network));
    }
    let network = Arc::new(Network::shipped()?);
    Ok(Arc::clone(SHIPPED.get_or_init(|| network)))
}

/// Name for the record of a controller whose arguments are `FILE[,WORDS]`: `KIND:FILE@DIGESTS[,WORDS]`, with the last part of
/// the path, and with the first eight digits of the SHA-256 of each network.
pub(super) fn label(kind: &str, text: &str, digests: &[&str]) -> String {
    let path = text.split(',').next().unwrap_or_default();
    let (file, words) = (Path::new(path).file_name().unwrap_or_default().display(), &text[path.len()..]);
    let digests = digests.iter().map(|digest| &digest[..8]).collect::<Vec<_>>().join("+");
    format!("{kind}:{file}@{digests}{words}")
}

/// Parses words such as `vx=0.4,wz=0.2` into names and values, each with its whole word. Empty words are skipped.
///
/// # Errors
/// [`PolicyError::Words`]: a word is not NAME=VALUE; `fields` are the known names.
pub(super) fn words<'a>(
    text: &'a str,
    fields: &'static str,
) -> impl Iterator<Item = Result<(&'a str, &'a str, &'a str), PolicyError>> {
    text.split(',').filter(|word| !word.trim().is_empty()).map(move |word| {
        let wrong = || PolicyError::Words { word: word.into(), fields };
        word.split_once('=').map(|(name, value)| (word, name.trim(), value.trim())).ok_or_else(wrong)
    })
}

/// Sets a field of a command; `None` if the field is unknown or the value is not a finite number.
pub(super) fn set(command: &mut BodyCommand, name: &str, value: &str) -> Option<()> {
    let (mut numbers, index) = (command.numbers(), BodyCommand::NAMES.iter().position(|known| *known == name)?);
    numbers[index] = value.parse().ok().filter(|value: &f64| value.is_finite())?;
    *command = numbers.into();
    Some(())
}
