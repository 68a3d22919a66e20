//! When a state has left what a robot in a room can reach: the simulation has failed, and nothing in the row can be judged.
//!
//! A session cannot choose these bounds, as it can choose thresholds: an episode that diverges is always a failure.

use crate::errand::manifest;
use crate::manifest::Thing;
use crate::parts::BodyRow;
use crate::row::Row;

/// Speed of a joint with a rated speed, rad/s. Motors are rated at 20 to 37 rad/s; impacts drive joints to a few times that.
const RATED_JOINT_SPEED: f64 = 200.0;
/// Speed of any joint, rad/s. Fingers have no rated speed: a sole at 10 m/s drives a phalanx of 3 cm at 330 rad/s.
const JOINT_SPEED: f64 = 1000.0;
/// Speed of pelvis and ladder, and of any thing that the socket cannot hold, m/s; a fall from the ceiling ends at 7 m/s.
const BODY_SPEED: f64 = 20.0;
/// Speed of a bulb, m/s: it has 35 g, and a foot may strike it at 14 m/s.
const BULB_SPEED: f64 = 100.0;

/// All bounds, for the digest of the rules.
pub(crate) const BOUNDS: [f64; 4] = [RATED_JOINT_SPEED, JOINT_SPEED, BODY_SPEED, BULB_SPEED];

/// True if a row has diverged: a speed is implausible, or a number of its state is not finite.
pub fn diverged(row: &Row) -> bool {
    let limit = |thing: &Thing| if thing.socket { BULB_SPEED } else { BODY_SPEED };
    let things = manifest().things.iter().map(limit).zip(&row.things);
    let mut bodies = [(BODY_SPEED, &row.robot)].into_iter().chain(things);
    // NaN is within no bound.
    let plausible = row.joint_speed_peak <= RATED_JOINT_SPEED
        && all(&row.joint_velocity, |speed| speed.abs() <= JOINT_SPEED)
        && all(&row.joint_position, f64::is_finite)
        && bodies.all(|(most, body)| body.linear_velocity.norm() <= most && is_finite(body));
    !plausible
}

fn is_finite(body: &BodyRow) -> bool {
    let BodyRow { pose, angular_velocity, .. } = body;
    [pose.translation.vector.as_slice(), pose.rotation.coords.as_slice(), angular_velocity.as_slice()]
        .iter()
        .all(|numbers| all(numbers, f64::is_finite))
}

/// Looks at every number, which is faster than to stop at the first: nearly always all hold.
fn all(numbers: &[f64], holds: impl Fn(f64) -> bool) -> bool {
    numbers.iter().fold(true, |all, number| all & holds(*number))
}
