//! Stances from which the plug gets into the socket, and the open hand's way off the bulb.

use fiatlux_client::PolicyError;
use fiatlux_room::fixture;
use fiatlux_wbc::BodyCommand;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::hands::apart::Apart;
use crate::hands::arm::{Arm, ToolGoal};
use crate::hands::judge::{Judge, Stance};
use crate::hands::plan::ArmAngles;
use crate::hands::skill::{CAP, Seen};

/// Height above the seat of the stop for the plug, m.
const STOP: f64 = fixture::STOP_HEIGHT;
/// Length of a step along a way that is checked beforehand, m.
const CHECKED: f64 = 0.01;
/// Off the bulb: the most by which gaps may get smaller than they are, m; the gap from which on more of it is not worth more, m; what a
/// metre off the line costs, as a gap, m; and the error of a posture that costs nothing, m.
const CLOSER: f64 = 0.002;
const NARROW: f64 = 0.01;
const OFF_WEIGHT: f64 = 5.0;
const ARRIVED: f64 = 0.002;
/// The side of the hand on which it holds something, in its frame: of both robots' hands.
const PALM: Vector3<f64> = Vector3::new(-1.0, 0.0, 0.0);
/// Turn about the axis of a socket at a wall from a palm straight below the bulb, rad: the arm does not reach that, and from above the hand
/// loses the bulb.
const PALM_TURN: f64 = 0.7;

/// Ways from before the mouth to the seat.
pub(super) struct WaysIn {
    pub(super) seen: Seen,
    pub(super) hand_from_plug: Isometry3<f64>,
    /// The arm's angles with the bulb, rad.
    pub(super) carries_at: ArmAngles,
    /// Where the plug is before the mouth, from the seat, m.
    pub(super) before: f64,
}

/// Turn of a plug about the axis of a socket at a wall with which the palm is below the bulb and beside it. `None` where the palm is at the end
/// of the bulb.
fn turn_at_wall(socket: &UnitQuaternion<f64>, hand_from_plug: &UnitQuaternion<f64>) -> Option<UnitQuaternion<f64>> {
    let (up, palm) = (socket.inverse() * Vector3::z(), hand_from_plug.inverse() * PALM);
    let (up, palm) = (up.xy(), palm.xy());
    let turn = libm::atan2(palm.perp(&up), palm.dot(&up)) + PALM_TURN;
    (palm.norm() > 0.5).then(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn))
}

impl Judge for WaysIn {
    /// The turn about the axis of a socket at the ceiling is the arm's choice.
    async fn judge(
        &self,
        arm: &mut Arm,
        command: &BodyCommand,
        from: &ArmAngles,
        tries: usize,
        least: f64,
    ) -> Result<Option<Stance>, PolicyError> {
        let Self { seen, hand_from_plug, carries_at, before } = self;
        let mut stance = Stance::of(command);
        if stance.score() <= least {
            return Ok(None);
        }
        let at_wall = || turn_at_wall(&seen.socket.rotation, &hand_from_plug.rotation);
        let turn = if seen.hangs() { None } else { at_wall() };
        let goal = |gap: f64| ToolGoal {
            hand_from_tool: *hand_from_plug,
            world_from_tool: seen.socket * Translation3::new(0.0, 0.0, CAP + gap) * turn.unwrap_or_default(),
            free: turn.is_none().then(|| seen.socket.rotation * Vector3::z_axis()),
        };
        arm.assume(command, from);
        let (mut angles, _) = arm.find(true, &goal(STOP), from, tries).await?;
        arm.assume(command, &angles);
        (stance.world_from_hand, stance.gap) = (arm.place(&angles), arm.body_gap().await);
        stance.carried = angles.iter().zip(carries_at).map(|(to, from)| (to - from).abs()).fold(0.0, f64::max);
        let steps = libm::ceil((before - STOP) / CHECKED);
        for step in 0..=steps as usize {
            if stance.score() <= least {
                return Ok(None);
            }
            angles = stance.go_on(arm, &goal(STOP + (before - STOP) * step as f64 / steps), &angles).await?;
            stance.postures.push(angles);
        }
        stance.postures.reverse();
        Ok(Some(stance).filter(|stance| stance.score() > least))
    }
}

/// The way of the open hand off the bulb: postures of the arm on a straight line by one of these moves, in the hand's frame. It is the
/// one on which the hand stays on its line and gets the widest gaps to all around; empty where all strike something.
pub(super) async fn way_out(
    arm: &mut Arm,
    from: &Isometry3<f64>,
    moves: &[Vector3<f64>],
) -> Result<Vec<ArmAngles>, PolicyError> {
    let began = arm.angles();
    let least = arm.gap(&began, Apart::All).await.min(0.0) - CLOSER;
    let mut best: Option<(f64, Vec<ArmAngles>)> = None;
    for change in moves {
        let steps = libm::ceil(change.norm() / CHECKED);
        let (mut angles, mut way, mut off, mut gap) = (began, Vec::new(), 0.0_f64, Vec::new());
        for step in 1..=steps as usize {
            let world_from_tool = from * Translation3::from(change * (step as f64 / steps));
            let goal = ToolGoal { hand_from_tool: Isometry3::identity(), world_from_tool, free: None };
            let (found, error) = arm.find(true, &goal, &angles, 1).await?;
            (angles, off) = (found, off.max(error));
            gap.push(arm.gap(&angles, Apart::All).await);
            way.push(angles);
        }
        let narrowest = gap.iter().copied().fold(f64::INFINITY, f64::min);
        let last = gap.last().copied().unwrap_or_default();
        let score = narrowest.min(NARROW) + last - OFF_WEIGHT * (off - ARRIVED).max(0.0);
        if narrowest > least && best.as_ref().is_none_or(|(most, _)| score > *most) {
            best = Some((score, way));
        }
    }
    Ok(best.map(|(_, way)| way).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_a_wall_the_palm_is_turned_from_straight_below_by_as_much_as_it_is_to_be() {
        for index in 0..12 {
            let turned = |part: f64| part * f64::from(index);
            let socket = UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, turned(0.5));
            let hand_from_plug = UnitQuaternion::from_euler_angles(turned(0.03), turned(0.02), turned(0.6));
            let turn = turn_at_wall(&socket, &hand_from_plug).expect("the palm is beside the bulb");
            let axis = socket * Vector3::z();
            let across = |way: Vector3<f64>| (way - axis * axis.dot(&way)).normalize();
            let (palm, up) = (across(socket * turn * hand_from_plug.inverse() * PALM), across(Vector3::z()));
            // From up to the palm, about the axis.
            let angle = libm::atan2(axis.dot(&up.cross(&palm)), up.dot(&palm));
            assert!((angle - PALM_TURN).abs() < 1e-9, "{index}: {angle}");
        }
        let at_the_end = UnitQuaternion::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
        assert!(turn_at_wall(&UnitQuaternion::identity(), &at_the_end).is_none());
    }
}
