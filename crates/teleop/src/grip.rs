//! Fingers that close around a bulb without crushing it, or as those of a tracked hand do.

use std::collections::BTreeMap;

use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::Robot;
use fiatlux_skills::grip::{HandBodies, HandJoint, finger, grasp_of, side};
use fiatlux_wbc::CONTROL_DT;
use serde::Deserialize;

use crate::frame::{Bends, Fingers};

/// Share of the way from open to closed in a second, and by how much of it the fingers are behind the thumb.
const RATE: f64 = 1.0;
const LAG: f64 = 0.3;
/// Fastest turn of a target, rad/s.
const MAX_TURN_RATE: f64 = 2.0;
/// A finger that a bulb presses with more than this, N, does not press harder than that with its joints, N m, where their drives
/// have more. Both are those of the policy `hands`.
const TOUCH_N: f64 = 1.0;
const TORQUE_NM: f64 = 0.3;
/// Shares by which a tracked hand may be less closed than the robot's to take it over, and by which a finger has to open to let go.
const TAKES_OVER: f64 = 0.05;
const OPENS: f64 = 0.02;

/// Flexion of a tracked finger that turns a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Bend {
    Across,
    Knuckle,
    Middle,
}

/// Angles of a joint, rad.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Angles {
    bend: Bend,
    straight: f64,
    bent: f64,
    #[serde(default)]
    open: f64,
    /// Around a bulb: in the robot's own grasp.
    #[serde(skip)]
    bulb: f64,
    index_pinch: Option<f64>,
    middle_pinch: Option<f64>,
    /// The angles are the right hand's; those of the left one have the other sign.
    #[serde(default)]
    mirrored: bool,
}

impl Angles {
    fn of_side(self, side: usize) -> Self {
        let sign = if self.mirrored && side == 0 { -1.0 } else { 1.0 };
        Self {
            straight: sign * self.straight,
            bent: sign * self.bent,
            open: sign * self.open,
            bulb: sign * self.bulb,
            index_pinch: self.index_pinch.map(|angle| sign * angle),
            middle_pinch: self.middle_pinch.map(|angle| sign * angle),
            ..self
        }
    }

    /// An angle as a share of the way from straight to bent.
    fn share(&self, angle: f64) -> f64 {
        ((angle - self.straight) / (self.bent - self.straight)).clamp(0.0, 1.0)
    }
}

/// A joint of a finger.
#[derive(Debug, Clone)]
struct Joint {
    joint: HandJoint,
    side: usize,
    finger: usize,
    angles: Angles,
    q0: f64,
}

impl Joint {
    fn share(&self, bends: &Bends) -> f64 {
        match self.angles.bend {
            Bend::Across => bends.across,
            Bend::Knuckle => bends.knuckles[self.finger],
            Bend::Middle => bends.middles[self.finger],
        }
    }

    /// The angle by which the robot's finger does what a tracked one does. Fingers that touch the thumb's tip do so on the robot, too.
    fn bent(&self, bends: &Bends) -> f64 {
        let Angles { straight, bent, index_pinch, middle_pinch, .. } = self.angles;
        let angle = straight + self.share(bends) * (bent - straight);
        [index_pinch, middle_pinch]
            .iter()
            .zip(bends.pinches)
            .fold(angle, |angle, (pinch, share)| pinch.map_or(angle, |pinch| angle + share * (pinch - angle)))
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct Finger {
    share: f64,
    has_touched: bool,
}

/// The fingers of both hands; none for a robot whose fingers are welded or that has other hands.
#[derive(Debug, Clone)]
pub(crate) struct Grips {
    joints: Vec<Joint>,
    bodies: HandBodies,
    hands: [Option<[Finger; 5]>; 2],
    /// The fingers do as those of a tracked hand.
    are_taken: [bool; 2],
}

impl Grips {
    pub fn new(info: &SessionInfo) -> Result<Self, toml::de::Error> {
        let known: BTreeMap<String, Angles> = toml::from_str(include_str!("grip.toml"))?;
        let robot = Robot::of_session(&info.robot, info.joints.iter().map(|joint| joint.name.as_str()));
        let grasp = robot.as_ref().map(|robot| grasp_of(robot, 1)).unwrap_or_default();
        let bulb: BTreeMap<&str, f64> =
            grasp.iter().filter_map(|(name, angle)| Some((side(name)?.1, *angle))).collect();
        let joint = |(joint, name): (HandJoint, &str)| {
            let (side, of_hand) = side(name)?;
            let angles = Angles { bulb: *bulb.get(of_hand)?, ..*known.get(of_hand)? }.of_side(side);
            Some(Joint { joint, side, finger: finger(name)?, angles, q0: info.joints[joint.index].q0 })
        };
        Ok(Self {
            joints: HandJoint::all(&info.joints).filter_map(joint).collect(),
            bodies: HandBodies::new(&info.hand_bodies),
            hands: [None; 2],
            are_taken: [false; 2],
        })
    }

    /// Moves the targets of both hands for a control step. A hand without a command, left first, stays as it is. `turned` are the
    /// sensed angles from q0, rad, `forces` those of the sensor `hand_contact`.
    pub fn step(&mut self, wanted: [Option<Fingers>; 2], turned: &[f32], forces: &[f32], targets: &mut [f64]) {
        let force = self.bodies.touch(forces).map(|touch| touch.fingers);
        for side in 0..2 {
            let joints = self.joints.iter().filter(|joint| joint.side == side);
            let Some(wanted) = wanted[side] else {
                self.are_taken[side] = false;
                continue;
            };
            let hand = self.hands[side].get_or_insert_with(|| staged(joints.clone(), targets));
            match wanted {
                Fingers::Close(share) => {
                    self.are_taken[side] = false;
                    close(hand, share, &force[side]);
                }
                Fingers::Bend(bends) => {
                    // Where the thumb stands does not make a hand open.
                    let flexing = joints.clone().filter(|joint| joint.angles.bend != Bend::Across);
                    let [own, robots] = mean(&closures(flexing, &bends, targets));
                    self.are_taken[side] |= own >= robots - TAKES_OVER;
                    if !self.are_taken[side] {
                        continue;
                    }
                    let shares = closures(joints.clone(), &bends, targets);
                    let along = staged(joints.clone(), targets);
                    for (index, finger) in hand.iter_mut().enumerate() {
                        let opens = shares[index][0] < shares[index][1] - OPENS;
                        finger.share = along[index].share;
                        finger.has_touched = (finger.has_touched || force[side][index] > TOUCH_N) && !opens;
                    }
                }
            }
            for joint in joints {
                let (Some(target), finger) = (targets.get_mut(joint.joint.index), hand[joint.finger]) else { continue };
                let Angles { open, bulb, .. } = joint.angles;
                let goal = match wanted {
                    Fingers::Close(_) => open + finger.share * (bulb - open),
                    Fingers::Bend(bends) => joint.bent(&bends),
                };
                let step = MAX_TURN_RATE * CONTROL_DT;
                let mut next = *target + (goal - *target).clamp(-step, step);
                if let (true, Some(turned)) = (finger.has_touched, turned.get(joint.joint.index)) {
                    next = joint.joint.bounded(next, joint.q0 + f64::from(*turned), TORQUE_NM);
                }
                let [lower, upper] = joint.joint.limits;
                *target = next.clamp(lower, upper);
            }
        }
    }
}

/// Moves the closure of each finger on towards a share.
fn close(hand: &mut [Finger; 5], wanted: f64, force: &[f64; 5]) {
    let thumb = hand[0].share;
    for (index, (finger, force)) in hand.iter_mut().zip(force).enumerate() {
        let behind = if index > 0 && thumb + 1e-9 < wanted { (thumb - LAG).max(0.0) } else { wanted };
        let goal = if finger.share < wanted { behind.max(finger.share).min(wanted) } else { wanted };
        finger.has_touched = (finger.has_touched || *force > TOUCH_N) && goal >= finger.share;
        finger.share += (goal - finger.share).clamp(-RATE * CONTROL_DT, RATE * CONTROL_DT);
    }
}

/// Closure of each finger as a tracked hand wants it and as it is by its targets; zeros for a finger that the robot lacks.
fn closures<'a>(joints: impl Iterator<Item = &'a Joint>, bends: &Bends, targets: &[f64]) -> [[f64; 2]; 5] {
    let (mut sums, mut counts) = ([[0.0_f64; 2]; 5], [0.0_f64; 5]);
    for joint in joints {
        let angles = &joint.angles;
        let target = targets.get(joint.joint.index).copied().unwrap_or(angles.straight);
        sums[joint.finger][0] += angles.share(joint.bent(bends));
        sums[joint.finger][1] += angles.share(target);
        counts[joint.finger] += 1.0;
    }
    for (sums, count) in sums.iter_mut().zip(counts) {
        sums.iter_mut().for_each(|sum| *sum /= f64::max(count, 1.0));
    }
    sums
}

fn mean(shares: &[[f64; 2]; 5]) -> [f64; 2] {
    [0, 1].map(|whose| shares.iter().map(|both| both[whose]).sum::<f64>() / shares.len() as f64)
}

/// Closure of a hand's fingers by their targets.
fn staged<'a>(joints: impl Iterator<Item = &'a Joint>, targets: &[f64]) -> [Finger; 5] {
    let mut sums = [[0.0_f64; 2]; 5];
    for joint in joints {
        let Angles { open, bulb, .. } = joint.angles;
        let (way, target) = (bulb - open, targets.get(joint.joint.index).copied().unwrap_or(open));
        sums[joint.finger][0] += way * (target - open);
        sums[joint.finger][1] += way * way;
    }
    sums.map(|[along, way]| Finger { share: (along / way.max(1e-9)).clamp(0.0, 1.0), has_touched: false })
}

#[cfg(test)]
mod tests {
    use fiatlux_robot::Robot;
    use nalgebra::{Isometry3, Point3};

    use super::*;

    const CLOSED: Option<Fingers> = Some(Fingers::Close(1.0));
    const OPEN: Option<Fingers> = Some(Fingers::Close(0.0));
    const STRAIGHT: Bends = Bends { across: 0.0, knuckles: [0.0; 5], middles: [0.0; 5], pinches: [0.0; 2] };
    const FIST: Bends = Bends { across: 1.0, knuckles: [1.0; 5], middles: [1.0; 5], pinches: [0.0; 2] };

    fn info() -> SessionInfo {
        info_of("g1_inspire")
    }

    fn info_of(robot: &str) -> SessionInfo {
        let robot = Robot::by_name(robot).expect("the robot");
        let joint = |joint: &fiatlux_robot::Joint| fiatlux_proto::v3::Joint {
            name: joint.name.clone(),
            lower: joint.lower,
            upper: joint.upper,
            stiffness: joint.gains.stiffness,
            ..fiatlux_proto::v3::Joint::default()
        };
        SessionInfo {
            joints: robot.joints().iter().map(joint).collect(),
            hand_bodies: robot.hand_links().iter().map(|link| robot.links()[*link].name.clone()).collect(),
            ..SessionInfo::default()
        }
    }

    fn finger(info: &SessionInfo, name: &str) -> usize {
        info.joints.iter().position(|joint| joint.name == name).expect("a joint")
    }

    #[test]
    fn the_thumb_closes_first_and_all_arrive() {
        let info = info();
        let mut grips = Grips::new(&info).expect("data");
        assert_eq!(grips.joints.len(), 24);
        let mut targets = vec![0.0; info.joints.len()];
        let (thumb, index) = (finger(&info, "R_thumb_distal_joint"), finger(&info, "R_index_proximal_joint"));
        for _ in 0..12 {
            grips.step([None, CLOSED], &[], &[], &mut targets);
        }
        assert!(targets[thumb] > 0.1 && targets[index].abs() < 1e-9, "{} {}", targets[thumb], targets[index]);
        for _ in 0..90 {
            grips.step([None, CLOSED], &[], &[], &mut targets);
        }
        assert!((targets[thumb] - 0.8376).abs() < 1e-9 && (targets[index] - 1.5623).abs() < 1e-9);
        assert!(targets[finger(&info, "L_index_proximal_joint")].abs() < 1e-12, "the other hand stays");
    }

    /// A finger that feels the bulb where it is goes no further than its torque bends the drive.
    #[test]
    fn a_finger_that_touches_presses_no_harder() {
        let info = info();
        let mut grips = Grips::new(&info).expect("data");
        let mut targets = vec![0.0; info.joints.len()];
        let index = finger(&info, "R_index_proximal_joint");
        let body = info.hand_bodies.iter().position(|name| name == "R_index_intermediate").expect("a body");
        let mut forces = vec![0.0; 3 * info.hand_bodies.len()];
        forces[3 * body] = 3.0;
        let mut turned = vec![0.0; info.joints.len()];
        turned[index] = 0.5;
        for _ in 0..200 {
            grips.step([None, CLOSED], &turned, &forces, &mut targets);
        }
        let bend = TORQUE_NM / info.joints[index].stiffness;
        assert!((targets[index] - 0.5 - bend).abs() < 1e-6, "{}", targets[index]);
        forces[3 * body] = 0.0;
        for _ in 0..200 {
            grips.step([None, OPEN], &turned, &forces, &mut targets);
        }
        assert!(targets[index].abs() < 1e-9, "it opens");
    }

    /// Moves both hands for two seconds.
    fn bend(grips: &mut Grips, bends: Bends, targets: &mut [f64]) {
        (0..100).for_each(|_| grips.step([Some(Fingers::Bend(bends)); 2], &[], &[], targets));
    }

    /// Both hands after two seconds of a command, from a start.
    fn after(info: &SessionInfo, bends: Bends, start: &[f64]) -> Vec<f64> {
        let (mut grips, mut targets) = (Grips::new(info).expect("data"), start.to_vec());
        bend(&mut grips, bends, &mut targets);
        targets
    }

    /// Each joint of a finger by its share of the way from straight to bent, as far as its range goes; its name and its finger.
    fn shares(info: &SessionInfo, targets: &[f64]) -> Vec<(String, usize, f64)> {
        let grips = Grips::new(info).expect("data");
        let share = |joint: &Joint| {
            let [lower, upper] = joint.joint.limits;
            let [straight, bent] = [joint.angles.straight, joint.angles.bent].map(|angle| angle.clamp(lower, upper));
            let share = Angles { straight, bent, ..joint.angles }.share(targets[joint.joint.index]);
            (info.joints[joint.joint.index].name.clone(), joint.finger, share)
        };
        grips.joints.iter().map(share).collect()
    }

    #[test]
    fn the_fingers_of_every_robot_open_and_close_as_a_tracked_hand() {
        for robot in Robot::NAMES {
            let info = info_of(robot);
            let (mut grips, mut targets) = (Grips::new(&info).expect("data"), vec![0.0; info.joints.len()]);
            let known = Robot::by_name(robot).expect("the robot").joint_groups().fingers.len();
            assert_eq!(grips.joints.len(), known, "{robot}: grip.toml has each joint of its fingers");
            bend(&mut grips, FIST, &mut targets);
            for (joint, _, share) in shares(&info, &targets) {
                assert!(share > 0.999, "{joint} of {robot} closes: {share}");
            }
            bend(&mut grips, STRAIGHT, &mut targets);
            for (joint, _, share) in shares(&info, &targets) {
                assert!(share < 0.001, "{joint} of {robot} opens: {share}");
            }
        }
    }

    #[test]
    fn one_finger_closes_alone() {
        for robot in ["g1_inspire", "g1_dex3"] {
            let info = info_of(robot);
            let open = after(&info, STRAIGHT, &vec![0.0; info.joints.len()]);
            for finger in 0..5 {
                let mut bends = STRAIGHT;
                (bends.knuckles[finger], bends.middles[finger]) = (1.0, 1.0);
                bends.across = f64::from(u8::from(finger == 0));
                for (joint, of, share) in shares(&info, &after(&info, bends, &open)) {
                    assert!(
                        (share - f64::from(u8::from(of == finger))).abs() < 1e-3,
                        "{joint} with finger {finger}: {share}"
                    );
                }
            }
        }
    }

    /// On both sides, by the robot's own shapes.
    #[test]
    fn tips_that_touch_do_so_on_the_robot() {
        for name in ["g1_inspire", "g1_dex3"] {
            let (robot, info) = (Robot::by_name(name).expect("the robot"), info_of(name));
            let apart = |targets: &[f64], side: &str, finger: &str| {
                let links = robot.forward_kinematics(targets, &Isometry3::identity()).expect("finite");
                let tip = |finger: &str| {
                    let wanted = format!("{side}_{finger}_tip");
                    let site = robot.sites().into_iter().find(|site| site.name == wanted).expect("a tip");
                    links[site.link] * site.link_from_site * Point3::origin()
                };
                (tip("thumb") - tip(finger)).norm()
            };
            let open = after(&info, STRAIGHT, &vec![0.0; info.joints.len()]);
            for (pinch, finger) in ["index", "middle"].into_iter().enumerate() {
                // As a tracked hand has it: the pinch is not in the bends alone.
                let mut bends = Bends { across: 0.8, ..STRAIGHT };
                (bends.knuckles[1 + pinch], bends.middles[1 + pinch], bends.pinches[pinch]) = (0.8, 0.2, 1.0);
                let pinched = after(&info, bends, &open);
                for side in ["left", "right"] {
                    let (open, pinched) = (apart(&open, side, finger), apart(&pinched, side, finger));
                    assert!(open > 0.06 && pinched < 0.025, "{side} {finger} of {name}: {open} m, then {pinched} m");
                }
            }
        }
    }

    /// A hand that holds a bulb does not open because the operator's hand is open when it is taken over.
    #[test]
    fn a_tracked_hand_takes_over_once_it_is_as_closed() {
        let info = info();
        let (mut grips, mut targets) = (Grips::new(&info).expect("data"), vec![0.0; info.joints.len()]);
        for _ in 0..150 {
            grips.step([None, CLOSED], &[], &[], &mut targets);
        }
        let closed = targets.clone();
        bend(&mut grips, STRAIGHT, &mut targets);
        let right = |targets: &[f64]| shares(&info, targets).into_iter().filter(|(joint, ..)| joint.starts_with("R_"));
        assert!(right(&targets).eq(right(&closed)), "it holds");
        bend(&mut grips, FIST, &mut targets);
        bend(&mut grips, STRAIGHT, &mut targets);
        let index = finger(&info, "R_index_proximal_joint");
        assert!(targets[index] < 1e-6, "it opens: {}", targets[index]);
    }
}
