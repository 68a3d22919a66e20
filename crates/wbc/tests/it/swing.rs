//! Arms that are free swing with the legs; one whose hand holds something stays where it is.

use fiatlux_robot::Robot;
use fiatlux_wbc::{BODY, BodyCommand, CONTROL_DT, Clock, MOVED, Swing};

const SECOND: usize = 50;
const WALKS: BodyCommand = BodyCommand { velocity: [0.45, 0.0, 0.2], height: 0.75, torso: [0.0; 3] };

/// Shoulder pitch, roll and elbow of the left arm, then of the right one.
const JOINTS: [usize; 6] = [MOVED, MOVED + 1, MOVED + 3, MOVED + 7, MOVED + 8, MOVED + 10];

/// Plays seconds of walking and then of standing: strides and targets of each step, and where the targets began.
fn play(is_free: [bool; 2], walking: usize, standing: usize) -> (Vec<(f64, Vec<f64>)>, Vec<f64>) {
    let start = Robot::by_name("g1_bare").unwrap().q0().to_vec();
    let (mut clock, mut swing, mut targets) = (Clock::default(), Swing::new(&start), start.clone());
    let step = |step| {
        let command = if step < walking * SECOND { WALKS } else { BodyCommand::default() };
        swing.step(&command, clock.stride(), is_free, &mut targets);
        clock.advance(command.walks());
        (clock.stride(), targets.clone())
    };
    ((0..(walking + standing) * SECOND).map(step).collect(), start)
}

#[test]
fn free_arms_swing_against_the_legs_and_come_to_rest() {
    let (steps, start) = play([true; 2], 6, 4);
    let robot = Robot::by_name("g1_bare").unwrap();
    let names = JOINTS.map(|joint| robot.joints()[joint].name.as_str());
    let parts = ["shoulder_pitch", "shoulder_roll", "elbow"];
    assert!(names.iter().zip(parts.iter().cycle()).all(|(name, part)| name.contains(part)), "{names:?}");
    for (index, (_, targets)) in steps.iter().enumerate() {
        let before = index.checked_sub(1).map_or(&start, |before| &steps[before].1);
        for joint in 0..BODY {
            let limits = &robot.joints()[joint];
            assert!((limits.lower..=limits.upper).contains(&targets[joint]), "{}", limits.name);
            let speed = (targets[joint] - before[joint]).abs() / CONTROL_DT;
            assert!(speed <= if JOINTS.contains(&joint) { 3.0 } else { 0.0 }, "{} at {speed} rad/s", limits.name);
        }
    }
    // A joint's pitch is negative to the front: the left arm is there as the left foot is at the back.
    let walking = &steps[3 * SECOND..6 * SECOND];
    let ahead = walking.iter().map(|(stride, targets)| stride * (targets[JOINTS[3]] - targets[JOINTS[0]]));
    let (together, squares) = (ahead.sum::<f64>(), walking.iter().map(|(stride, _)| stride * stride).sum::<f64>());
    assert!((0.4..0.5).contains(&(together / squares)), "{} rad", together / squares);
    for (_, targets) in walking {
        let middle = 0.5 * (targets[JOINTS[0]] + targets[JOINTS[3]]);
        assert!((middle - 0.15).abs() < 1e-6 && targets[JOINTS[1]] == -targets[JOINTS[4]]);
        let elbow = 0.5 * (targets[JOINTS[0]] - middle);
        assert!((targets[JOINTS[2]] - 0.8 - elbow).abs() < 1e-6, "the elbow bends to the front");
    }
    let last = &steps[steps.len() - 1].1;
    assert!((last[JOINTS[0]] - last[JOINTS[3]]).abs() < 1e-3, "{last:?}");
}

#[test]
fn an_arm_that_holds_something_stays_and_the_other_swings_less() {
    let (steps, start) = play([true, false], 6, 0);
    assert!(steps.iter().all(|(_, targets)| targets[MOVED + 7..] == start[MOVED + 7..]));
    let pitches: Vec<f64> = steps[3 * SECOND..].iter().map(|(_, targets)| targets[JOINTS[0]]).collect();
    let width = pitches.iter().copied().fold(f64::MIN, f64::max) - pitches.iter().copied().fold(f64::MAX, f64::min);
    assert!((0.2..0.25).contains(&width), "{width} rad");
}

#[test]
fn arms_rest_where_the_robot_stands() {
    let (steps, start) = play([true; 2], 0, 3);
    assert!(steps.iter().all(|(_, targets)| *targets == start));
    // A peer's targets may be too few; that is for the controller to refuse.
    let mut short = [0.5; MOVED + 2];
    Swing::new(&short).step(&WALKS, 1.0, [true; 2], &mut short);
}
