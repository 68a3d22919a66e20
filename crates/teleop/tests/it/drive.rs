//! A driven robot: it walks, stops, moves its hands, and never jumps.

use fiatlux_rules::Task;
use fiatlux_teleop::{Bends, Fingers, Frame, Hand, Motion};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::common::{Seen, drive, drive_robot};

fn follow(side: usize, pose: Isometry3<f64>) -> Frame {
    let mut frame = Frame::default();
    frame.hands[side] = Hand { motion: Motion::Follow(pose), fingers: None };
    frame
}

/// A robot whose input is gone in mid-stride stands, and stays where it is.
#[test]
fn a_robot_without_input_stands() {
    let (mut from, mut at) = (Vector3::zeros(), Vec::new());
    let end = drive(
        "S07",
        4,
        250,
        Box::new(|seen| {
            from = if seen.step == 0 { seen.pelvis.translation.vector } else { from };
            at.push(seen.pelvis.translation.vector);
            (seen.step < 75).then(|| Frame { walk: [-1.0, 0.0, 0.0], ..Frame::default() })
        }),
    );
    assert_eq!(end, None, "the gate does not hold, and a fall ends no take");
    let way = |a: usize, b: usize| (at[a] - at[b]).xy().norm();
    assert!(way(0, 75) > 0.15, "it walks: {} m", way(0, 75));
    assert!(way(175, 250) < 0.05, "it stands: {} m", way(175, 250));
    assert!(at[250].z > 0.65, "upright: {} m", at[250].z);
}

/// Fingers that were told to close go on to do so while input is late, and those that were told nothing stay: by a trigger, and by a
/// tracked hand on each robot.
#[test]
fn a_hand_closes_while_input_is_late() {
    let fist = Bends { across: 1.0, knuckles: [1.0; 5], middles: [1.0; 5], pinches: [0.0; 2] };
    let inspire = ["hand_base_link", "L_index_intermediate", "R_index_intermediate"];
    let dex3 = ["hand_palm_link", "left_hand_index_1_link", "right_hand_index_1_link"];
    for (robot, links, fingers) in [
        ("g1_inspire", inspire, Fingers::Close(1.0)),
        ("g1_inspire", inspire, Fingers::Bend(fist)),
        ("g1_dex3", dex3, Fingers::Bend(fist)),
    ] {
        let mut bent = Vec::new();
        let script = |seen: &Seen<'_>| {
            bent.push([("left", links[1]), ("right", links[2])].map(|(side, tip)| {
                let base = seen.link(&format!("{side}_{}", links[0])).rotation;
                base.inverse() * seen.link(tip).rotation
            }));
            // A fifth of a second of input, and then none.
            let hands = [Hand::default(), Hand { fingers: Some(fingers), ..Hand::default() }];
            (seen.step < 10).then(|| Frame { hands, ..Frame::default() })
        };
        drive_robot(robot, "S07", 4, 120, Box::new(script));
        let turned = |side: usize| bent[10][side].angle_to(&bent[120][side]);
        assert!(turned(1) > 1.5, "{fingers:?}: the right index finger of {robot} closes: {} rad", turned(1));
        assert!(turned(0) < 0.2, "{fingers:?}: the left one of {robot} stays: {} rad", turned(0));
    }
}

/// Every task of the benchmark can be driven: its hands, its legs, its torso; and a fall ends none of them.
#[test]
fn every_task_can_be_driven() {
    for task in Task::ALL {
        let mut lowest = f64::INFINITY;
        let end = drive(
            task.short_id(),
            4,
            40,
            Box::new(|seen| {
                lowest = lowest.min(seen.pelvis.translation.z);
                let mut frame = follow(0, Isometry3::translation(0.0, 0.0, 0.002 * seen.step as f64));
                frame.hands[1].motion = Motion::Rate { linear: [0.0, 0.0, 0.5], angular: [0.0, 0.2, 0.0] };
                (frame.walk, frame.torso, frame.rise) = ([0.2, 0.0, 0.1], [0.3, 0.0], -0.2);
                Some(frame)
            }),
        );
        assert_eq!(end, None, "{task}");
        assert!(lowest.is_finite(), "{task}");
    }
}

/// The hand repeats the device's motion from wherever the hand is: along and about the axes of the pelvis.
#[test]
fn a_hand_repeats_the_motion_of_its_device() {
    let mut palms = Vec::new();
    let away =
        Isometry3::from_parts(Vector3::new(5.0, -3.0, 1.0).into(), UnitQuaternion::from_euler_angles(0.3, 1.0, 2.0));
    drive(
        "S08",
        4,
        160,
        Box::new(|seen| {
            palms.push(seen.pelvis.inv_mul(&seen.link("right_palm")));
            let share = (seen.step as f64 / 60.0).min(1.0);
            let mut device = away;
            device.translation.vector += share * Vector3::new(-0.06, -0.08, 0.12);
            Some(follow(1, device))
        }),
    );
    let jump = palms.windows(2).map(|pair| (pair[1].translation.vector - pair[0].translation.vector).norm());
    let jump = jump.fold(0.0, f64::max);
    assert!(jump < 0.02, "{jump} m in a step");
    let way = palms[160].translation.vector - palms[0].translation.vector;
    let error = (way - Vector3::new(-0.06, -0.08, 0.12)).norm();
    assert!(error < 0.02, "{error} m off: {way:?}");
}

/// A device that jumps, a space that moves and a clutch that is let go leave the hand where it is.
#[test]
fn the_clutch_never_jumps() {
    let mut palms: Vec<Isometry3<f64>> = Vec::new();
    drive(
        "S08",
        4,
        200,
        Box::new(|seen| {
            palms.push(seen.pelvis.inv_mul(&seen.link("left_palm")));
            let mut device = Isometry3::translation(0.0, 0.0, 1.0);
            let mut frame = match seen.step {
                0..50 => follow(0, device),
                50..80 => {
                    // Tracking was lost and found elsewhere.
                    device.translation.vector += Vector3::new(0.4, 0.3, -0.5);
                    follow(0, device)
                }
                80..110 => Frame::default(),
                110..140 => {
                    device.translation.vector += Vector3::new(-0.1, 0.0, 0.1);
                    follow(0, device)
                }
                _ => {
                    // The reference space has moved.
                    device.translation.vector += Vector3::new(0.0, 0.1, 0.1);
                    follow(0, device)
                }
            };
            frame.space = u64::from(seen.step >= 140);
            Some(frame)
        }),
    );
    let first = palms[10].translation.vector;
    let farthest = palms[10..].iter().map(|palm| (palm.translation.vector - first).norm()).fold(0.0, f64::max);
    // The noise of the joints' angles moves a sensed palm by up to 20 mm.
    assert!(farthest < 0.04, "{farthest} m");
}
