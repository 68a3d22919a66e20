//! Gestures of two tracked hands, in the place of buttons and sticks.
//!
//! Thumb and index finger of a hand held together are a clutch: the other hand, and its fingers, are followed. Thumb and middle
//! finger held together are a stick, which begins at rest where the two met. A hand that is followed makes no gestures.

use nalgebra::Vector3;

use crate::tracked::TrackedHand;

/// Distances of two tips that meet, and that part, m.
const MEET: f64 = 0.02;
const PART: f64 = 0.04;
/// Way of a hand to the stop of its stick, m.
const STICK: f64 = 0.12;
/// A stick that moves farther between two messages has lost its tracking, m.
const MAX_JUMP_M: f64 = 0.2;

/// A gesture that lasts.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Gesture {
    Clutch,
    Stick {
        /// Where it began, and where it was last.
        start: Vector3<f64>,
        last: Vector3<f64>,
    },
    /// The fingers of this pinch still touch, and mean nothing.
    Over(usize),
}

impl Gesture {
    /// The finger that touches the thumb, as an index into [`TrackedHand::tips`].
    fn pinch(self) -> usize {
        match self {
            Self::Clutch => 0,
            Self::Stick { .. } => 1,
            Self::Over(pinch) => pinch,
        }
    }
}

/// Place of a hand, x forwards, y left, z up, and its fingers.
pub(crate) type Seen = (Vector3<f64>, TrackedHand);

/// Gestures of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Doing {
    /// The robot's hand repeats its motion.
    pub is_followed: bool,
    /// Its stick: forwards, left, up, from -1 to 1.
    pub stick: Option<[f64; 3]>,
}

/// Gestures of both hands, left first.
#[derive(Debug, Default)]
pub(crate) struct Gestures {
    gestures: [Option<Gesture>; 2],
    were_followed: [bool; 2],
}

impl Gestures {
    /// Takes in both hands of a message; `None` where one is not tracked. `has_moved` is true if places before cannot be compared.
    pub fn step(&mut self, hands: &[Option<Seen>; 2], has_moved: bool) -> [Doing; 2] {
        for side in 0..2 {
            self.gestures[side] = match (self.gestures[side], &hands[side]) {
                (Some(gesture), Some((at, hand))) if hand.tips[gesture.pinch()] < PART => Some(match gesture {
                    Gesture::Stick { start, last } if !has_moved && (at - last).norm() < MAX_JUMP_M => {
                        Gesture::Stick { start, last: *at }
                    }
                    Gesture::Stick { .. } => Gesture::Over(gesture.pinch()),
                    gesture => gesture,
                }),
                _ => None,
            };
        }
        for side in 0..2 {
            let Some((at, hand)) = &hands[side] else { continue };
            if self.gestures[side].is_some() || self.is_followed(side) {
                continue;
            }
            let pinch = if hand.tips[0] <= hand.tips[1] { 0 } else { 1 };
            if hand.tips[pinch] < MEET && !hand.is_fist {
                self.gestures[side] = Some(match pinch {
                    _ if self.were_followed[side] => Gesture::Over(pinch),
                    0 => Gesture::Clutch,
                    _ => Gesture::Stick { start: *at, last: *at },
                });
            }
        }
        let doing = [0, 1].map(|side| Doing {
            is_followed: hands[side].is_some() && self.is_followed(side),
            stick: match self.gestures[side] {
                Some(Gesture::Stick { start, last }) => {
                    Some(((last - start) / STICK).map(|share| share.clamp(-1.0, 1.0)).into())
                }
                _ => None,
            },
        });
        self.were_followed = doing.map(|hand| hand.is_followed);
        doing
    }

    fn is_followed(&self, side: usize) -> bool {
        self.gestures[side].is_none() && self.gestures[1 - side] == Some(Gesture::Clutch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Bends;

    const OPEN: [f64; 2] = [0.09, 0.11];
    const INDEX: [f64; 2] = [0.01, 0.05];
    const MIDDLE: [f64; 2] = [0.05, 0.01];

    fn seen(at: [f64; 3], tips: [f64; 2]) -> Option<Seen> {
        Some((at.into(), TrackedHand { bends: Bends::default(), tips, is_fist: false }))
    }

    fn followed(doing: [Doing; 2]) -> [bool; 2] {
        doing.map(|hand| hand.is_followed)
    }

    #[test]
    fn a_hand_is_followed_while_the_other_one_pinches() {
        let mut gestures = Gestures::default();
        let at = [0.0, 0.0, 1.0];
        assert_eq!(followed(gestures.step(&[seen(at, OPEN), seen(at, OPEN)], false)), [false, false]);
        assert_eq!(followed(gestures.step(&[seen(at, INDEX), seen(at, OPEN)], false)), [false, true]);
        // Whatever the fingers of the hand that is followed do, they are its own.
        assert_eq!(followed(gestures.step(&[seen(at, INDEX), seen(at, INDEX)], false)), [false, true]);
        assert_eq!(followed(gestures.step(&[seen(at, [0.03, 0.05]), seen(at, MIDDLE)], false)), [false, true]);
        let doing = gestures.step(&[seen(at, OPEN), seen(at, MIDDLE)], false);
        assert_eq!(doing, [Doing::default(); 2], "a pinch that is left over is none");
        gestures.step(&[seen(at, OPEN), seen(at, OPEN)], false);
        assert!(gestures.step(&[seen(at, OPEN), seen(at, MIDDLE)], false)[1].stick.is_some());
    }

    #[test]
    fn a_hand_that_is_lost_neither_follows_nor_holds() {
        let mut gestures = Gestures::default();
        let at = [0.0, 0.0, 1.0];
        gestures.step(&[seen(at, INDEX), seen(at, OPEN)], false);
        assert_eq!(followed(gestures.step(&[seen(at, INDEX), None], false)), [false, false]);
        assert_eq!(followed(gestures.step(&[None, seen(at, OPEN)], false)), [false, false]);
    }

    #[test]
    fn a_stick_begins_at_rest_and_ends_at_a_jump() {
        let mut gestures = Gestures::default();
        let stick = |gestures: &mut Gestures, at, tips, moved| gestures.step(&[seen(at, tips), None], moved)[0].stick;
        assert_eq!(stick(&mut gestures, [0.3, 0.2, 1.0], MIDDLE, false), Some([0.0; 3]));
        let [forwards, left, up] = stick(&mut gestures, [0.36, 0.05, 1.0], MIDDLE, false).expect("a stick");
        assert!((forwards - 0.5).abs() < 1e-9 && left == -1.0 && up == 0.0, "{forwards} {left} {up}");
        assert_eq!(stick(&mut gestures, [0.8, 0.05, 1.0], MIDDLE, false), None, "it jumped");
        assert_eq!(stick(&mut gestures, [0.8, 0.05, 1.0], MIDDLE, false), None);
        assert_eq!(stick(&mut gestures, [0.8, 0.05, 1.0], OPEN, false), None);
        assert_eq!(stick(&mut gestures, [0.8, 0.05, 1.0], MIDDLE, false), Some([0.0; 3]));
        assert_eq!(stick(&mut gestures, [0.8, 0.05, 1.0], MIDDLE, true), None, "its space moved");
    }

    #[test]
    fn a_fist_is_no_gesture() {
        let mut gestures = Gestures::default();
        let fist = TrackedHand { bends: Bends::default(), tips: [0.01, 0.01], is_fist: true };
        let hands = [Some((Vector3::zeros(), fist)), seen([0.0; 3], OPEN)];
        assert_eq!(gestures.step(&hands, false), [Doing::default(); 2]);
    }
}
