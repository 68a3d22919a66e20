//! Climbing, one foot after the other, so slowly that the robot stands still at every moment.
//!
//! A [`Planner`] moves the weight over one foot and then the other foot to its next [`Foothold`], as postures that keep
//! shapes apart. A [`Plan`] is a list of such postures, a [`Player`] balances the robot along it. The plans of the step
//! ladder are made by `cargo run -p fiatlux-climb --example plan`.

mod approach;
mod armed;
mod body;
mod network;
mod plan;
mod planner;
mod player;
mod raised;
mod reference;
mod tracker;

pub use approach::{approach, stand};
pub use armed::armed;
pub use body::Body;
pub use network::{Contract, Follower, Network, NetworkError};
pub use plan::{Keyframe, Plan, PlanError};
pub use planner::{Apart, Arm, Foothold, Places, Planner};
pub use player::Player;
pub use raised::raised;
pub use reference::{Pose, Reference};
pub use tracker::{ACTION_CLAMP, OBSERVATION, OBSERVED, Tracker, TrackerMemory};

/// The file of the plan.
const LADDER: &str = include_str!("ladder.txt");

/// The plan of the step ladder, from the floor before it to its platform, backwards.
///
/// # Errors
/// None, unless the file that comes with this version is broken.
pub fn ladder() -> Result<Plan, PlanError> {
    Plan::read(LADDER)
}

/// The plan from the platform of the step ladder to the floor before it, facing the ladder. It begins with the arms drawn back, clear of guard
/// rail and lamp also where the ladder stands a few centimetres too near.
///
/// # Errors
/// None, unless the file that comes with this version is broken.
pub fn descent() -> Result<Plan, PlanError> {
    Ok(Plan::read(include_str!("descent.txt"))?.reversed())
}

/// The same as [`ladder`], with the right wrist turned as it holds a bulb.
///
/// # Errors
/// None, unless the file that comes with this version is broken.
pub fn ladder_with_bulb() -> Result<Plan, PlanError> {
    Ok(with_bulb(ladder()?))
}

/// The plan on the platform of the step ladder, from where [`ladder`] ends, its back to the guard rail, to where the robot faces what is
/// behind the rail and its toes point there.
///
/// # Errors
/// None, unless the file that comes with this version is broken.
pub fn turn() -> Result<Plan, PlanError> {
    Plan::read(include_str!("turn.txt"))
}

/// The same as [`turn`], with the right hand as it holds a bulb.
///
/// # Errors
/// None, unless the file that comes with this version is broken.
pub fn turn_with_bulb() -> Result<Plan, PlanError> {
    Ok(with_bulb(turn()?))
}

/// Roll of the right wrist in a robot's joints, and its angle with which a bulb in the hand starts, rad.
const WRIST_ROLL: (usize, f64) = (26, 1.57);

/// Pitch of the right shoulder, and how much farther back it is with a bulb in the hand, so that the bulb passes the treads, rad.
const SHOULDER_PITCH: (usize, f64) = (22, 0.07);

/// A descent, with the right wrist turned as it holds a bulb, and the shoulder farther back.
#[must_use]
pub fn lowering_bulb(descent: Plan) -> Plan {
    let mut plan = with_bulb(descent);
    plan.keyframes.iter_mut().for_each(|key| key.angles[SHOULDER_PITCH.0] += SHOULDER_PITCH.1);
    plan
}

fn with_bulb(mut plan: Plan) -> Plan {
    plan.keyframes.iter_mut().for_each(|key| key.angles[WRIST_ROLL.0] = WRIST_ROLL.1);
    plan
}
