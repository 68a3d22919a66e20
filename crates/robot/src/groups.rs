//! Counts of joints in the public joint order, which begins alike in every robot: legs, waist, arms. Fingers follow.

/// Joints of both legs, which come first.
pub const LEGS: usize = 12;
/// Joints of legs and waist, which a whole-body controller moves.
pub const MOVED: usize = 15;
/// Joints of both arms, which come next.
pub const ARMS: usize = 14;
/// Joints of the body: legs, waist and arms.
pub const BODY: usize = MOVED + ARMS;
