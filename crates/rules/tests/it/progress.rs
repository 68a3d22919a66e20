//! Gate progress, its start count, effort, and rows that no simulator should give.

use crate::common::*;
use fiatlux_rules::{Cause, Causes, JudgeOptions, Rewards, Row, Task, Variant, errand};
use nalgebra::Vector3;

/// From three criteria of five: one more is half, and what is lost again stays counted.
#[test]
fn progress_is_the_best_beyond_the_start() {
    let mut judge = judge(Task::S03);
    judge.start(&start_of(Task::S03));
    let mut touched = row_at(1, &start_of(Task::S03));
    touch(&mut touched, OLD, RIGHT[0], 3.0);
    assert_eq!(judge.advance(&touched).progress, 0.5);
    let verdict = judge.advance(&row_at(2, &start_of(Task::S03)));
    assert_eq!((verdict.count, verdict.best_count, verdict.progress), (3, 4, 0.5));
    assert_eq!(judge.advance(&row_at(3, &goal_of(Task::S03))).progress, 1.0);
}

#[test]
fn fewer_criteria_than_at_the_start_are_no_progress() {
    let mut judge = judge(Task::S02);
    judge.start(&start_of(Task::S02));
    let mut row = row_at(1, &start_of(Task::S02));
    lean_ladder(&mut row);
    topple(&mut row);
    assert_eq!(judge.advance(&row).progress, 0.0);
}

#[test]
fn a_start_that_holds_everything_is_full_progress_but_no_success() {
    for task in Task::SUBTASKS {
        let mut judge = judge(task);
        let verdict = *judge.start(&goal_of(task));
        assert_eq!((verdict.progress, verdict.success, verdict.end), (1.0, false, None), "{task}");
    }
}

#[test]
fn published_counting_starts_a_row_later_and_ends_on_the_next_start() {
    let options = JudgeOptions { published_counting: true, ..JudgeOptions::default() };
    let mut judge = judge_with(Task::S05, options);
    judge.start(&start_of(Task::S05));
    assert_eq!(judge.start_count(), None);
    // The hand opens in step 0.
    let mut row = row_at(1, &start_of(Task::S05));
    let_go(&mut row, OLD);
    judge.advance(&row);
    assert_eq!(judge.start_count(), Some(2));
    assert_eq!(judge.advance(&row_at(2, &start_of(Task::S05))).progress, 0.5);
    // Success, but the counted row shows the start state with the last forces: three of four.
    let verdict = judge.advance(&row_at(3, &goal_of(Task::S05)));
    assert_eq!((verdict.success, verdict.count, verdict.best_count, verdict.progress), (true, 4, 3, 0.5));
}

#[test]
fn effort_is_the_mean_sum_of_squared_actions() {
    let mut judge = judge(Task::S01);
    let mut row = start_of(Task::S01);
    row.action.fill(5.0); // The staged posture does not count as an action.
    judge.start(&row);
    for step in 1..=4 {
        let mut row = row_at(step, &start_of(Task::S01));
        row.action[0] = step as f64;
        row.action[52] = -1.0;
        judge.advance(&row);
    }
    // (1 + 4 + 9 + 16) / 4 + 1
    assert_eq!(judge.summary().control_effort, 8.5);
    assert_eq!(judge.summary().steps, 4);
}

/// Nothing that a row contains makes a judge or a reward panic, and a row without numbers holds no criterion.
#[test]
fn junk_rows() {
    let mut draw = Draw(7);
    for task in Task::ALL {
        let options = JudgeOptions { end_on: Some(Causes::NONE), published_counting: draw.one_in(2) };
        let mut judge = judge_with(task, options);
        let mut rewards = Rewards::new(&judge, Variant::Training, joint_groups());
        let mut spoil = |row: &mut Row| {
            let hands = errand::HAND_FORCE.map(|measure| row.force(measure).len()).iter().sum::<usize>();
            let limbs = row.forces.len() - row.force(errand::LADDER_FORCE).len();
            let mut numbers: Vec<&mut f64> = Vec::new();
            for body in [&mut row.robot].into_iter().chain(&mut row.things[..errand::FIXTURE]) {
                numbers.extend(body.pose.translation.vector.iter_mut());
                numbers.extend(body.linear_velocity.iter_mut());
                let rotation = body.pose.rotation.as_mut_unchecked();
                numbers.extend(rotation.coords.iter_mut());
            }
            let forces = row.forces.iter_mut().enumerate().filter(|(i, _)| *i < hands || *i >= limbs);
            numbers.extend(forces.flat_map(|(_, force)| force.iter_mut()));
            numbers.extend(row.joint_position.iter_mut().chain(&mut row.action));
            for number in numbers {
                if draw.one_in(10) {
                    *number = draw.junk();
                }
            }
        };
        let mut row = start_of(task);
        spoil(&mut row);
        judge.start(&row);
        rewards.start(&judge, &row);
        for step in 1..300 {
            let mut row = row_at(step, &goal_of(task));
            spoil(&mut row);
            let progress = judge.advance(&row).progress;
            assert!((0.0..=1.0).contains(&progress), "{task}: {progress}");
            assert!(rewards.advance(&judge, &row).iter().all(|term| term.value.is_finite()), "{task}");
        }
    }
}

#[test]
fn a_row_without_numbers_holds_nothing() {
    let nowhere = body(at([f64::NAN; 3]));
    let moving = fiatlux_rules::BodyRow { linear_velocity: Vector3::repeat(f64::NAN), ..nowhere };
    for task in Task::ALL {
        let mut row = row_at(2, &goal_of(task));
        row.robot = moving;
        row.robot.pose.rotation.as_mut_unchecked().coords.fill(f64::NAN);
        row.things[errand::LADDER] = row.robot;
        (row.things[errand::OLD_BULB], row.things[errand::FRESH_BULB]) = (row.robot, row.robot);
        hand_forces(&mut row).for_each(|force| force.fill(f64::NAN));
        row.attachments[NEW].seated = false;
        let mut judge = judge_with(task, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
        judge.start(&start_of(task));
        judge.advance(&row_at(1, &start_of(task)));
        let verdict = judge.advance(&row);
        assert_eq!(verdict.count, 0, "{task}: {:?}", verdict.criteria);
        // The socket's hold on a bulb is not one of the numbers.
        let conditions = verdict.conditions.without(Cause::Unseated);
        assert_eq!(conditions, Causes::of(&[Cause::Diverged]), "{task}: {conditions}");
    }
}
