//! The predicates of gates and terminations. Figures and their sources are in [`Thresholds`](crate::Thresholds).
//!
//! A comparison with NaN is false on both sides: such a robot neither stands nor has fallen.

use nalgebra::Vector3;

use crate::context::Context;
use crate::errand;
use crate::measure::{self, Extent};
use crate::parts::Bulb;
use crate::row::Row;

// ---------------------------------------------------------------- Robot

/// The pelvis is high and upright enough.
pub fn standing(row: &Row, cx: &Context<'_>) -> bool {
    let pose = &row.robot.pose;
    pose.translation.vector.z > cx.thresholds.fall_height_m && measure::tilt(pose) < cx.thresholds.fall_tilt_rad
}

/// The pelvis is too low or too tilted.
pub fn fallen(row: &Row, cx: &Context<'_>) -> bool {
    let pose = &row.robot.pose;
    pose.translation.vector.z < cx.thresholds.fall_height_m || measure::tilt(pose) > cx.thresholds.fall_tilt_rad
}

/// The pelvis moves slower than walking speed.
pub fn walks_slowly(row: &Row, cx: &Context<'_>) -> bool {
    row.robot.linear_velocity.norm() < cx.thresholds.walk_speed_m_s
}

/// The robot heads for a point.
pub fn faces(row: &Row, cx: &Context<'_>, target: &Vector3<f64>) -> bool {
    measure::facing_angle(&row.robot.pose, target).abs() < cx.thresholds.facing_rad
}

/// Horizontal distance of the pelvis from a point, m.
pub fn robot_distance(row: &Row, target: &Vector3<f64>) -> f64 {
    measure::horizontal_distance(&row.robot.pose.translation.vector, target)
}

/// The pelvis is near or above the height of the ladder's top point, close to it and not passing by. The second tread
/// is high enough.
pub fn at_ladder_top(row: &Row, cx: &Context<'_>) -> bool {
    let top = cx.geometry.ladder_top(row);
    row.robot.pose.translation.vector.z >= top.z - cx.thresholds.top_slack_m
        && robot_distance(row, &top) < cx.thresholds.ladder_near_m
        && row.robot.linear_velocity.norm() < cx.thresholds.climb_speed_m_s
}

/// The pelvis is as low as on the floor, close to the ladder and not passing by.
pub fn at_ladder_foot(row: &Row, cx: &Context<'_>) -> bool {
    row.robot.pose.translation.vector.z < cx.thresholds.floor_stance_m
        && robot_distance(row, &row.body(errand::LADDER).pose.translation.vector) < cx.thresholds.ladder_near_m
        && row.robot.linear_velocity.norm() < cx.thresholds.climb_speed_m_s
}

/// The pelvis is where a robot on the platform has it.
pub fn at_working_height(row: &Row, cx: &Context<'_>) -> bool {
    row.robot.pose.translation.vector.z > cx.thresholds.working_height_m
}

// ---------------------------------------------------------------- Ladder

/// The ladder stands on its feet, or nearly so.
pub fn ladder_upright(row: &Row, cx: &Context<'_>) -> bool {
    measure::tilt(&row.body(errand::LADDER).pose) < cx.thresholds.ladder_tip_rad
}

/// The ladder leans too far.
pub fn ladder_tipped(row: &Row, cx: &Context<'_>) -> bool {
    measure::tilt(&row.body(errand::LADDER).pose) > cx.thresholds.ladder_tip_rad
}

/// The ladder's top point is close to the fixture horizontally, and the ladder upright.
pub fn ladder_placed(row: &Row, cx: &Context<'_>) -> bool {
    let distance =
        measure::horizontal_distance(&cx.geometry.ladder_top(row), &row.body(errand::FIXTURE).pose.translation.vector);
    distance < cx.thresholds.placement_m && ladder_upright(row, cx)
}

/// All four feet are on the floor.
pub fn ladder_feet_down(row: &Row, cx: &Context<'_>) -> bool {
    cx.geometry.ladder_feet(row).iter().all(|height| height.abs() < cx.thresholds.feet_height_m)
}

/// The ladder does not move.
pub fn ladder_at_rest(row: &Row, cx: &Context<'_>) -> bool {
    row.body(errand::LADDER).linear_velocity.norm() < cx.thresholds.rest_speed_m_s
        && row.body(errand::LADDER).angular_velocity.norm() < cx.thresholds.rest_turn_rad_s
}

// ---------------------------------------------------------------- Bulbs and hands

/// A body of either hand feels the bulb.
pub fn held(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    measure::largest_norm(row.force(errand::HAND_FORCE[bulb as usize])) > cx.thresholds.touch_n
}

/// No body of either hand feels the bulb.
pub fn released(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    row.force(errand::HAND_FORCE[bulb as usize]).iter().all(|force| force.norm() < cx.thresholds.touch_n)
}

/// Several bodies of one hand feel the bulb.
pub fn gripped(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    row.hands(bulb).into_iter().any(|hand| {
        let touching = hand.iter().filter(|force| force.norm() > cx.thresholds.touch_n).count();
        touching >= cx.thresholds.grip_bodies as usize
    })
}

/// No body of either hand is pressed hard enough to break the bulb.
pub fn handled_gently(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    row.force(errand::HAND_FORCE[bulb as usize]).iter().all(|force| force.norm() <= cx.thresholds.fragility_n)
}

/// A body of either hand is pressed hard enough to break the bulb.
pub fn crushed(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    measure::largest_norm(row.force(errand::HAND_FORCE[bulb as usize])) > cx.thresholds.fragility_n
}

/// The socket holds the bulb.
pub fn seated(row: &Row, bulb: Bulb) -> bool {
    row.attachments[bulb as usize].seated
}

/// The socket has let go of the bulb, and its plug is clear of the seat.
pub fn removed(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    !seated(row, bulb) && cx.geometry.plug_distance(row, bulb) > cx.thresholds.clear_of_seat_m
}

/// The bulb's pose stands still, by its low-passed speeds.
pub fn settled(cx: &Context<'_>, bulb: Bulb) -> bool {
    let speed = cx.bulb_speed(bulb);
    speed.linear < cx.thresholds.rest_speed_m_s && speed.angular < cx.thresholds.rest_turn_rad_s
}

/// The bulb's root is above its drop height.
pub fn elevated(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    row.body(bulb.thing()).pose.translation.vector.z > cx.drop_height(bulb)
}

/// The bulb's lowest point is above the bench.
pub fn lifted(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    let lowest = cx.geometry.lowest_point(row, bulb);
    lowest.is_finite() && lowest > cx.geometry.bench_surface + cx.thresholds.lift_m
}

/// The whole bulb is within the middle of the crate's walls, seen from above: it leans on none of their tops. A bulb that strikes a
/// wall may be some millimetres deep in it for a moment, and is dropped no more for that than one that lies there.
pub fn between_crate_walls(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    let (inner, outer) = (cx.geometry.crate_interior_half, cx.geometry.crate_outer_half);
    let middle = inner.into_iter().zip(outer).map(|(inner, outer)| 0.5 * (inner + outer));
    cx.geometry.extents_in_crate(row, bulb).iter().zip(middle).all(|(extent, middle)| extent.reach() < middle)
}

/// The whole bulb is inside the crate: within its walls and below its rim.
pub fn in_crate(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    let extents = cx.geometry.extents_in_crate(row, bulb);
    let top = extents[2].max;
    is_between_walls(&extents, cx) && top.is_finite() && top < cx.geometry.crate_rim
}

fn is_between_walls(extents_in_crate: &[Extent; 3], cx: &Context<'_>) -> bool {
    let half = cx.geometry.crate_interior_half;
    extents_in_crate.iter().zip(half).all(|(extent, half)| extent.reach() < half + cx.thresholds.crate_slack_m)
}

/// The bulb's root is below its drop height. The socket does not drop it, and the old bulb may go into the crate.
///
/// For that, its place above the crate's floor is enough. A bulb that is put down between the walls passes its drop
/// height before the whole of it is below the rim.
pub fn dropped(row: &Row, cx: &Context<'_>, bulb: Bulb) -> bool {
    let low = row.body(bulb.thing()).pose.translation.vector.z < cx.drop_height(bulb);
    low && !seated(row, bulb) && !(bulb == Bulb::Old && between_crate_walls(row, cx, bulb))
}
