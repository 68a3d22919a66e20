//! Payments for rows that end `replace` or `climb` or complete a part of the errand, and the figures from which they are paid.

use fiatlux_rules::{Cause, errand};
use nalgebra::Vector3;

use super::*;

/// A task, its end, the term that pays for it and how much, a change of the start state by a measure, and that measure
/// on either side of the limit.
type Limit = (Task, Cause, &'static str, f64, fn(&mut Row, f64), [f64; 2]);

fn limits() -> Vec<Limit> {
    use Cause::*;
    use Task::{Climb, Replace};
    let height: fn(&mut Row, f64) = |row, z| row.robot.pose.translation.vector.z = z;
    let tilt: fn(&mut Row, f64) = |row, a| row.robot.pose = rotated([0.75, 0.0, 0.79], Vector3::new(0.6, 0.8, 0.0), a);
    vec![
        (Replace, Fall, "robot_fall", -4.0, height, [0.351, 0.349]),
        (Replace, Fall, "robot_fall", -4.0, tilt, [0.999, 1.001]),
        (Climb, Fall, "robot_fall", -4.0, height, [0.351, 0.349]),
        (Climb, Fall, "robot_fall", -4.0, tilt, [0.999, 1.001]),
        (
            Replace,
            Tip,
            "ladder_tipped",
            -4.0,
            |row, a| row.things[errand::LADDER].pose.rotation *= rotated([0.0; 3], Vector3::x(), a).rotation,
            [0.599, 0.601],
        ),
        (
            Replace,
            Drop,
            "fresh_bulb_dropped",
            -2.0,
            |row, z| row.things[errand::BULBS[NEW]].pose.translation.vector.z = z,
            [0.401, 0.399],
        ),
        (
            Replace,
            Drop,
            "old_bulb_dropped",
            -2.0,
            |row, z| {
                row.attachments[OLD].seated = false;
                row.things[errand::BULBS[OLD]].pose = at([0.5, 0.5, z]);
            },
            [0.151, 0.149],
        ),
        // Next to the crate it is dropped, in it disposed of.
        (
            Replace,
            Drop,
            "old_bulb_dropped",
            -2.0,
            |row, aside| {
                put_in_crate(row, OLD);
                row.things[errand::BULBS[OLD]].pose.translation.vector.x += aside;
            },
            [0.2, 0.4],
        ),
        (
            Replace,
            Success,
            "success_bonus",
            10.0,
            |row, z| {
                *row = row_at(row.step, &goal_of(Replace));
                // It lies along the crate's y, 0.03956 m thick, and the rim is at 0.17 m.
                row.things[errand::BULBS[OLD]].pose.translation.vector.z = z;
            },
            [0.1306, 0.1302],
        ),
        (Climb, Success, "success_bonus", 10.0, |row, z| row.robot = body(at([1.5, 0.0, z])), [1.8199, 1.8201]),
        (Climb, Success, "success_bonus", 10.0, |row, aside| row.robot = body(at([1.6, aside, 1.9])), [0.601, 0.599]),
        (
            Climb,
            Success,
            "success_bonus",
            10.0,
            |row, speed| {
                row.robot = body(at([1.5, 0.0, 1.9]));
                row.robot.linear_velocity = Vector3::new(0.0, 0.6 * speed, 0.8 * speed);
            },
            [1.501, 1.499],
        ),
    ]
}

/// The row that passes the limit ends the episode and pays; the row before it does neither.
#[test]
fn the_row_that_ends_pays() {
    for (i, (task, cause, term, amount, change, [outside, inside])) in limits().into_iter().enumerate() {
        let mut meter = Meter::new(task, Variant::Benchmark, &start_of(task));
        for (step, value, met) in [(1, outside, false), (2, inside, true)] {
            let mut row = row_at(step, &start_of(task));
            change(&mut row, value);
            meter.show(&row);
            let end = meter.judge.verdict().end.filter(|end| end.causes.contains(cause));
            assert_eq!(end.map(|end| end.step), met.then_some(2), "{i}: {task} {cause} at {value}");
            assert_eq!(meter.last(term), if met { amount } else { 0.0 }, "{i}: {task} {cause} at {value}");
        }
        assert!(meter.judge.verdict().end.is_some_and(|end| end.is_terminated()), "{i}: {task} {cause}");
    }
}

/// A term, what it pays, a change of the start state by a measure, and that measure on either side of the limit.
type Completion = (&'static str, f64, fn(&mut Row, f64), [f64; 2]);

const COMPLETIONS: [Completion; 6] = [
    // The ladder's top point is 0.1 m to the side of its root.
    (
        "ladder_ready",
        2.0,
        |row, d| row.things[errand::LADDER].pose = at([FIXTURE[0] + d, FIXTURE[1] - 0.1, 0.0]),
        [0.671, 0.669],
    ),
    ("ladder_ready", 2.0, |row, a| row.things[errand::LADDER].pose = rotated(FIXTURE, Vector3::x(), a), [0.601, 0.599]),
    (
        "old_bulb_removed",
        3.0,
        |row, d| {
            row.attachments[OLD].seated = false;
            row.things[errand::BULBS[OLD]].pose = row.things[errand::FIXTURE].pose * at([0.0, 0.0, d]);
        },
        [0.0999, 0.1001],
    ),
    (
        "old_bulb_removed",
        3.0,
        |row, free| {
            row.attachments[OLD].seated = free < 0.5;
            row.things[errand::BULBS[OLD]].pose = row.things[errand::FIXTURE].pose * at([0.0, 0.0, 0.15]);
        },
        [0.0, 1.0],
    ),
    // It lies along the crate's y, 0.03956 m thick, and the rim is at 0.17 m.
    (
        "old_bulb_disposed",
        5.0,
        |row, z| {
            put_in_crate(row, OLD);
            row.things[errand::BULBS[OLD]].pose.translation.vector.z = z;
        },
        [0.1306, 0.1302],
    ),
    // In place is not inserted: the socket must hold it.
    (
        "fresh_bulb_inserted",
        5.0,
        |row, seated| {
            put_in_socket(row, NEW);
            row.attachments[NEW].seated = seated > 0.5;
        },
        [0.0, 1.0],
    ),
];

/// A bonus is paid for the row that passes its limit, and for no other.
#[test]
fn the_row_that_completes_pays() {
    for (i, (term, amount, change, [outside, inside])) in COMPLETIONS.into_iter().enumerate() {
        let mut meter = Meter::endless(Task::Replace, Variant::Benchmark, &start_of(Task::Replace));
        for (step, value, pays) in [(1, outside, 0.0), (2, inside, amount), (3, inside, 0.0), (4, outside, 0.0)] {
            let mut row = row_at(step, &start_of(Task::Replace));
            change(&mut row, value);
            meter.show(&row);
            assert_eq!(meter.last(term), pays, "{i}: {term} at {value}");
        }
    }
}

/// Either half of the errand alone is not a success. Success in the row of a fall pays, and the fall is charged.
#[test]
fn success_of_the_errand_takes_both_bulbs() {
    let [start, goal] = [start_of(Task::Replace), goal_of(Task::Replace)];
    let swapped = |bulb: usize| {
        let mut row = goal.clone();
        (row.things[errand::BULBS[bulb]], row.attachments[bulb]) =
            (start.things[errand::BULBS[bulb]], start.attachments[bulb]);
        row
    };
    for bulb in [OLD, NEW] {
        let meter = play(Task::Replace, Variant::Benchmark, &[&start, &swapped(bulb), &swapped(bulb)]);
        assert_eq!(meter.paid("success_bonus"), 0.0, "without bulb {bulb}");
        assert_eq!(meter.paid("fresh_bulb_inserted") + meter.paid("old_bulb_disposed"), 5.0, "without bulb {bulb}");
    }
    let mut fallen = goal.clone();
    topple(&mut fallen);
    let meter = play(Task::Replace, Variant::Benchmark, &[&start, &fallen]);
    assert_eq!((meter.last("success_bonus"), meter.last("robot_fall")), (10.0, -4.0));
}

/// Success in a row that diverges does not pay, nor does anything else of that row but its failures.
#[test]
fn a_row_that_diverges_pays_its_failures_alone() {
    for (task, variant) in
        [(Task::Replace, Variant::Benchmark), (Task::Climb, Variant::Benchmark), (Task::S05, Variant::Training)]
    {
        let mut wild = goal_of(task);
        wild.robot.linear_velocity = Vector3::new(1e9, 0.0, 0.0);
        wild.robot.angular_velocity = Vector3::repeat(1e9);
        wild.joint_velocity.fill(1e9);
        topple(&mut wild);
        let meter = play(task, variant, &[&start_of(task), &wild]);
        for (name, paid) in &meter.paid {
            let expected = if ["diverged", "robot_fall"].contains(name) { -4.0 } else { 0.0 };
            assert_eq!(*paid, expected, "{task} {name}");
        }
    }
}

/// A bulb in a socket is not disposed of, wherever the socket is.
#[test]
fn a_seated_bulb_is_not_disposed_of() {
    let start = start_of(Task::Replace);
    let mut held = goal_of(Task::Replace);
    held.attachments[OLD].seated = true;
    let mut freed = held.clone();
    freed.attachments[OLD].seated = false;
    let meter = play(Task::Replace, Variant::Benchmark, &[&start, &held]);
    assert_eq!((meter.paid("old_bulb_disposed"), meter.paid("success_bonus")), (0.0, 0.0));
    let meter = play(Task::Replace, Variant::Benchmark, &[&start, &held, &freed]);
    assert_eq!((meter.last("old_bulb_disposed"), meter.last("success_bonus")), (5.0, 10.0));
}

/// An episode that goes on pays for success and failures once, even if they last, cease or come again.
#[test]
fn success_and_failures_pay_once() {
    let (start, goal) = (start_of(Task::Replace), goal_of(Task::Replace));
    let mut bad = start.clone();
    topple(&mut bad);
    lean_ladder_at_root(&mut bad);
    bad.things[errand::BULBS[NEW]].pose = at([0.0, 0.0, 0.3]);
    bad.things[errand::BULBS[OLD]].pose = at([0.0, 0.0, 0.1]);
    bad.attachments[OLD].seated = false;
    let meter = play(Task::Replace, Variant::Benchmark, &[&start, &bad, &bad, &goal, &goal, &start, &bad, &goal]);
    for (name, pays) in [
        ("robot_fall", -4.0),
        ("ladder_tipped", -4.0),
        ("fresh_bulb_dropped", -2.0),
        ("old_bulb_dropped", -2.0),
        ("ladder_ready", 2.0),
        ("fresh_bulb_inserted", 5.0),
        ("old_bulb_removed", 3.0),
        ("old_bulb_disposed", 5.0),
        ("success_bonus", 10.0),
    ] {
        assert_eq!(meter.paid(name), pays, "{name}");
    }
}

/// A robot that does nothing has its whole horizon, row by row, and neither earns nor owes.
#[test]
fn idle_episodes_run_to_their_horizon_and_pay_nothing() {
    for (task, horizon) in [(Task::Replace, 72_000), (Task::Climb, 6_000)] {
        let mut row = start_of(task);
        let mut meter = Meter::new(task, Variant::Benchmark, &row);
        while meter.judge.verdict().end.is_none() {
            row.step += 1;
            meter.show(&row);
        }
        let end = meter.judge.verdict().end.expect("ended");
        assert_eq!((end.step, end.cause(), end.is_truncated()), (horizon, Cause::TimeOut, true), "{task}");
        assert!(meter.paid.iter().all(|(_, paid)| *paid == 0.0), "{task}: {:?}", meter.paid);
    }
}
