//! An expert of one task, and what it sees.

use fiatlux_client::PolicyError;
use fiatlux_proto::v3::Joint;
use fiatlux_robot::Robot;
use fiatlux_room::bulb;
use fiatlux_skills::grip::{Angles, Touch, grasp_of};
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{ARMS, BodyCommand};
use nalgebra::Isometry3;
use serde::de::DeserializeOwned;

use super::arm::RightArm;

/// Bottom of the cap on a bulb's axis, m.
pub(super) const CAP: f64 = bulb::SEAT_Z;
/// Height of the glass's centre on the bulb's axis, and radius of the glass there, m.
pub(super) const GLASS: f64 = LARGEST[0];
pub(super) const GLASS_RADIUS: f64 = LARGEST[2];
/// The last of the balls that a bulb consists of.
const LARGEST: [f64; 3] = bulb::SOLIDS[bulb::SOLIDS.len() - 1];

/// Inputs of an expert in a control step.
#[derive(Clone)]
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
    /// Forces of a bulb on the right hand.
    pub touch: Touch,
}

/// Force of a bulb, N, that the open hand feels.
pub(super) const TOUCHED: f64 = 1.0;

impl Seen {
    /// The bulb touches the right hand somewhere.
    pub fn is_touched(&self) -> bool {
        self.touch.largest() > TOUCHED
    }
}

// `PARAMETERS`: name and text of each file of parameters; the build script writes the list.
include!(concat!(env!("OUT_DIR"), "/parameters.rs"));

/// Parameters of a skill: those of its file for the robot with these joints, but for those given. Joints that its grips leave out are as
/// in the robot's grasp of a bulb.
///
/// # Errors
/// They cannot be read, or there are none for the hands of this robot.
pub(super) fn parameters<P: DeserializeOwned>(
    given: Option<&str>,
    skill: &str,
    joints: &[Joint],
    grips: impl Fn(&mut P) -> Vec<&mut Angles>,
) -> Result<P, PolicyError> {
    let robot = Robot::with_joints(joints.iter().map(|joint| joint.name.as_str())).ok();
    let own = || {
        let robot = robot.as_ref()?;
        let of_robot = format!("{skill}.{}", robot.name());
        let name = if robot.name() == Robot::NAMES[0] { skill } else { &of_robot };
        PARAMETERS.into_iter().find(|(known, _)| *known == name).map(|(_, text)| text)
    };
    let is_known = |name: &String| joints.iter().any(|joint| joint.name == *name);
    let read = |text: &str| toml::from_str::<toml::Table>(text);
    let tables = [own(), given].into_iter().flatten().map(read).collect::<Result<Vec<_>, _>>();
    let table = tables.map_err(PolicyError::of("hands"))?.into_iter().reduce(changed);
    let params: Option<P> = table.map(toml::Table::try_into).transpose().map_err(PolicyError::of("hands"))?;
    let grasp = robot.as_ref().map(grasp_of).unwrap_or_default();
    let completed = |mut params: P| {
        let are_known = grips(&mut params).into_iter().all(|grip| {
            for (name, angle) in &grasp {
                grip.entry(name.clone()).or_insert(*angle);
            }
            grip.keys().all(is_known)
        });
        are_known.then_some(params)
    };
    params.and_then(completed).ok_or_else(|| {
        let known = Robot::NAMES[0];
        let reason = format!("it has no parameters of this task for the robot's hands; use {known}");
        PolicyError::Unfit { policy: "hands", reason }
    })
}

/// A table with the values of another one in place of its own; tables in both are changed in turn.
fn changed(mut own: toml::Table, given: toml::Table) -> toml::Table {
    for (name, value) in given {
        let value = match (own.remove(&name), value) {
            (Some(toml::Value::Table(own)), toml::Value::Table(given)) => toml::Value::Table(changed(own, given)),
            (_, value) => value,
        };
        own.insert(name, value);
    }
    own
}

/// An expert. It moves the right arm and its hand, and commands the whole-body controller.
pub(super) trait Expert: Skill + Send {
    /// Writes the targets of the arm and its fingers, and returns the command for legs and waist.
    ///
    /// # Errors
    /// The arm's kinematics fail.
    fn step(&mut self, seen: &Seen, arm: &mut RightArm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError>;

    /// Finds from the first observation where in its task a robot is that is already at it, and goes on from there. Returns the command
    /// by which the robot stands then; `None` where it begins at the start.
    ///
    /// # Errors
    /// The task cannot be played from there, or the arm's kinematics fail.
    fn take_up(&mut self, _seen: &Seen, _arm: &mut RightArm) -> Result<Option<BodyCommand>, PolicyError> {
        Ok(None)
    }

    /// Where the arm's joints rest, from the shoulder down, where the hand's pose leaves them free, rad.
    fn rest(&self) -> [f64; ARMS / 2];
}
