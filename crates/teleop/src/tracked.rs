//! A tracked hand: the bends of its fingers and its pinches, from the places of its joints.

use nalgebra::Vector3;

use crate::frame::Bends;

/// Joints of a hand in the order of the WebXR Hand Input: the wrist, four of the thumb, five of each finger, from its root to its tip.
pub(crate) const JOINTS: usize = 25;
/// Bends of a straight and of a bent finger, rad: the first joint, and those beyond it together. First the thumb, then the others.
const KNUCKLE: [[f64; 2]; 2] = [[0.15, 0.9], [0.1, 1.3]];
const MIDDLE: [[f64; 2]; 2] = [[0.15, 1.2], [0.35, 2.4]];
/// Tip of the thumb beside the hand and across the palm: from the index knuckle towards the little finger's, in widths of the palm.
const ACROSS: [f64; 2] = [-0.9, 0.4];
/// Distances of two tips that are apart and that touch, m.
const PINCH: [f64; 2] = [0.05, 0.02];
/// A finger bent farther than the first of these does not pinch, as in a fist; one bent less than the second one does.
const CURLED: [f64; 2] = [0.8, 0.5];
/// Shortest part of a finger, m.
const MIN_LENGTH: f64 = 1e-3;

/// A hand as an operator has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TrackedHand {
    pub bends: Bends,
    /// From the tip of the thumb to those of index and middle finger, m.
    pub tips: [f64; 2],
    /// Ring and little finger are closed.
    pub is_fist: bool,
}

/// Share of the way from one number to another one.
fn share(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

impl TrackedHand {
    /// The left hand is side 0. `None` for joints that are no hand, such as two of them in one place.
    pub fn new(side: usize, joints: &[Vector3<f64>; JOINTS]) -> Option<Self> {
        let way = |from: usize, to: usize| joints[to] - joints[from];
        let direction = |from: usize, to: usize| way(from, to).try_normalize(MIN_LENGTH);
        let between = |a: Vector3<f64>, b: Vector3<f64>| a.dot(&b).clamp(-1.0, 1.0).acos();
        // Roots of the thumb and of the others, and their knuckles.
        let [index, little] = [6, 21];
        let outwards = way(0, index).cross(&way(0, little)).try_normalize(MIN_LENGTH * MIN_LENGTH)?;
        let palm = if side == 0 { -outwards } else { outwards };
        let (sideways, width) = (direction(index, little)?, way(index, little).norm());

        let mut bends = Bends { across: share(way(index, 4).dot(&sideways) / width, ACROSS), ..Bends::default() };
        let [first, second, third] = [direction(1, 2)?, direction(2, 3)?, direction(3, 4)?];
        bends.knuckles[0] = share(between(first, second), KNUCKLE[0]);
        bends.middles[0] = share(between(second, third), MIDDLE[0]);
        for finger in 1..5 {
            let root = 5 * finger;
            let along = direction(root, root + 1)?;
            let parts =
                [direction(root + 1, root + 2)?, direction(root + 2, root + 3)?, direction(root + 3, root + 4)?];
            // Fingers that are spread, or bent back, are not bent.
            let knuckle = parts[0].dot(&palm).atan2(parts[0].dot(&along));
            bends.knuckles[finger] = share(knuckle, KNUCKLE[1]);
            bends.middles[finger] = share(between(parts[0], parts[1]) + between(parts[1], parts[2]), MIDDLE[1]);
        }
        let tips = [9, 14].map(|tip| way(4, tip).norm());
        bends.pinches = [0, 1].map(|pinch: usize| share(tips[pinch], PINCH) * share(bends.middles[1 + pinch], CURLED));
        let is_fist = (bends.middles[3] + bends.middles[4]) / 2.0 > 0.5;
        Some(Self { bends, tips, is_fist })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A right hand, wrist at the origin, fingers along -z, back up, with a knuckle and further joints bent (rad) of each finger, the
    /// thumb first; the thumb is turned from beside the hand to across the palm by a share. The left hand is its mirror image.
    pub fn joints(side: usize, across: f64, bent: [[f64; 2]; 5]) -> [Vector3<f64>; JOINTS] {
        let mut joints = [Vector3::zeros(); JOINTS];
        // The thumb bends in the plane that it lies in.
        let out = Vector3::new(-0.8 + 0.8 * across, -0.6 * across, -0.6).normalize();
        let towards = Vector3::new(0.3 + 0.7 * across, 0.0, -1.0 + across).normalize();
        let towards = (towards - out * out.dot(&towards)).normalize();
        chain(
            &mut joints[1..5],
            Vector3::new(-0.02, -0.01, -0.03),
            out,
            towards,
            &[0.035, 0.03, 0.025],
            [0.0, bent[0][0], bent[0][1]],
        );
        for finger in 1..5 {
            let root = Vector3::new(-0.03 + 0.02 * (finger - 1) as f64, 0.0, -0.03);
            let [knuckle, middle] = bent[finger];
            let (along, down) = (-Vector3::z(), -Vector3::y());
            let place = &mut joints[5 * finger..5 * finger + 5];
            let lengths = [0.06, 0.04, 0.025, 0.022];
            place[0] = root;
            place[1] = root + along * lengths[0];
            let mut angle = 0.0;
            for (part, bend) in [knuckle, middle / 2.0, middle / 2.0].into_iter().enumerate() {
                angle += bend;
                place[part + 2] =
                    place[part + 1] + (along * f64::cos(angle) + down * f64::sin(angle)) * lengths[part + 1];
            }
        }
        if side == 0 {
            joints.iter_mut().for_each(|joint| joint.x = -joint.x);
        }
        joints
    }

    fn chain(
        place: &mut [Vector3<f64>],
        root: Vector3<f64>,
        out: Vector3<f64>,
        towards: Vector3<f64>,
        lengths: &[f64; 3],
        bends: [f64; 3],
    ) {
        place[0] = root;
        let mut angle: f64 = 0.0;
        for part in 0..3 {
            angle += bends[part];
            place[part + 1] = place[part] + (out * angle.cos() + towards * angle.sin()) * lengths[part];
        }
    }

    pub const OPEN: [[f64; 2]; 5] = [[0.0; 2]; 5];
    pub const FIST: [[f64; 2]; 5] = [[0.9, 1.2], [1.4, 2.6], [1.4, 2.6], [1.4, 2.6], [1.4, 2.6]];

    #[test]
    fn an_open_hand_is_straight_and_a_fist_bent_on_both_sides() {
        for side in 0..2 {
            let open = TrackedHand::new(side, &joints(side, 0.0, OPEN)).expect("a hand");
            assert_eq!((open.bends, open.is_fist), (Bends::default(), false), "side {side}");
            let fist = TrackedHand::new(side, &joints(side, 1.0, FIST)).expect("a hand");
            let all = Bends { across: fist.bends.across, knuckles: [1.0; 5], middles: [1.0; 5], pinches: [0.0; 2] };
            assert_eq!((fist.bends, fist.is_fist), (all, true), "side {side}");
            assert!(fist.bends.across > 0.6, "{}", fist.bends.across);
        }
    }

    /// Neither where the hand is nor how it is turned makes a difference.
    #[test]
    fn one_finger_bends_alone_wherever_the_hand_is() {
        let away = nalgebra::Isometry3::new(Vector3::new(3.0, -1.0, 0.5), Vector3::new(0.4, 2.0, -1.0));
        for finger in 0..5 {
            let mut bent = OPEN;
            bent[finger] = FIST[finger];
            let joints = joints(1, 0.0, bent).map(|joint| (away * nalgebra::Point3::from(joint)).coords);
            let Bends { knuckles, middles, .. } = TrackedHand::new(1, &joints).expect("a hand").bends;
            for other in 0..5 {
                let wanted = f64::from(u8::from(other == finger));
                assert!((knuckles[other] - wanted).abs() < 1e-6, "finger {finger}: {knuckles:?}");
                assert!((middles[other] - wanted).abs() < 1e-6, "finger {finger}: {middles:?}");
            }
        }
    }

    #[test]
    fn fingers_bent_back_are_straight() {
        let back = [[0.0, 0.0], [-0.4, 0.0], [-0.4, 0.0], [-0.4, 0.0], [-0.4, 0.0]];
        let hand = TrackedHand::new(0, &joints(0, 0.0, back)).expect("a hand");
        assert_eq!(hand.bends.knuckles, [0.0; 5]);
    }

    #[test]
    fn joints_in_one_place_are_no_hand() {
        assert_eq!(TrackedHand::new(0, &[Vector3::zeros(); JOINTS]), None);
        let mut joints = joints(0, 0.0, OPEN);
        joints[8] = joints[7];
        assert_eq!(TrackedHand::new(0, &joints), None);
    }
}
