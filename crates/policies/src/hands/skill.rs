//! An expert of one task, and what it sees.

use fiatlux_client::PolicyError;
use fiatlux_room::bulb;
use fiatlux_skills::grip::Touch;
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{ARMS, BodyCommand};
use nalgebra::{Isometry3, Vector3};

use super::arm::Arm;

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
    /// Forces of a bulb on the hand that works.
    pub touch: Touch,
}

/// Force of a bulb, N, that the open hand feels.
pub(super) const TOUCHED: f64 = 1.0;

impl Seen {
    /// The socket hangs from the ceiling; else it is at a wall.
    pub fn hangs(&self) -> bool {
        (self.socket.rotation * Vector3::z()).z.abs() > 0.5
    }

    /// The bulb touches that hand somewhere.
    pub fn is_touched(&self) -> bool {
        self.touch.largest() > TOUCHED
    }
}

/// An expert. It moves an arm and its hand, and commands the whole-body controller.
pub(super) trait Expert: Skill + Send {
    /// Writes the targets of the arm and its fingers, and returns the command for legs and waist.
    ///
    /// # Errors
    /// The arm's kinematics fail.
    fn step(&mut self, seen: &Seen, arm: &mut Arm, targets: &mut [f64]) -> Result<BodyCommand, PolicyError>;

    /// Finds from the first observation where in its task a robot is that is already at it, and goes on from there. Returns the command
    /// by which the robot stands then; `None` where it begins at the start.
    ///
    /// # Errors
    /// The task cannot be played from there, or the arm's kinematics fail.
    fn take_up(&mut self, _seen: &Seen, _arm: &mut Arm) -> Result<Option<BodyCommand>, PolicyError> {
        Ok(None)
    }

    /// Where the arm's joints rest, from the shoulder down, where the hand's pose leaves them free, rad.
    fn rest(&self) -> [f64; ARMS / 2];
}
