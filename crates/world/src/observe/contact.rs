//! What the robot feels of bulbs and ladder.

use fiatlux_robot::Robot;
use fiatlux_rules::{Bulb, LIMBS, Limb, Row};
use nalgebra::Vector3;

use super::foot_force_estimate;

/// Force of both bulbs together on each sensed hand body, right hand first, world axes, N.
pub fn hand_force(row: &Row) -> Vec<Vector3<f64>> {
    let [old, fresh] = Bulb::ALL.map(|bulb| &row.hand_force[bulb as usize]);
    old.iter().zip(fresh).map(|(old, fresh)| old + fresh).collect()
}

/// Force of the ladder on each limb as a policy sees it, by [`Limb`], world axes, N: on the feet as the ankles' torques
/// tell it, on the palms as their contacts do.
pub fn limb_force(robot: &Robot, row: &Row) -> [Vector3<f64>; LIMBS] {
    let [left, right] = foot_force_estimate(robot, row);
    let [left_palm, right_palm] = [Limb::LeftPalm, Limb::RightPalm].map(|limb| row.ladder_force[limb as usize]);
    [left, right, left_palm, right_palm]
}
