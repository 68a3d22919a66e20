//! Stances from which the hand gets to the bulb in the socket, and can pull it out.

use fiatlux_client::PolicyError;
use fiatlux_wbc::BodyCommand;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::hands::apart::Apart;
use crate::hands::arm::{Arm, ToolGoal};
use crate::hands::judge::{Judge, Stance};
use crate::hands::plan::ArmAngles;
use crate::hands::skill::{GLASS, Seen};

/// Length of a step along a way that is checked beforehand, m.
const CHECKED: f64 = 0.015;

/// The hold of the glass and the way there, as `[grasp]` of `remove.toml` has it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Grasp {
    pub(super) hand_from_glass: [f64; 3],
    pub(super) tilts: Vec<[f64; 2]>,
    pub(super) back: [f64; 3],
    pub(super) speed: f64,
    pub(super) error: f64,
    pub(super) stray: f64,
    pub(super) gain: f64,
    pub(super) lead: f64,
    pub(super) patience: f64,
}

/// The glass's frame: its centre, with the bulb's axes.
pub(super) fn glass(seen: &Seen) -> Isometry3<f64> {
    seen.old_bulb * Translation3::new(0.0, 0.0, GLASS)
}

/// Ways from beside the glass to around it and out of the socket.
pub(super) struct Ways {
    pub(super) seen: Seen,
    pub(super) grasp: Grasp,
    /// Length of the pull, m.
    pub(super) out: f64,
}

impl Judge for Ways {
    /// By the grasp that the arm reaches best. Its turn about the socket's axis is the arm's choice. What the arm needs to pull
    /// counts, too.
    async fn judge(
        &self,
        arm: &mut Arm,
        command: &BodyCommand,
        from: &ArmAngles,
        tries: usize,
        least: f64,
    ) -> Result<Option<Stance>, PolicyError> {
        let mut best: Option<Stance> = None;
        for tilt in &self.grasp.tilts {
            let least = best.as_ref().map_or(least, Stance::score);
            best = self.way(arm, *tilt, command, from, tries, least).await?.or(best);
        }
        Ok(best)
    }
}

impl Ways {
    /// Postures from beside the glass to around it by a grasp. `None` where the stance's score is not above `least`.
    async fn way(
        &self,
        arm: &mut Arm,
        [about_x, about_y]: [f64; 2],
        command: &BodyCommand,
        from: &ArmAngles,
        tries: usize,
        least: f64,
    ) -> Result<Option<Stance>, PolicyError> {
        let Self { seen, grasp, out } = self;
        let mut stance = Stance::of(command);
        if stance.score() <= least {
            return Ok(None);
        }
        let hand_from_glass = Isometry3::from_parts(
            Translation3::from(grasp.hand_from_glass),
            UnitQuaternion::from_euler_angles(about_x, about_y, 0.0),
        );
        let axis = seen.socket.rotation * Vector3::z_axis();
        let around = ToolGoal { hand_from_tool: hand_from_glass, world_from_tool: glass(seen), free: Some(axis) };
        arm.assume(command, from);
        let (angles, _) = arm.find(true, &around, from, tries).await?;
        arm.assume(command, &angles);
        let (angles, error) = arm.find(true, &around, &angles, 1).await?;
        let around = arm.place(&angles);
        (stance.world_from_hand, stance.postures) = (around, vec![angles]);
        (stance.room, stance.error) = (arm.room(&angles), error);
        stance.gap = arm.body_gap().await.min(arm.gap(&angles, Apart::Working).await);
        let back = Vector3::from(grasp.back);
        let mut now = angles;
        let steps = libm::ceil(back.norm() / CHECKED);
        for step in 1..=steps as usize {
            if stance.score() <= least {
                return Ok(None);
            }
            let world_from_tool = around * Translation3::from(back * (step as f64 / steps));
            let goal = ToolGoal { hand_from_tool: Isometry3::identity(), world_from_tool, free: None };
            now = stance.go_on(arm, &goal, &now).await?;
            stance.postures.push(now);
        }
        stance.gap = stance.gap.min(arm.gap(&now, Apart::All).await);
        stance.postures.reverse();
        let mut now = angles;
        let steps = libm::ceil(out / CHECKED);
        for step in 1..=steps as usize {
            if stance.score() <= least {
                return Ok(None);
            }
            let world_from_tool = Translation3::from(axis.scale(out * step as f64 / steps)) * glass(seen);
            let goal = ToolGoal { hand_from_tool: hand_from_glass, world_from_tool, free: Some(axis) };
            now = stance.go_on(arm, &goal, &now).await?;
        }
        Ok(Some(stance).filter(|stance| stance.score() > least))
    }
}
