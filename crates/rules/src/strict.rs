//! The additional criteria of protocol `strict`: one for each way in which a stunt can pass the published gates.
//!
//! A strict gate is all published criteria of its task and those of this page that the task names, always [`upright`] among them; it holds for
//! at least a second. Nothing may have fallen, tipped, dropped or broken before, and the robot may not have leapt.

use crate::context::{Context, Criterion};
use crate::errand;
use crate::measure::{self, GRAVITY};
use crate::parts::{Bulb, Support};
use crate::predicates::standing;
use crate::row::Row;

/// Pelvis upright: a robot on its way to the floor passes through most postures.
pub(crate) const UPRIGHT: Criterion = Criterion { name: "upright", holds: upright };
/// On the ladder: a jump lifts the pelvis as high as a climb, but nothing carries it there.
pub(crate) const UP: Criterion = Criterion { name: "carried_by_treads", holds: carried_by_treads };
/// Off the ladder: a drop brings the pelvis down, but the robot does not stand then.
pub(crate) const DOWN: Criterion = Criterion { name: "carried_by_floor", holds: carried_by_floor };
/// On the feet: the published gates of navigation do not ask for it.
pub(crate) const STANDING: Criterion = Criterion { name: "standing", holds: standing };
/// Arrived: whoever runs or falls past a place is not there.
pub(crate) const SLOW: Criterion = Criterion { name: "slow", holds: slow };
/// The old bulb in the grip of one hand: a bulb that is kicked, juggled or carried on a forearm feels a hand, too.
pub(crate) const OLD_GRIP: Criterion =
    Criterion { name: "old_bulb_in_grip", holds: |row, cx| in_grip(row, cx, Bulb::Old) };
/// The fresh bulb in the grip of one hand.
pub(crate) const FRESH_GRIP: Criterion =
    Criterion { name: "fresh_bulb_in_grip", holds: |row, cx| in_grip(row, cx, Bulb::Fresh) };

/// The pelvis is tilted by less than half of what counts as fallen.
pub fn upright(row: &Row, cx: &Context<'_>) -> bool {
    measure::tilt(&row.robot.pose) < cx.thresholds.strict_tilt_rad
}

/// Both feet, or one foot and both arms, stand on treads from the second on or on the platform.
pub fn carried_by_treads(row: &Row, cx: &Context<'_>) -> bool {
    let is_loaded = |limb: Support| row.load(errand::TREAD_LOAD)[limb as usize] > cx.thresholds.strict_load_n;
    let feet = [Support::LeftFoot, Support::RightFoot].map(is_loaded);
    let arms = [Support::LeftArm, Support::RightArm].map(is_loaded);
    (feet[0] && feet[1]) || ((feet[0] || feet[1]) && arms[0] && arms[1])
}

/// Both soles are on the floor and carry most of the robot's weight.
pub fn carried_by_floor(row: &Row, cx: &Context<'_>) -> bool {
    let soles = [Support::LeftFoot, Support::RightFoot].map(|limb| row.load(errand::FLOOR_LOAD)[limb as usize]);
    let weight = cx.geometry.robot_mass * GRAVITY;
    soles.iter().all(|load| *load > cx.thresholds.strict_load_n)
        && soles.iter().sum::<f64>() >= cx.thresholds.strict_floor_share * weight
}

/// The pelvis moves slower than a robot that has arrived.
pub fn slow(row: &Row, cx: &Context<'_>) -> bool {
    row.robot.linear_velocity.norm() < cx.thresholds.strict_walk_speed_m_s
}

/// The centre of mass rises or sinks faster than anybody climbs. A robot that drops off a ladder and lands on both feet
/// has not climbed down.
pub fn leaps(row: &Row, cx: &Context<'_>) -> bool {
    row.com_velocity.z.abs() > cx.thresholds.strict_leap_m_s
}

/// Two bodies of one hand press on the bulb from different sides, nothing but this hand touches it, and it moves with the
/// palm.
pub fn in_grip(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    let stray = cx.thresholds.strict_stray_n;
    if row.load(errand::OTHER_FORCE_PEAK[bulb as usize])[0] > stray {
        return false;
    }
    let [right, left] = row.hands(bulb);
    let peaks = row.load(errand::HAND_FORCE_PEAK[bulb as usize]).split_at(right.len());
    // Rows list the left palm first, but the right hand first.
    [(right, peaks.1, 1), (left, peaks.0, 0)].into_iter().any(|(hand, of_other_hand, palm)| {
        of_other_hand.iter().all(|peak| *peak <= stray)
            && cx.grip_speeds[bulb as usize][palm] < cx.thresholds.strict_slip_m_s
            && pressed_from_two_sides(hand, cx)
    })
}

fn pressed_from_two_sides(hand: &[nalgebra::Vector3<f64>], cx: &Context<'_>) -> bool {
    let pressing = || hand.iter().filter(|force| force.norm() > cx.thresholds.touch_n);
    let opposed = |a, b| measure::angle_between(a, b) > cx.thresholds.strict_grip_angle_rad;
    pressing().enumerate().any(|(i, a)| pressing().skip(i + 1).any(|b| opposed(a, b)))
}
