//! The numbers of an action.

/// Radians of joint target per unit of action: target = q0 + 0.5 action.
pub const ACTION_SCALE: f64 = 0.5;

/// Largest size of a number of an action, in action units: far beyond any joint's range, and small enough that the control
/// effort and every reward stay finite.
pub const ACTION_LIMIT: f64 = 1e3;
