//! A stance and its worth: how well the arm does its work where the robot leans so.

use std::future::Future;

use fiatlux_client::PolicyError;
use fiatlux_wbc::BodyCommand;
use nalgebra::Isometry3;

use super::apart::Apart;
use super::arm::{Arm, ToolGoal};
use super::plan::ArmAngles;

/// Room of the joints, rad, and gap, m, from which on more of it is not worth more.
const MAX_ROOM: f64 = 0.35;
const MAX_GAP: f64 = 0.02;
/// Worth of a metre of a gap, and how much more one of an overlap costs, as room of the joints, rad.
const GAP_WORTH: [f64; 2] = [10.0, 40.0];

/// A stance, with the arm's postures from the one before the work to the one of the work.
#[derive(Debug, Clone)]
pub(super) struct Stance {
    pub command: BodyCommand,
    pub postures: Vec<ArmAngles>,
    /// Pose of the hand at the work.
    pub world_from_hand: Isometry3<f64>,
    /// Least room of the joints, rad.
    pub room: f64,
    /// Smallest gap to what surrounds the robot, m.
    pub gap: f64,
    /// Farthest that the hand stays from where it is wanted, m.
    pub error: f64,
    /// Largest turn of a joint from where it is to the work with a bulb in the hand, rad: on a long way it slips.
    pub carried: f64,
}

/// Judges how well the arm does its work in a stance.
pub(super) trait Judge: Send + Sync + 'static {
    /// The stance of a command, the arm searched from a posture in so many tries. `None` where its score is not above `least`.
    fn judge(
        &self,
        arm: &mut Arm,
        command: &BodyCommand,
        from: &ArmAngles,
        tries: usize,
        least: f64,
    ) -> impl Future<Output = Result<Option<Stance>, PolicyError>> + Send;
}

/// Judges a robot that stands upright with its arm in a posture.
pub(super) struct Standing(pub ArmAngles);

impl Judge for Standing {
    async fn judge(
        &self,
        arm: &mut Arm,
        command: &BodyCommand,
        _from: &ArmAngles,
        _tries: usize,
        least: f64,
    ) -> Result<Option<Stance>, PolicyError> {
        let mut stance = Stance::of(command);
        (stance.postures, stance.world_from_hand) = (vec![self.0], arm.place(&self.0));
        Ok(Some(stance).filter(|stance| stance.score() > least))
    }
}

impl Stance {
    /// Preference among stances: being there counts most, then room to the limits and to what is around, then a small lean and a short way.
    pub fn score(&self) -> f64 {
        let lean: f64 = self.command.torso.iter().map(|angle| angle.abs()).sum();
        let short = (self.error - 1e-3).max(0.0);
        self.room.min(MAX_ROOM) + GAP_WORTH[0] * self.gap.min(MAX_GAP) + GAP_WORTH[1] * self.gap.min(0.0)
            - 50.0 * short
            - 0.1 * lean
            - 0.2 * self.carried
    }

    /// A stance of a command in which nothing is known yet to stand in the arm's way: no judgement of it can score more.
    pub fn of(command: &BodyCommand) -> Self {
        Self {
            command: *command,
            postures: Vec::new(),
            world_from_hand: Isometry3::identity(),
            room: f64::INFINITY,
            gap: f64::INFINITY,
            error: 0.0,
            carried: 0.0,
        }
    }

    /// Goes on to a goal from a posture; room, gap and error are those of the worst so far.
    pub async fn go_on(&mut self, arm: &mut Arm, goal: &ToolGoal, from: &ArmAngles) -> Result<ArmAngles, PolicyError> {
        let (angles, error) = arm.find(true, goal, from, 1).await?;
        self.error = self.error.max(error);
        self.room = self.room.min(arm.room(&angles));
        self.gap = self.gap.min(arm.gap(&angles, Apart::Working).await);
        Ok(angles)
    }

    /// Posture of the work.
    pub fn last(&self) -> ArmAngles {
        self.postures.last().copied().unwrap_or_default()
    }
}
