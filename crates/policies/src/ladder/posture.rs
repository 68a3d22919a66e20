//! Postures for a ladder's height.

use fiatlux_room::ladder;

/// Height of the pelvis, m, and roll and pitch of the torso, rad.
pub(super) type Posture = (f64, [f64; 2]);

/// On the way to the ladder.
pub(super) const UPRIGHT: Posture = (0.74, [0.0, 0.0]);
/// Height of the platform's underside as published, m, and the postures for it: bent, below the platform without touching it, and
/// with the ladder.
pub(super) const PLATFORM_Z: f64 = ladder::PLATFORM_HEIGHT - ladder::PLATFORM_THICKNESS;
const BENT: Posture = (0.65, [0.0, 0.5]);
const LOW: Posture = (0.57, [0.0, 0.0]);
const CARRYING: Posture = (0.70, [0.0, 0.0]);
/// Heights at which the network stands and walks, m.
const STANDS: [f64; 2] = [0.55, 0.79];
const WALKS: [f64; 2] = [0.65, 0.79];
/// Roll and pitch more for each metre that the platform is lower, rad/m, and the largest that the network walks with, rad: it does
/// not walk with a pelvis lower than [`BENT`].
const STOOP: [f64; 2] = [6.0, 5.0];
const MAX_STOOP: [f64; 2] = [0.3, 0.6];
/// Additional height at which it carries a ladder whose platform is a metre higher, m/m: the guard rail must pass the lamp.
const RAISES: f64 = 0.5;
/// Part of the height from which on a ladder is not the published one.
const OTHER_HEIGHT: f64 = 1e-3;

/// Postures for one ladder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Postures {
    /// Height of the platform's underside, m.
    pub platform: f64,
    pub bent: Posture,
    pub low: Posture,
    pub carrying: Posture,
}

impl Postures {
    /// For a ladder so many times as high as the published one.
    pub fn new(height: f64) -> Self {
        let height = if (height - 1.0).abs() < OTHER_HEIGHT { 1.0 } else { height };
        let platform = PLATFORM_Z * height;
        let rise = platform - PLATFORM_Z;
        let within = |height: f64, [least, most]: [f64; 2]| height.clamp(least, most);
        let stoop = |axis: usize| (BENT.1[axis] + STOOP[axis] * (-rise).max(0.0)).min(MAX_STOOP[axis]);
        Self {
            platform,
            bent: (within(BENT.0 + rise, WALKS), [stoop(0), stoop(1)]),
            low: (within(LOW.0 + rise, STANDS), LOW.1),
            carrying: (within(CARRYING.0 + rise.min(RAISES * rise), WALKS), CARRYING.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_height_changes_nothing() {
        let published = Postures { platform: PLATFORM_Z, bent: BENT, low: LOW, carrying: CARRYING };
        assert_eq!(Postures::new(1.0 + 1e-9), published);
    }

    /// At the published height, the head meets the platform with the pelvis at 0.63 m: the robot gets 2 cm below that, and lifts the
    /// ladder by 4 cm.
    #[test]
    fn other_heights_are_lifted() {
        for height in [0.95, 0.98, 1.02, 1.05] {
            let Postures { platform, bent, low, carrying } = Postures::new(height);
            let meets = 0.63 + platform - PLATFORM_Z;
            assert!(low.0 < meets - 0.02 && carrying.0 > meets + 0.04, "{height}: {low:?} {carrying:?}");
            assert!(bent.1[0] <= MAX_STOOP[0] && bent.1[1] <= MAX_STOOP[1], "{height}: {bent:?}");
        }
    }
}
