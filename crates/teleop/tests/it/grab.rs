//! A scripted headset takes the fresh bulb from the bench: its hand goes where the expert's plan has it.

use fiatlux_teleop::{Frame, Hand, Inputs};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde_json::json;

use crate::common::{Seen, drive};

// Of crates/policies/src/hands/grab.toml: the expert's plan.
const STAND: [f64; 2] = [0.38, -0.08];
const TOLERANCE_M: f64 = 0.04;
const GLASS_M: f64 = 0.1531;
const HAND_FROM_GLASS: [f64; 3] = [-0.0596, -0.1225, -0.0339];
const TILT: [f64; 2] = [0.2863, -0.1539];
const TURN: f64 = 0.6;
const READY: [f64; 3] = [0.16, 0.10, 0.0];
const PRE_GRASP: [f64; 3] = [0.07, 0.0, 0.0];
const LIFT_M: f64 = 0.08;

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
    /// Of the device, in the user's axes, and of the hand when it was taken.
    taken: Option<(Isometry3<f64>, Isometry3<f64>)>,
    trigger: f64,
}

impl Grabber {
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
                    self.goal = wanted;
                }
                (goal, speed) = (self.goal, if self.phase == Phase::PreGrasp { 0.12 } else { 0.06 });
                let arrived = elapsed > 2.0 && reached(&self.goal, 0.012) || elapsed > 6.0;
                arrived.then_some(if self.phase == Phase::PreGrasp { Phase::Approach } else { Phase::Close })
            }
            Phase::Close => {
                goal = self.goal;
                self.trigger = 1.0;
                (elapsed > 2.2).then(|| {
                    self.goal.translation.vector.z += LIFT_M;
                    Phase::Lift
                })
            }
            Phase::Lift => {
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

fn grab(seed: u64) -> Option<fiatlux_proto::v3::EpisodeEnd> {
    let mut grabber = Grabber {
        phase: Phase::Raise,
        since: 0,
        heading: 0.0,
        way: None,
        goal: Isometry3::identity(),
        taken: None,
        trigger: 0.0,
    };
    let mut inputs = Inputs::default();
    drive(
        "S08",
        seed,
        1800,
        Box::new(move |seen| {
            let message = grabber.message(seen);
            let frame = inputs.read("webxr", &message).expect("a message").frame;
            // A trigger that was never pulled says nothing.
            let unset = |hand: &Hand| hand.fingers.is_none();
            assert!(grabber.trigger > 0.0 || frame.as_ref().is_none_or(|frame: &Frame| frame.hands.iter().all(unset)));
            frame
        }),
    )
}

/// Strict success by the poses that the expert's plan gives, through the messages of a headset.
#[test]
fn a_headset_takes_the_bulb() {
    let end = grab(65).expect("it ends");
    assert!(end.success && end.cause == "success" && !end.broken && !end.dropped, "{end:?}");
}
