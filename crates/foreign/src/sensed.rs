use fiatlux_wbc::{Sensed, first_unsound};

use crate::{BODY, ForeignError};

/// Refuses an observation that lacks a term of the controllers, or has one that is not finite.
pub(crate) fn check(controller: &'static str, sensed: &Sensed<'_>) -> Result<(), ForeignError> {
    let terms: [(&'static str, &[f64], usize); 4] = [
        ("base_angular_velocity", &sensed.base_angular_velocity, 3),
        ("projected_gravity", &sensed.projected_gravity, 3),
        ("joint_position", sensed.joint_position, BODY),
        ("joint_velocity", sensed.joint_velocity, BODY),
    ];
    match first_unsound(&terms) {
        Some((term, problem)) => Err(ForeignError::Sensed { controller, term, problem }),
        None => Ok(()),
    }
}

/// The session's posture minus the controller's, rad.
pub(crate) fn offset(
    controller: &'static str,
    q0: &[f64],
    default_angle: impl Fn(usize) -> f64,
) -> Result<[f64; BODY], ForeignError> {
    let q0 = q0.get(..BODY).filter(|q0| q0.iter().all(|angle| angle.is_finite()));
    let q0 = q0.ok_or(ForeignError::Sensed { controller, term: "q0 of 29 joints", problem: "the session lacks" })?;
    Ok(std::array::from_fn(|joint| q0[joint] - default_angle(joint)))
}
