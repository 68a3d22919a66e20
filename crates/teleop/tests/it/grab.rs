//! A scripted headset takes the fresh bulb from the bench: its hand goes where the expert's plan has it.

use fiatlux_proto::v3::EpisodeEnd;
use fiatlux_teleop::{Bends, Fingers, Frame, Hand, Inputs};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde_json::json;

use crate::common::{Seen, drive};

// The expert's plan, of crates/policies/src/hands/grab.toml. The glass is 5 mm farther from the hand: one that waits there must not
// push the bulb over.
const HAND_FROM_GLASS: [f64; 3] = [-0.0646, -0.1225, -0.0339];
const TILT: [f64; 2] = [0.2863, -0.1539];
const TURN: f64 = 0.6;
const STAND: [f64; 2] = [0.38, -0.08];
const TOLERANCE_M: f64 = 0.04;
const GLASS_M: f64 = 0.1531;
const READY: [f64; 3] = [0.16, 0.10, 0.0];
const PRE_GRASP: [f64; 3] = [0.07, 0.0, 0.0];
const LIFT_M: f64 = 0.08;
/// Share of an error of the hand that is corrected in a step, and the largest correction, m, once it is this near its goal, m.
const ARRIVED_M: f64 = 0.004;
const CORRECTS: f64 = 0.02;
const MAX_CORRECTION_M: f64 = 0.01;

/// The hand around the bulb, world, for a robot that looks along a heading.
fn grasp(bulb: &Isometry3<f64>, heading: f64) -> Isometry3<f64> {
    let glass = bulb * Point3::new(0.0, 0.0, GLASS_M);
    let turn = heading + TURN - std::f64::consts::FRAC_PI_2;
    let hand = UnitQuaternion::from_euler_angles(std::f64::consts::PI + TILT[0], TILT[1], 0.0);
    let hand_from_glass = Isometry3::from_parts(Translation3::from(HAND_FROM_GLASS), hand);
    Isometry3::new(glass.coords, Vector3::z() * turn) * hand_from_glass.inverse()
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Raise,
    StepUp,
    Settle,
    PreGrasp,
    Approach,
    Close,
    Lift,
}

/// An operator who sees the room, and moves the device so that the hand goes to poses.
struct Grabber {
    phase: Phase,
    since: u64,
    heading: f64,
    /// Pose of the hand's base on its way, pelvis.
    way: Option<Isometry3<f64>>,
    goal: Isometry3<f64>,
    /// The goal in the room, where the hand is to stay whatever the pelvis does, and how far the goal is moved for it.
    held: Option<Isometry3<f64>>,
    correction: Vector3<f64>,
    /// Of the device, in the user's axes, and of the hand when it was taken.
    taken: Option<(Isometry3<f64>, Isometry3<f64>)>,
    trigger: f64,
}

impl Grabber {
    /// Where the hand is wanted so that it comes to where it is held, as the operator sees it.
    fn hold(&mut self, seen: &Seen<'_>, hand: &Isometry3<f64>) {
        let Some(held) = self.held else { return };
        let wanted = seen.pelvis.inv_mul(&held);
        let left = self.way.map_or(f64::INFINITY, |way| (way.translation.vector - self.goal.translation.vector).norm());
        if left < ARRIVED_M {
            let off = wanted.translation.vector - hand.translation.vector;
            self.correction = (self.correction + CORRECTS * off).cap_magnitude(MAX_CORRECTION_M);
        }
        self.goal = wanted;
        self.goal.translation.vector += self.correction;
    }

    fn message(&mut self, seen: &Seen<'_>) -> serde_json::Value {
        let elapsed = (seen.step - self.since) as f64 * 0.02;
        let hand = seen.pelvis.inv_mul(&seen.link("right_hand_base_link"));
        let world_from_grasp = grasp(&seen.fresh_bulb, seen.heading());
        let away = seen.pelvis.inverse_transform_point(&seen.fresh_bulb.translation.vector.into()).coords;
        let left = Vector3::new(away.x - STAND[0], away.y - STAND[1], 0.0);
        let (mut walk, mut speed) = ([0.0; 3], 0.12);
        let goal;
        let reached =
            |goal: &Isometry3<f64>, most: f64| (goal.translation.vector - hand.translation.vector).norm() < most;
        let next = match self.phase {
            Phase::Raise => {
                if seen.step == 0 {
                    self.heading = seen.heading();
                    let mut grasp = world_from_grasp;
                    grasp.translation.vector -= seen.pelvis.rotation * left;
                    self.goal = seen.pelvis.inv_mul(&(grasp * Translation3::from(READY)));
                }
                (goal, speed) = (self.goal, 0.2);
                (elapsed > 1.0 && reached(&self.goal, 0.03) || elapsed > 6.0).then_some(Phase::StepUp)
            }
            Phase::StepUp => {
                goal = self.goal;
                let pace = (1.5 * left.norm()).clamp(0.12, 0.2) / left.norm().max(1e-6);
                let turn = self.heading - seen.heading();
                walk = [pace * left.x / 0.5, pace * left.y / 0.3, 1.5 * turn / 0.7];
                (left.norm() < TOLERANCE_M).then_some(Phase::Settle)
            }
            Phase::Settle => {
                goal = self.goal;
                (elapsed > 2.0).then_some(if left.norm() < 2.0 * TOLERANCE_M { Phase::PreGrasp } else { Phase::StepUp })
            }
            Phase::PreGrasp | Phase::Approach => {
                let back = if self.phase == Phase::PreGrasp { PRE_GRASP } else { [0.0; 3] };
                let wanted = seen.pelvis.inv_mul(&(world_from_grasp * Translation3::from(back)));
                if self.phase == Phase::Approach && elapsed == 0.0 || self.phase == Phase::PreGrasp {
                    self.held = Some(seen.pelvis * wanted);
                }
                self.hold(seen, &hand);
                (goal, speed) = (self.goal, if self.phase == Phase::PreGrasp { 0.12 } else { 0.06 });
                let arrived = elapsed > 2.0 && reached(&self.goal, 0.012) || elapsed > 6.0;
                arrived.then_some(if self.phase == Phase::PreGrasp { Phase::Approach } else { Phase::Close })
            }
            Phase::Close => {
                self.hold(seen, &hand);
                goal = self.goal;
                self.trigger = 1.0;
                (elapsed > 2.2).then(|| {
                    self.held = self.held.map(|held| Translation3::new(0.0, 0.0, LIFT_M) * held);
                    Phase::Lift
                })
            }
            Phase::Lift => {
                self.hold(seen, &hand);
                (goal, speed) = (self.goal, 0.1);
                None
            }
        };
        if let Some(next) = next {
            (self.phase, self.since) = (next, seen.step + 1);
        }
        // On a straight way towards the goal.
        let from = self.way.unwrap_or(hand);
        let left = (goal.translation.vector - from.translation.vector)
            .norm()
            .max(0.3 * from.rotation.angle_to(&goal.rotation));
        let share = (speed * 0.02 / left.max(1e-9)).min(1.0);
        let way = Isometry3::from_parts(
            from.translation.vector.lerp(&goal.translation.vector, share).into(),
            from.rotation.slerp(&goal.rotation, share),
        );
        self.way = Some(way);
        // From when the device is taken, the palm moves as the device does.
        let palm_from_hand = seen.link("right_palm").inv_mul(&seen.link("right_hand_base_link"));
        let palm = way * palm_from_hand.inverse();
        let (device, start) = *self.taken.get_or_insert((Isometry3::translation(0.2, -0.2, 1.2), palm));
        let turn = palm.rotation * start.rotation.inverse() * device.rotation;
        let at = device.translation.vector + palm.translation.vector - start.translation.vector;
        // x forwards, y left, z up become x right, y up, z backwards.
        let pose = [-at.y, at.z, -at.x, -turn.j, turn.k, -turn.i, turn.w];
        let right = json!({
            "pose": pose, "buttons": [self.trigger, 1.0, 0.0, 0.0, 0.0, 0.0], "axes": [0.0, 0.0, unstick(-walk[2]), 0.0]
        });
        let left = json!({
            "pose": null, "buttons": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "axes": [0.0, 0.0, unstick(-walk[1]), unstick(-walk[0])]
        });
        json!({ "space": 0, "visible": true, "heading": 0.0, "running": true, "left": left, "right": right })
    }
}

/// The place of a stick for a share, beyond its dead zone.
fn unstick(share: f64) -> f64 {
    if share.abs() < 0.02 { 0.0 } else { (0.15 + 0.85 * share.abs().min(1.0)).copysign(share) }
}

/// Plays a take; `fingers` turns the pull of a trigger into what the fingers are told.
fn grab(seed: u64, fingers: fn(f64) -> Fingers) -> EpisodeEnd {
    let mut grabber = Grabber {
        phase: Phase::Raise,
        since: 0,
        heading: 0.0,
        way: None,
        goal: Isometry3::identity(),
        held: None,
        correction: Vector3::zeros(),
        taken: None,
        trigger: 0.0,
    };
    let mut inputs = Inputs::default();
    let end = drive(
        "S08",
        seed,
        1800,
        Box::new(move |seen| {
            let message = grabber.message(seen);
            let mut frame = inputs.read("webxr", &message).expect("a message").frame;
            // A trigger that was never pulled says nothing.
            let unset = |hand: &Hand| hand.fingers.is_none();
            assert!(grabber.trigger > 0.0 || frame.as_ref().is_none_or(|frame: &Frame| frame.hands.iter().all(unset)));
            for hand in frame.iter_mut().flat_map(|frame| &mut frame.hands) {
                if let Some(Fingers::Close(share)) = hand.fingers {
                    hand.fingers = Some(fingers(share));
                }
            }
            frame
        }),
    );
    end.expect("it ends")
}

fn takes_the_bulb(end: &EpisodeEnd) -> bool {
    end.success && end.cause == "success" && !end.broken && !end.dropped
}

/// A tracked hand that makes a fist.
fn fist(share: f64) -> Fingers {
    Fingers::Bend(Bends { across: share, knuckles: [share; 5], middles: [share; 5], pinches: [0.0; 2] })
}

/// Strict success by the poses that the expert's plan gives, through the messages of a headset.
#[test]
fn a_headset_takes_the_bulb() {
    let end = grab(65, Fingers::Close);
    assert!(takes_the_bulb(&end), "{end:?}");
}

/// The same with fingers that do as those of a tracked hand.
#[test]
fn a_tracked_hand_takes_the_bulb() {
    let end = grab(64, fist);
    assert!(takes_the_bulb(&end), "{end:?}");
}
