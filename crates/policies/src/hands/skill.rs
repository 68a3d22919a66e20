//! An expert of one task, and what it sees.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::Joint;
use fiatlux_wbc::{ARMS, BodyCommand};
use nalgebra::Isometry3;
use serde::de::DeserializeOwned;

use super::arm::{Angles, FINGERS, RightArm};

/// Bottom of the cap on a bulb's axis, m: `seat_z` of `[bulb]` in `crates/world/scene.toml`.
pub(super) const CAP: f64 = 0.036259;

/// Inputs of an expert in a control step.
pub(super) struct Seen {
    /// Since the episode began, s.
    pub time: f64,
    /// The robot is kept over its feet where they are.
    pub stands: bool,
    /// Poses in the room.
    pub pelvis: Isometry3<f64>,
    pub ladder: Isometry3<f64>,
    pub socket: Isometry3<f64>,
    pub fresh_bulb: Isometry3<f64>,
    pub old_bulb: Isometry3<f64>,
    pub crate_: Isometry3<f64>,
    /// The socket holds the old bulb, the fresh bulb.
    pub seated: [bool; 2],
    /// Largest force of a bulb on a body of each finger of the right hand, N, in the order of [`FINGERS`].
    pub force: [f64; FINGERS.len()],
    /// Largest force of a bulb on the right palm or wrist, N.
    pub palm_force: f64,
}

/// Parameters of a task: those given, or of its files the one whose grip names joints of this robot.
///
/// # Errors
/// They cannot be read, or are not for the hands of this robot.
pub(super) fn parameters<P: DeserializeOwned>(
    given: Option<&str>,
    files: &[&str],
    joints: &[Joint],
    grip: impl Fn(&P) -> &Angles,
) -> Result<P, PolicyError> {
    let is_known = |name: &String| joints.iter().any(|joint| joint.name == *name);
    let given = given.as_ref().map_or(files, std::slice::from_ref);
    for text in given {
        let params: P = toml::from_str(text).map_err(PolicyError::of("hands"))?;
        if grip(&params).keys().all(is_known) {
            return Ok(params);
        }
    }
    let reason = "it has no parameters of this task for the robot's hands; use g1_inspire".into();
    Err(PolicyError::Unfit { policy: "hands", reason })
}

/// An expert. It moves the right arm and its hand, and commands the whole-body controller.
pub(super) trait Skill: Send {
    /// Writes the targets of the arm and its fingers, and returns the command for legs and waist.
    ///
    /// # Errors
    /// The arm's kinematics fail.
    fn step(&mut self, seen: &Seen, arm: &mut RightArm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError>;

    /// Where the arm's joints rest, from the shoulder down, where the hand's pose leaves them free, rad.
    fn rest(&self) -> [f64; ARMS / 2];

    /// Name of the phase that it is in.
    fn phase(&self) -> String;
}
