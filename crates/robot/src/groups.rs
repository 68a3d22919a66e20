//! Counts of joints in the public joint order, which begins alike in every robot: legs, waist, arms. Fingers follow.

/// Joints of both legs, which come first.
pub const LEGS: usize = 12;
/// Joints of legs and waist, which a whole-body controller moves.
pub const MOVED: usize = 15;
/// Joints of both arms, which come next.
pub const ARMS: usize = 14;
/// Joints of the body: legs, waist and arms.
pub const BODY: usize = MOVED + ARMS;

/// Signs of a leg's joints, of the waist's and of an arm's under reflection at the robot's median plane: turns about the
/// lateral axis stay, the others change.
const LEG: [f64; LEGS / 2] = [1.0, -1.0, -1.0, 1.0, 1.0, -1.0];
const WAIST: [f64; MOVED - LEGS] = [-1.0, -1.0, 1.0];
const ARM: [f64; ARMS / 2] = [1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0];

/// The joint from which a joint of the body has its angle in the mirror image of a posture, and the sign that the angle takes.
///
/// # Panics
/// For a joint that is not of the body, from [`BODY`] on.
pub const fn mirrored(joint: usize) -> (usize, f64) {
    match joint {
        0..LEGS => ((joint + LEGS / 2) % LEGS, LEG[joint % (LEGS / 2)]),
        LEGS..MOVED => (joint, WAIST[joint - LEGS]),
        _ => {
            assert!(joint < BODY, "not a joint of the body");
            let arm = joint - MOVED;
            (MOVED + (arm + ARMS / 2) % ARMS, ARM[arm % (ARMS / 2)])
        }
    }
}
