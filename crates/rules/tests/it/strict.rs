//! Protocol `strict` next to `published`: honest constructions of every task pass both; what misses one strict
//! condition alone passes the published gate and fails by that condition; and no row after its end changes the
//! published verdict.

use crate::common::*;
use fiatlux_rules::{
    Bulb, Cause, GRAVITY, Judge, JudgeOptions, Judges, Protocol, Row, Support, Task, Thresholds, Verdict, errand,
};
use nalgebra::{UnitQuaternion, Vector3};

/// Rows before the goal is reached, and with it: long enough for the slowest window and low-pass.
const BEFORE: u64 = 10;
const WITH: u64 = 160;

fn judges(task: Task) -> Judges {
    Judges::new(Protocol::Strict, task, &Thresholds::default(), &geometry(), JudgeOptions::default())
}

/// Palms move with the robot, and what is not in a hand carries nothing.
fn with_palms(mut row: Row) -> Row {
    for (palm, y) in row.world_from_palm.iter_mut().zip([0.2, -0.2]) {
        *palm = row.robot.pose * at([0.2, y, -0.1]);
    }
    row
}

fn stand_on_floor(row: &mut Row) {
    let half = 0.5 * geometry().robot_mass * GRAVITY;
    row.load_mut(errand::FLOOR_LOAD)[..2].fill(half);
}

fn stand_on_treads(row: &mut Row) {
    let half = 0.5 * geometry().robot_mass * GRAVITY;
    row.load_mut(errand::TREAD_LOAD)[..2].fill(half);
}

/// A state in which the strict gate of a task holds.
fn honest_goal(task: Task) -> Row {
    let mut row = with_palms(goal_of(task));
    match task {
        Task::S02 | Task::S03 | Task::S10 | Task::S11 | Task::Climb => stand_on_treads(&mut row),
        Task::Replace => {
            // Down again, where the published gate lets the robot stand anywhere.
            stand(&mut row, [2.0, 0.45, 0.79], LADDER);
            row = with_palms(row);
            stand_on_floor(&mut row);
        }
        _ => stand_on_floor(&mut row),
    }
    row
}

/// An episode that reaches a goal at once and keeps it, each row changed as it passes.
fn play(task: Task, mut change: impl FnMut(&mut Row, u64)) -> Judges {
    let mut judges = judges(task);
    let (start, goal) = (with_palms(start_of(task)), honest_goal(task));
    judges.start(&start);
    for step in 1..BEFORE + WITH {
        let mut row = row_at(step, if step < BEFORE { &start } else { &goal });
        if step >= BEFORE {
            change(&mut row, step - BEFORE);
        }
        judges.advance(&row);
    }
    judges
}

fn verdicts(judges: &Judges) -> [Verdict; 2] {
    Protocol::ALL.map(|protocol| *judges.of(protocol).verdict())
}

fn missing(judges: &Judges) -> Vec<&'static str> {
    let judge = judges.of(Protocol::Strict);
    let criteria = judge.task().spec().gate.criteria_of(Protocol::Strict);
    let held = judge.verdict().criteria;
    criteria.zip(held.as_slice()).filter(|(_, held)| !**held).map(|(criterion, _)| criterion.name).collect()
}

#[test]
fn honest_episodes_pass_both() {
    for task in Task::ALL {
        let judges = play(task, |_, _| {});
        let [published, strict] = verdicts(&judges);
        assert!(published.success && !published.broken && !published.dropped, "{task}: {published:?}");
        assert!(strict.success && !strict.broken && !strict.dropped, "{task}: {:?} {strict:?}", missing(&judges));
        assert_eq!((published.progress, strict.progress), (1.0, 1.0), "{task}");
        let [first, second] = [published, strict].map(|verdict| verdict.end.expect("an end").step);
        assert!(first <= second, "{task}: strict ends at {second}, published at {first}");
        assert!(second >= BEFORE + u64::from(task.spec().gate.strict_steps) - 1, "{task}: {second}");
    }
}

type Miss = (&'static str, &'static str, fn(&mut Row, u64));

/// Every strict criterion of a task, missed alone in each of the ways that there are.
fn misses(task: Task) -> Vec<Miss> {
    let mut misses: Vec<Miss> = Vec::new();
    for criterion in task.spec().gate.strict {
        let more: &[Miss] = match criterion.name {
            "upright" => &[("upright", "leans", |row, _| {
                row.robot.pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::y() * 0.6);
            })],
            // Its published gate asks for two bodies already.
            "fresh_bulb_in_grip" if task == Task::S08 => &GRIP_FRESH[..4],
            "carried_by_treads" => &[
                ("carried_by_treads", "in the air", |row, _| {
                    row.load_mut(errand::TREAD_LOAD).copy_from_slice(&[0.0; 4]);
                }),
                ("carried_by_treads", "on one foot", |row, _| {
                    row.load_mut(errand::TREAD_LOAD)[Support::RightFoot as usize] = 19.0;
                }),
                ("carried_by_treads", "one foot, one arm", |row, _| {
                    row.load_mut(errand::TREAD_LOAD).copy_from_slice(&[300.0, 0.0, 30.0, 0.0]);
                }),
                ("carried_by_treads", "hangs by both arms", |row, _| {
                    row.load_mut(errand::TREAD_LOAD).copy_from_slice(&[0.0, 0.0, 200.0, 200.0]);
                }),
                ("carried_by_treads", "stands on the floor", |row, _| {
                    let loads = [errand::TREAD_LOAD, errand::FLOOR_LOAD].map(|load| row.load(load).to_vec());
                    row.load_mut(errand::FLOOR_LOAD).copy_from_slice(&loads[0]);
                    row.load_mut(errand::TREAD_LOAD).copy_from_slice(&loads[1]);
                }),
            ],
            "carried_by_floor" => &[
                ("carried_by_floor", "in the air", |row, _| {
                    row.load_mut(errand::FLOOR_LOAD).copy_from_slice(&[0.0; 4]);
                }),
                ("carried_by_floor", "on one foot", |row, _| {
                    row.load_mut(errand::FLOOR_LOAD).copy_from_slice(&[340.0, 10.0, 0.0, 0.0]);
                }),
                ("carried_by_floor", "half on the ladder", |row, _| {
                    row.load_mut(errand::FLOOR_LOAD).copy_from_slice(&[100.0, 100.0, 0.0, 0.0]);
                }),
                ("carried_by_floor", "on all fours", |row, _| {
                    row.load_mut(errand::FLOOR_LOAD).copy_from_slice(&[90.0, 90.0, 80.0, 80.0]);
                }),
            ],
            "slow" => &[("slow", "walks past", |row, _| row.robot.linear_velocity.x = 0.5)],
            "standing" => &[("standing", "crouches too low", |row, _| {
                row.robot.pose.translation.z = Thresholds::default().fall_height_m;
            })],
            "old_bulb_in_grip" => &GRIP_OLD,
            "fresh_bulb_in_grip" => &GRIP_FRESH,
            "old_bulb_released" => {
                &[("old_bulb_released", "still in the hand", |row, _| touch(row, OLD, RIGHT[0], 3.0))]
            }
            "old_bulb_at_rest" => {
                &[("old_bulb_at_rest", "still rolls", |row, _| row.things[errand::BULBS[OLD]].linear_velocity.x = 0.1)]
            }
            "fresh_bulb_released" => {
                &[("fresh_bulb_released", "still in the hand", |row, _| touch(row, NEW, RIGHT[0], 3.0))]
            }
            "fresh_bulb_settled" => &[("fresh_bulb_settled", "still turns in the socket", |row, step| {
                let turned = rotated([0.0; 3], Vector3::z(), 0.003 * step as f64);
                row.things[errand::BULBS[NEW]].pose = row.things[errand::FIXTURE].pose * turned;
            })],
            "at_ladder_foot" => &[
                ("at_ladder_foot", "on the lowest tread", |row, _| row.robot.pose.translation.z = 0.95),
                ("at_ladder_foot", "elsewhere", |row, _| row.robot.pose.translation.y -= 0.1),
            ],
            other => panic!("{task}: no way to miss {other} in this test"),
        };
        misses.extend(more);
    }
    misses
}

/// Ways to touch a bulb without gripping it.
const GRIP_OLD: [Miss; 5] = grip("old_bulb_in_grip");
const GRIP_FRESH: [Miss; 5] = grip("fresh_bulb_in_grip");

const fn grip(name: &'static str) -> [Miss; 5] {
    fn bulb(row: &Row) -> usize {
        // The one that a hand feels.
        Bulb::ALL
            .into_iter()
            .find(|bulb| row.force(errand::HAND_FORCE[*bulb as usize]).iter().any(|f| f.norm() > 0.0))
            .map_or(0, |b| b as usize)
    }
    [
        (name, "pushed from one side", |row, _| {
            let i = bulb(row);
            let one = row.force(errand::HAND_FORCE[i])[RIGHT[0]];
            row.force_mut(errand::HAND_FORCE[i])[RIGHT[1]] = one;
        }),
        (name, "between both hands", |row, _| {
            let i = bulb(row);
            row.load_mut(errand::HAND_FORCE_PEAK[i])[LEFT] = 2.0;
        }),
        (name, "leans on the body", |row, _| {
            let i = bulb(row);
            row.load_mut(errand::OTHER_FORCE_PEAK[i])[0] = 0.3;
        }),
        (name, "slides through the hand", |row, step| {
            let i = bulb(row);
            row.things[errand::BULBS[i]].pose.translation.z += if step % 2 == 0 { 0.004 } else { 0.0 };
        }),
        (name, "pressed by one body, twice", |row, _| {
            let i = bulb(row);
            row.force_mut(errand::HAND_FORCE[i])[RIGHT[1]] *= 0.1;
            row.force_mut(errand::HAND_FORCE[i])[RIGHT[0]] *= 2.0;
        }),
    ]
}

#[test]
fn each_strict_condition_missed_alone_fails_by_it() {
    for task in Task::ALL {
        for (name, how, change) in misses(task) {
            let judges = play(task, change);
            let [published, strict] = verdicts(&judges);
            assert!(published.success && !published.broken && !published.dropped, "{task}, {how}: {published:?}");
            assert!(!strict.success && !strict.broken && !strict.dropped, "{task}, {how}: {strict:?}");
            assert_eq!(missing(&judges), [name], "{task}, {how}");
            assert!(strict.progress < 1.0, "{task}, {how}");
            assert_eq!(strict.end, None, "{task}, {how}");
        }
    }
}

/// Conditions that no criterion has: the window, and what must not have happened before its end.
#[test]
fn what_is_spoilt_fails_strict_alone() {
    let each = |bulb: usize, change: fn(&mut Row, usize)| {
        move |row: &mut Row, step: u64| {
            if step == 3 {
                change(row, bulb);
            }
        }
    };
    for task in Task::ALL {
        let window = u64::from(task.spec().gate.strict_steps);
        // One row short of the window, then the robot leans for a row, over and over.
        let lasting = play(task, |row, step| {
            if step % window == window - 1 {
                row.robot.pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::y() * 0.6);
            }
        });
        let [published, strict] = verdicts(&lasting);
        assert!(published.success && !strict.success, "{task}: {strict:?}");
        let leapt = play(task, |row, step| row.com_velocity.z = if step == 3 { -2.1 } else { -1.9 });
        let [published, strict] = verdicts(&leapt);
        assert!(published.success && strict.leapt && !strict.success && strict.progress < 1.0, "{task}: {strict:?}");
        for bulb in [OLD, NEW] {
            // The published rule reads the last physics step of the hands alone.
            let pressed = play(task, each(bulb, |row, bulb| row.load_mut(errand::OTHER_FORCE_PEAK[bulb])[0] = 50.5));
            let pinched = play(task, each(bulb, |row, bulb| row.load_mut(errand::HAND_FORCE_PEAK[bulb])[LEFT] = 50.5));
            for judges in [pressed, pinched] {
                let [published, strict] = verdicts(&judges);
                assert!(published.success && !published.broken, "{task}: {published:?}");
                assert!(strict.broken && !strict.success && strict.progress < 1.0, "{task}: {strict:?}");
            }
        }
    }
}

/// A blow whose change of velocity lies on both sides of a row; without a touch it is none.
#[test]
fn blows_break() {
    let fall = Vector3::new(0.0, 0.0, -GRAVITY * 0.02);
    let cases = [(2.0, true, false), (2.6, false, false), (1.3, true, true), (2.6, true, true)];
    for (per_row, touched, breaks) in cases {
        let mut judge =
            Judge::new(Protocol::Strict, Task::S07, Thresholds::default(), geometry(), JudgeOptions::default());
        let start = start_of(Task::S07);
        judge.start(&start);
        for step in 1..20 {
            let mut row = row_at(step, &start);
            // In one row, or 1.3 m/s in each of two.
            let blows = if per_row < 2.0 { 2 } else { 1 };
            let done = step.saturating_sub(9).min(blows) as f64;
            row.things[errand::BULBS[NEW]].linear_velocity = fall * step as f64 + Vector3::x() * per_row * done;
            row.load_mut(errand::OTHER_FORCE_PEAK[NEW])[0] =
                if touched && (10..10 + blows).contains(&step) { 5.0 } else { 0.0 };
            judge.advance(&row);
        }
        assert_eq!(judge.verdict().broken, breaks, "{per_row} m/s a row, touched: {touched}");
    }
}

/// The robot throws the bulb into the crate and falls a moment later: a success of the published S06, none of the strict one.
#[test]
fn who_disposes_of_the_bulb_still_stands_a_second_later() {
    for (falls_after, success) in [(60, false), (98, false), (100, true)] {
        let judges = play(Task::S06, |row, step| {
            if step >= falls_after {
                topple(row);
            }
        });
        let [published, strict] = verdicts(&judges);
        assert!(published.success && published.end.is_some_and(|end| end.step == BEFORE + 49));
        assert_eq!(strict.success, success, "falls after {falls_after}");
        let cause = strict.end.map(|end| end.cause());
        assert_eq!(cause, Some(if success { Cause::Success } else { Cause::Fall }));
    }
}

/// Falling with an open hand is worth nothing, and neither is what holds at the start.
#[test]
fn progress_needs_a_robot_that_stands() {
    for task in Task::ALL {
        let mut judges = judges(task);
        let start = with_palms(start_of(task));
        judges.start(&start);
        for step in 1..120 {
            let mut row = row_at(step, &start);
            row.robot.pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::y() * 0.008 * step as f64);
            // The hands are open, and what was in them falls.
            let_go(&mut row, OLD);
            let_go(&mut row, NEW);
            if let Some(bulb) = task.spec().start.in_hand() {
                let time = 0.02 * step as f64;
                let height = &mut row.things[bulb.thing()].pose.translation.z;
                *height = (*height - 0.5 * GRAVITY * time * time).max(0.04);
            }
            judges.advance(&row);
        }
        let strict = judges.of(Protocol::Strict).verdict();
        assert_eq!((strict.progress, strict.success), (0.0, false), "{task}: {:?}", missing(&judges));
    }
}

/// A task, a criterion that holds from some row on and what makes it hold, and the strict progress that it pays.
type Case<'a> = (Task, &'a str, &'a dyn Fn(&mut Row), f64);

/// Acts possible from the start pay nothing before the goal: no hand on a bulb, foot on a tread or step towards the ladder. Of
/// the full errand, the old bulb in the crate is a goal as well.
#[test]
fn only_goals_are_progress_by_themselves() {
    let pinch: fn(&mut Row, usize) = |row, bulb| {
        touch(row, bulb, RIGHT[0], 6.0);
        touch(row, bulb, RIGHT[1], -6.0);
    };
    let cases: [Case<'_>; 15] = [
        (Task::S02, "carried_by_treads", &stand_on_treads, 0.0),
        (Task::S03, "carried_by_treads", &stand_on_treads, 0.0),
        (Task::S03, "old_bulb_held", &|row| touch(row, OLD, RIGHT[0], 3.0), 0.0),
        (Task::S03, "old_bulb_in_grip", &|row| pinch(row, OLD), 0.0),
        (Task::S04, "carried_by_floor", &stand_on_floor, 0.0),
        (Task::S06, "carried_by_floor", &stand_on_floor, 0.0),
        (Task::S06, "old_bulb_released", &|row| let_go(row, OLD), 0.0),
        (Task::S08, "fresh_bulb_gripped", &|row| pinch(row, NEW), 0.0),
        (Task::S10, "carried_by_treads", &stand_on_treads, 0.0),
        (Task::S11, "carried_by_treads", &stand_on_treads, 0.0),
        (Task::S11, "fresh_bulb_released", &|row| let_go(row, NEW), 0.0),
        (Task::S12, "carried_by_floor", &stand_on_floor, 0.0),
        (Task::Climb, "carried_by_treads", &stand_on_treads, 0.0),
        (Task::Climb, "near_ladder", &|row| row.robot.pose.translation.x += 0.3, 0.0),
        (Task::Replace, "old_bulb_disposed", &|row| put_in_crate(row, OLD), 0.25),
    ];
    for (task, criterion, change, progress) in cases {
        let mut judges = judges(task);
        let start = with_palms(start_of(task));
        judges.start(&start);
        for step in 1..WITH {
            let mut row = row_at(step, &start);
            change(&mut row);
            judges.advance(&row);
        }
        let strict = judges.of(Protocol::Strict).verdict();
        assert!(!missing(&judges).contains(&criterion), "{task}: {criterion} does not hold");
        assert_eq!(strict.progress, progress, "{task}: {criterion}, {strict:?}");
    }
}

/// Each of both judges says what it says alone. Whatever rows come after the published end, its verdict and summary stay those
/// of an episode that stopped there.
#[test]
fn the_published_verdict_is_that_of_an_episode_that_ended_there() {
    let mut draw = Draw(7);
    for task in Task::ALL {
        for episode in 0..20 {
            let (start, goal) = (with_palms(start_of(task)), honest_goal(task));
            let goal_at = 2 + draw.bits() % 60;
            let mut both = judges(task);
            let mut alone = [Protocol::Published, Protocol::Strict]
                .map(|protocol| Judge::new(protocol, task, Thresholds::default(), geometry(), JudgeOptions::default()));
            both.start(&start);
            for judge in &mut alone {
                judge.start(&start);
            }
            for step in 1..240 {
                let mut row = row_at(step, if step < goal_at { &start } else { &goal });
                row.action.iter_mut().for_each(|number| *number = draw.unit());
                for force in hand_forces(&mut row).filter(|force| force.norm() > 0.0) {
                    *force *= 1.0 + 0.5 * draw.unit();
                }
                if draw.one_in(60) {
                    row.robot.pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::y() * 0.7);
                }
                if draw.one_in(200) {
                    topple(&mut row);
                }
                if draw.one_in(150) {
                    row.load_mut(errand::OTHER_FORCE_PEAK[NEW])[0] = 60.0;
                }
                both.advance(&row);
                for judge in alone.iter_mut().filter(|judge| judge.verdict().end.is_none()) {
                    judge.advance(&row);
                }
            }
            for alone in &alone {
                let found = both.of(alone.protocol());
                assert_eq!(found.verdict(), alone.verdict(), "{task} {episode}");
                assert_eq!(found.summary(), alone.summary(), "{task} {episode}");
                let first_met = |judge: &Judge| Cause::ALL.map(|cause| judge.first_met(cause));
                assert_eq!(first_met(found), first_met(alone));
            }
        }
    }
}

/// Criteria that held in row 0 count in the strict way, so they are a part of the state, and not of the judges that take it.
#[test]
fn a_state_has_what_held_at_the_start() {
    let (start, mut leaning) = (with_palms(start_of(Task::S02)), with_palms(start_of(Task::S02)));
    leaning.things[errand::LADDER].pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::y());
    let [mut own, mut other] = [&leaning, &start].map(|row| {
        let mut judges = judges(Task::S02);
        judges.start(row);
        judges
    });
    other.set_state(own.state());
    for step in 1..WITH {
        let row = row_at(step, &start);
        own.advance(&row);
        other.advance(&row);
    }
    // The ladder stood up, which nobody asks for.
    assert_eq!(own.in_force().verdict().progress, 0.0);
    assert_eq!(own.in_force().verdict(), other.in_force().verdict());
}
