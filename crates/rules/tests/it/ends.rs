//! Ends of episodes, and conditions that are noted even if they end nothing.

use crate::common::*;
use fiatlux_rules::{Cause, Causes, End, Judge, JudgeOptions, Row, Task, errand};
use nalgebra::Vector3;

fn started(task: Task, options: JudgeOptions) -> Judge {
    let mut judge = judge_with(task, options);
    judge.start(&start_of(task));
    judge
}

/// Shows the start state, changed, as row `step`.
fn end_of(task: Task, step: u64, change: fn(&mut Row)) -> Option<End> {
    let mut row = row_at(step, &start_of(task));
    change(&mut row);
    started(task, JudgeOptions::default()).advance(&row).end
}

fn fall(row: &mut Row) {
    row.robot.pose.translation.vector.z = 0.34;
}

fn crush_old(row: &mut Row) {
    touch(row, OLD, LEFT, 50.5);
}

fn crush_fresh(row: &mut Row) {
    touch(row, NEW, RIGHT[0], 50.5);
}

fn lower_old(row: &mut Row) {
    row.attachments[OLD].seated = false;
    row.things[errand::BULBS[OLD]].pose = at([0.0, 1.0, 0.14]);
}

fn lower_fresh(row: &mut Row) {
    row.things[errand::BULBS[NEW]].pose = at([0.0, 1.0, 0.39]);
    row.attachments[NEW].seated = false;
}

type Change = fn(&mut Row);

/// Which tasks a condition ends: the last column of the table.
#[test]
fn each_condition_ends_its_tasks() {
    use Task::*;
    let cases: [(Cause, Change, &[Task]); 7] = [
        (Cause::Fall, fall, &Task::ALL),
        (Cause::Fall, topple, &Task::ALL),
        (Cause::Tip, lean_ladder, &[S01, S02, S03, S04, S09, S10, S11, S12, Replace]),
        (Cause::Crush, crush_old, &[S03, S04, S05, S06]),
        (Cause::Crush, crush_fresh, &[S09, S10, S11]),
        (Cause::Drop, lower_old, &[S03, S04, Replace]),
        (Cause::Drop, lower_fresh, &[S08, S10, S11, Replace]),
    ];
    for (cause, change, tasks) in cases {
        for task in Task::ALL {
            let ended = end_of(task, 3, change).is_some_and(|end| end.causes.contains(cause));
            assert_eq!(ended, tasks.contains(&task), "{task} on {cause}");
        }
    }
    let unseat: fn(&mut Row) = |row| row.attachments[NEW].seated = false;
    for task in Task::ALL {
        let cause = end_of(task, 3, unseat).map(|end| end.cause());
        assert_eq!(cause, (task == S12).then_some(Cause::Unseated), "{task}");
    }
}

#[test]
fn grabbing_has_a_drop_height_of_its_own() {
    let lower: fn(&mut Row) = |row| row.things[errand::BULBS[NEW]].pose = at([0.0, 1.0, 0.49]);
    assert_eq!(end_of(Task::S08, 3, lower).map(|end| end.cause()), Some(Cause::Drop));
    assert_eq!(end_of(Task::S10, 3, lower), None);
}

#[test]
fn a_crush_of_the_first_two_rows_breaks_but_does_not_end() {
    let mut judge = started(Task::S05, JudgeOptions::default());
    for step in 1..=3 {
        let mut row = row_at(step, &start_of(Task::S05));
        crush_old(&mut row);
        let verdict = judge.advance(&row);
        assert!(verdict.broken);
        assert_eq!(verdict.end.map(|end| end.cause()), (step == 3).then_some(Cause::Crush), "{step}");
    }
    assert!((judge.verdict().peak_hand_force_n - 50.5).abs() < 1e-9);
    // Row 0 counts too.
    let mut row = start_of(Task::S05);
    crush_old(&mut row);
    assert!(judge.start(&row).broken);
    // Any bulb on any body breaks, in every task.
    let mut judge = started(Task::S01, JudgeOptions::default());
    let mut row = row_at(1, &start_of(Task::S01));
    crush_fresh(&mut row);
    let verdict = judge.advance(&row);
    assert!(verdict.broken && verdict.end.is_none());
}

/// S05 does not ask the robot to stand: it can arrive and fall in one step.
#[test]
fn success_and_failure_in_one_row_are_both_recorded_and_success_counts() {
    let mut judge = started(Task::S05, JudgeOptions::default());
    let mut row = row_at(6_000, &goal_of(Task::S05));
    fall(&mut row);
    crush_old(&mut row);
    let verdict = judge.advance(&row);
    let end = verdict.end.expect("ended");
    assert_eq!(end.causes, Causes::of(&[Cause::Success, Cause::Fall, Cause::Crush, Cause::TimeOut]));
    assert_eq!((end.cause(), end.is_terminated(), verdict.success), (Cause::Success, true, true));
    let summary = judge.summary();
    assert!(summary.success && summary.broken && !summary.clean());
    assert_eq!(summary.score(), 0.0);
}

#[test]
fn time_out_truncates() {
    for (task, horizon) in [(Task::S01, 6_000), (Task::Replace, 72_000), (Task::Climb, 6_000)] {
        assert_eq!(end_of(task, horizon - 1, |_| {}), None);
        let end = end_of(task, horizon, |_| {}).expect("ended");
        assert_eq!((end.cause(), end.is_truncated(), end.step), (Cause::TimeOut, true, horizon), "{task}");
        let end = end_of(task, horizon, fall).expect("ended");
        assert_eq!((end.cause(), end.is_truncated()), (Cause::Fall, false), "{task}");
    }
}

/// An episode that starts from a recorded row has its whole horizon before it.
#[test]
fn steps_count_from_the_start() {
    let mut judge = judge(Task::S02);
    judge.start(&row_at(4_000, &start_of(Task::S02)));
    for step in 4_001..=10_000 {
        let ended = judge.advance(&row_at(step, &start_of(Task::S02))).end.is_some();
        assert_eq!(ended, step == 10_000, "{step}");
    }
    assert_eq!(judge.summary().steps, 6_000);
}

#[test]
fn cleared_conditions_are_noted() {
    let end_on = Some(Causes::of(&[Cause::Success, Cause::TimeOut]));
    let mut judge = started(Task::S04, JudgeOptions { end_on, ..JudgeOptions::default() });
    let mut row = row_at(1, &start_of(Task::S04));
    fall(&mut row);
    lower_old(&mut row);
    let verdict = judge.advance(&row);
    assert_eq!((verdict.end, verdict.dropped), (None, true));
    assert_eq!(verdict.conditions, Causes::of(&[Cause::Fall, Cause::Drop]));
    let verdict = judge.advance(&row_at(2, &start_of(Task::S04)));
    assert_eq!((verdict.conditions, verdict.dropped), (Causes::NONE, true));
    assert_eq!((judge.first_met(Cause::Fall), judge.first_met(Cause::Tip)), (Some(1), None));
}

/// Where success does not end an episode it is met once and kept.
#[test]
fn a_cleared_success_is_kept() {
    let mut judge = started(Task::S02, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
    for step in 1..=3 {
        let verdict = judge.advance(&row_at(step, &goal_of(Task::S02)));
        assert_eq!((verdict.success, verdict.conditions.contains(Cause::Success)), (true, step == 1));
    }
    let verdict = judge.advance(&row_at(4, &start_of(Task::S02)));
    assert!(verdict.success && verdict.end.is_none() && verdict.progress == 1.0);
}

#[test]
fn rows_after_the_end_change_nothing() {
    let mut judge = started(Task::S02, JudgeOptions::default());
    let ended = *judge.advance(&row_at(1, &goal_of(Task::S02)));
    let mut row = row_at(2, &start_of(Task::S02));
    crush_fresh(&mut row);
    row.action[0] = 3.0;
    assert_eq!(*judge.advance(&row), ended);
    assert_eq!((judge.summary().steps, judge.summary().control_effort), (1, 0.0));
}

/// 0.1962 m/s of each step is free fall.
#[test]
fn an_impact_is_noted_and_ends_where_asked() {
    let strike = |row: &mut Row, jump: f64| {
        row.things[errand::BULBS[OLD]].linear_velocity = Vector3::new(0.0, 0.0, -0.1962 - jump);
    };
    let impact_ends = JudgeOptions { end_on: Some(Causes::of(&[Cause::Impact])), ..JudgeOptions::default() };
    for (options, ends) in [(JudgeOptions::default(), false), (impact_ends, true)] {
        for (step, jump, met) in [(3, 2.41, true), (3, 2.39, false), (2, 2.41, false)] {
            let mut judge = started(Task::S04, options);
            for before in 1..step {
                judge.advance(&row_at(before, &start_of(Task::S04)));
            }
            let mut row = row_at(step, &start_of(Task::S04));
            strike(&mut row, jump);
            let verdict = *judge.advance(&row);
            assert_eq!(verdict.conditions.contains(Cause::Impact), met, "{step} {jump}");
            assert_eq!(verdict.end.is_some(), met && ends, "{step} {jump}");
        }
    }
}

/// A bulb on its way into the crate passes its drop height between the walls.
#[test]
fn a_bulb_put_into_the_crate_is_not_dropped() {
    let mut judge = started(Task::S06, JudgeOptions::default());
    for (step, z) in (1..).zip([0.3, 0.16, 0.14, 0.1, 0.05]) {
        let mut row = row_at(step, &start_of(Task::S06));
        row.things[errand::BULBS[OLD]].pose = rotated([CRATE[0], CRATE[1] + 0.11, z], Vector3::x(), 1.5);
        assert!(!judge.advance(&row).dropped, "{z}");
    }
    let mut row = row_at(6, &start_of(Task::S06));
    row.things[errand::BULBS[OLD]].pose = rotated([CRATE[0], CRATE[1] + 0.25, 0.14], Vector3::x(), 1.5);
    assert!(judge.advance(&row).dropped);
}

/// Dropping the bulb that a task is not about counts, but does not end it.
#[test]
fn drops_count_in_every_task() {
    let mut judge = started(Task::S02, JudgeOptions::default());
    let mut row = row_at(1, &start_of(Task::S02));
    lower_fresh(&mut row);
    let verdict = judge.advance(&row);
    assert!(verdict.dropped && verdict.end.is_none());
}

#[test]
fn working_height_is_a_diagnostic() {
    let mut judge = started(Task::S02, JudgeOptions::default());
    judge.advance(&row_at(1, &goal_of(Task::S02)));
    assert!(judge.summary().success && !judge.summary().reached_working_height);
}

/// Each bound from both sides, and numbers that are none.
#[test]
fn what_is_not_plausible_diverges() {
    let within: [Change; 7] = [
        |row| row.joint_speed_peak = 200.0,
        |row| row.joint_velocity[52] = -1000.0,
        |row| row.robot.linear_velocity = Vector3::new(12.0, -16.0, 0.0),
        |row| row.things[errand::LADDER].linear_velocity.z = 20.0,
        |row| row.things[errand::BULBS[OLD]].linear_velocity.x = 100.0,
        |row| row.things[errand::BULBS[NEW]].linear_velocity.y = -100.0,
        |row| row.things[errand::BULBS[NEW]].angular_velocity.z = 1e6,
    ];
    let beyond: [Change; 14] = [
        |row| row.joint_speed_peak = 200.1,
        |row| row.joint_speed_peak = f64::INFINITY,
        |row| row.joint_speed_peak = f64::NAN,
        |row| row.joint_velocity[52] = -1000.1,
        |row| row.joint_velocity[0] = f64::NAN,
        |row| row.joint_position[30] = f64::INFINITY,
        |row| row.robot.linear_velocity = Vector3::new(12.0, -16.1, 0.0),
        |row| row.robot.pose.translation.vector.x = f64::NAN,
        |row| row.robot.angular_velocity.y = f64::NEG_INFINITY,
        |row| row.things[errand::LADDER].linear_velocity.z = 20.1,
        |row| row.things[errand::LADDER].pose.rotation.as_mut_unchecked().w = f64::NAN,
        |row| row.things[errand::BULBS[OLD]].linear_velocity.x = 100.1,
        |row| row.things[errand::BULBS[NEW]].linear_velocity.y = -100.1,
        |row| row.things[errand::BULBS[NEW]].pose.translation.vector.z = f64::INFINITY,
    ];
    for task in Task::ALL {
        for (i, change) in within.into_iter().enumerate() {
            assert!(end_of(task, 3, change).is_none_or(|end| !end.causes.contains(Cause::Diverged)), "{task} {i}");
        }
        for (i, change) in beyond.into_iter().enumerate() {
            assert_eq!(end_of(task, 3, change).map(|end| end.cause()), Some(Cause::Diverged), "{task} {i}");
        }
    }
}

/// Divergence overrides a success in the same row, and revokes an earlier success that had not ended the episode.
#[test]
fn an_episode_that_diverges_is_never_a_success() {
    for task in Task::ALL {
        for end_on in [None, Some(Causes::NONE), Some(Causes::of(&[Cause::Success]))] {
            for published_counting in [false, true] {
                let mut judge = started(task, JudgeOptions { end_on, published_counting });
                let window = u64::from(task.spec().gate.sustain_steps);
                // The row that would complete the window; where that is the first, no criterion beyond the start's counts.
                for step in 1..window {
                    judge.advance(&row_at(step, &goal_of(task)));
                }
                let before = *judge.verdict();
                let mut row = row_at(window, &goal_of(task));
                row.joint_speed_peak = f64::INFINITY;
                touch(&mut row, OLD, LEFT, 1e9);
                row.robot.pose.translation.vector.z = 3.0;
                let verdict = judge.advance(&row);
                let end = verdict.end.expect("ended");
                assert_eq!((end.step, end.cause(), end.is_terminated()), (window, Cause::Diverged, true), "{task}");
                assert!(!verdict.success && !verdict.conditions.contains(Cause::Success), "{task}");
                assert_eq!((verdict.progress, verdict.best_count), (before.progress, before.best_count), "{task}");
                assert_eq!((verdict.broken, verdict.peak_hand_force_n), (before.broken, before.peak_hand_force_n));
                assert_eq!(verdict.reached_working_height, before.reached_working_height);
                assert_eq!(judge.first_met(Cause::Diverged), Some(window));
                assert!(!judge.summary().success);
            }
        }
    }
    let mut judge = started(Task::S02, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
    assert!(judge.advance(&row_at(1, &goal_of(Task::S02))).success);
    let mut row = row_at(2, &goal_of(Task::S02));
    row.joint_speed_peak = 300.0;
    assert!(!judge.advance(&row).success);
    assert_eq!(judge.summary().end.map(|end| end.cause()), Some(Cause::Diverged));
}

/// Rows that are missing, repeated or out of order do not count as time in which a gate held, a bulb moved or was
/// struck.
#[test]
fn nothing_is_carried_over_a_gap() {
    let window = u64::from(Task::S06.spec().gate.sustain_steps);
    for next in [window + 1, window - 1, window - 2, 0] {
        let mut judge = started(Task::S06, JudgeOptions::default());
        for step in 1..window {
            assert_eq!(u64::from(judge.advance(&row_at(step, &goal_of(Task::S06))).sustained), step);
        }
        let verdict = judge.advance(&row_at(next, &goal_of(Task::S06)));
        assert_eq!((verdict.sustained, verdict.success), (1, false), "row {next}");
        for more in 1..window {
            let verdict = judge.advance(&row_at(next + more, &goal_of(Task::S06)));
            assert_eq!(verdict.success, more == window - 1, "row {next} + {more}");
        }
    }

    let moved = |step: u64| {
        let mut judge = started(Task::S04, JudgeOptions::default());
        for before in 1..=5 {
            judge.advance(&row_at(before, &start_of(Task::S04)));
        }
        let mut row = row_at(step, &start_of(Task::S04));
        row.things[errand::BULBS[OLD]].pose.translation.vector.x += 0.1;
        row.things[errand::BULBS[OLD]].linear_velocity.x = 5.0;
        let impact = judge.advance(&row).conditions.contains(Cause::Impact);
        (impact, judge.context().bulb_speeds[OLD].linear > 0.0)
    };
    assert_eq!(moved(6), (true, true));
    assert_eq!(moved(7), (false, false));
}
