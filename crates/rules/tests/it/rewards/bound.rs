//! The published bound of the full errand: no sequence of rows earns more than 55.

use super::*;
use fiatlux_rules::errand;

/// Upper bounds of the terms in an episode: weight x 0.02 s, in the order of the terms (paper).
const BOUNDS: [(&str, f64); 9] = [
    ("ladder_progress", 5.0),
    ("fresh_bulb_progress", 10.0),
    ("old_bulb_removal", 5.0),
    ("old_bulb_disposal_progress", 10.0),
    ("ladder_ready", 2.0),
    ("fresh_bulb_inserted", 5.0),
    ("old_bulb_removed", 3.0),
    ("old_bulb_disposed", 5.0),
    ("success_bonus", 10.0),
];
const BOUND: f64 = 55.0;
const SEQUENCES: u64 = 4_000;
const ROWS: u64 = 40;
/// Numbers of four bodies' poses and of the places of socket and crate.
const POSE_NUMBERS: usize = 4 * 7 + 2 * 3;
/// Rounding of sums of some hundred payments.
const EPSILON: f64 = 1e-9;

/// Ingredients of a sequence.
#[derive(Debug, Clone, Copy)]
struct Mood {
    /// The robot stands as it did, so that no penalty hides what is earned.
    calm: bool,
    /// One thing in how many is at its goal or its start, and one row in how many is spoilt.
    goal: u64,
    start: u64,
    junk: u64,
    /// Rows repeat, go back and leave gaps.
    jumps: bool,
    /// The task's own conditions end the episode, and rows go on after it.
    ends: bool,
}

impl Mood {
    fn draw(draw: &mut Draw) -> Self {
        let [goal, start, junk] = [[1, 2, 3, 8], [2, 4, 8, 1_000], [4, 12, 1_000, 1_000]];
        let mut one_of = |numbers: [u64; 4]| numbers[(draw.bits() % 4) as usize];
        let (goal, start, junk) = (one_of(goal), one_of(start), one_of(junk));
        Self { calm: !draw.one_in(3), goal, start, junk, jumps: draw.one_in(3), ends: draw.one_in(2) }
    }
}

/// A row in which all that the errand pays for is anywhere, at its start, at its goal, just off a threshold, or is not
/// a number.
fn adversarial(draw: &mut Draw, mood: Mood, step: u64) -> Row {
    let start = start_of(Task::Replace);
    let anything = draw.row(step);
    let mut row = if mood.calm { row_at(step, &start) } else { anything.clone() };
    row.things[..errand::FIXTURE].copy_from_slice(&anything.things[..errand::FIXTURE]);
    row.attachments.clone_from(&anything.attachments);
    if draw.one_in(mood.start) {
        row.things[errand::LADDER] = start.things[errand::LADDER];
    }
    for bulb in [OLD, NEW] {
        if draw.one_in(mood.start) {
            (row.things[errand::BULBS[bulb]], row.attachments[bulb]) =
                (start.things[errand::BULBS[bulb]], start.attachments[bulb]);
        }
    }
    if step == 0 && !draw.one_in(4) {
        // Where nothing is done yet the most is left to earn.
        return row_at(0, &start);
    }
    if draw.one_in(mood.goal) {
        lift_ladder_to_seat(&mut row);
    }
    if draw.one_in(mood.goal) {
        put_in_socket(&mut row, NEW);
        row.attachments[NEW].seated = !draw.one_in(4);
    }
    if draw.one_in(mood.goal) {
        if draw.one_in(2) {
            put_in_crate(&mut row, OLD);
        } else {
            sink_into_crate(&mut row);
        }
        row.attachments[OLD].seated = draw.one_in(6);
    }
    if draw.one_in(12) {
        row.things[errand::BULBS[OLD]] =
            body(row.things[errand::FIXTURE].pose * at([0.0, 0.0, 0.1 + 1e-9 * draw.unit()]));
    }
    if draw.one_in(12) {
        row.things[errand::LADDER].pose.rotation =
            rotated([0.0; 3], nalgebra::Vector3::x(), 0.6 + 1e-9 * draw.unit()).rotation;
    }
    if draw.one_in(20) {
        row.things[errand::CRATE].pose.translation.vector += draw.vector(0.5);
        row.things[errand::FIXTURE].pose.translation.vector += draw.vector(0.5);
    }
    spoil(draw, mood.junk, &mut row);
    row
}

fn spoil(draw: &mut Draw, one_in: u64, row: &mut Row) {
    if !draw.one_in(one_in) {
        return;
    }
    let mut numbers: Vec<&mut f64> = Vec::new();
    let hands = errand::HAND_FORCE.map(|measure| row.force(measure).len()).iter().sum();
    let (free, fixed) = row.things.split_at_mut(errand::FIXTURE);
    for body in [&mut row.robot].into_iter().chain(free) {
        numbers.extend(body.pose.translation.vector.iter_mut());
        numbers.extend(body.pose.rotation.as_mut_unchecked().coords.iter_mut());
    }
    for body in fixed {
        numbers.extend(body.pose.translation.vector.iter_mut());
    }
    numbers.extend(row.com_velocity.iter_mut().chain(&mut row.action).chain(&mut row.joint_velocity));
    numbers.extend(row.forces[..hands].iter_mut().flat_map(|force| force.iter_mut()));
    for _ in 0..=draw.bits() % 3 {
        let number = (draw.bits() as usize) % numbers.len();
        // The numbers of the poses come first and are few.
        let number = if draw.one_in(2) { number % POSE_NUMBERS } else { number };
        *numbers[number] = draw.junk();
    }
}

/// Whatever the rows: bulbs and ladder that jump, flags that flip, numbers that are none, success again and again, rows
/// after the end. At no time has a term earned more than its bound or all of them more than 55, and no penalty earns.
#[test]
fn no_sequence_of_rows_exceeds_the_bound() {
    let mut draw = Draw(55);
    let (mut best, mut best_of, mut worst_of) = (0.0_f64, [0.0_f64; 9], [0.0_f64; 9]);
    let (mut full, mut after_the_end) = (0, 0);
    for sequence in 0..SEQUENCES {
        let mood = Mood::draw(&mut draw);
        let first = adversarial(&mut draw, mood, 0);
        let new = if mood.ends { Meter::new } else { Meter::endless };
        let mut meter = new(Task::Replace, Variant::Benchmark, &first);
        assert!(meter.paid.iter().map(|(name, _)| *name).take(9).eq(BOUNDS.map(|(name, _)| name)));
        let (mut step, mut best_here) = (0, 0.0_f64);
        for _ in 1..ROWS {
            step = if mood.jumps { step + draw.bits() % 3 } else { step + 1 };
            after_the_end += u64::from(meter.judge.verdict().end.is_some());
            meter.show(&adversarial(&mut draw, mood, step));
            let (earning, charging) = meter.paid.split_at(9);
            for (i, ((name, paid), (_, bound))) in earning.iter().zip(BOUNDS).enumerate() {
                // A potential may fall below where it started, by no more than it can rise.
                let floor = if i < 4 { -bound } else { 0.0 };
                assert!(
                    (floor - EPSILON..=bound + EPSILON).contains(paid),
                    "{sequence} {step} {name}: {paid} {mood:?}"
                );
                (best_of[i], worst_of[i]) = (best_of[i].max(*paid), worst_of[i].min(*paid));
            }
            let earned: f64 = earning.iter().map(|(_, paid)| paid).sum();
            assert!(earned <= BOUND + EPSILON, "{sequence} {step}: {earned} {mood:?}");
            assert!(charging.iter().all(|(_, paid)| *paid <= 0.0), "{sequence} {step}: {charging:?}");
            assert!(meter.rewards.reward().is_finite(), "{sequence} {step}");
            best_here = best_here.max(earned);
        }
        best = best.max(best_here);
        full += u64::from(best_here > BOUND - 1e-6);
    }
    // The draw has been everywhere: at each bound, at 55 from many sides, and after ends.
    assert!(best > BOUND - EPSILON, "{best}");
    assert!(full > 100 && after_the_end > 1_000, "{full} {after_the_end}");
    for ((name, bound), (best, worst)) in BOUNDS.iter().zip(best_of.iter().zip(worst_of)) {
        assert!(*best > bound - EPSILON, "{name}: {best}");
        assert!(worst < -0.9 * bound || !name.contains("progress"), "{name}: {worst}");
    }
}

/// The bound is that of the terms, no more: rows that no robot can make earn all of it, whichever goal comes first.
#[test]
fn the_bound_is_reached() {
    let mut done = start_of(Task::Replace);
    lift_ladder_to_seat(&mut done);
    put_in_socket(&mut done, NEW);
    sink_into_crate(&mut done);
    let start = start_of(Task::Replace);
    let mut half = start.clone();
    (half.things[errand::LADDER], half.things[errand::BULBS[NEW]], half.attachments[NEW]) =
        (done.things[errand::LADDER], done.things[errand::BULBS[NEW]], done.attachments[NEW]);
    for states in [vec![&start, &done], vec![&start, &half, &start, &done, &start, &half, &done, &done]] {
        let meter = play(Task::Replace, Variant::Benchmark, &states);
        for (name, bound) in BOUNDS {
            assert!(close(meter.paid(name), bound), "{name}: {}", meter.paid(name));
        }
        assert!(close(meter.total(), BOUND), "{}", meter.total());
    }
}
