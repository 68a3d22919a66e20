//! Rewards against closed forms, and the bound of the full errand.

mod common;

use common::*;
use fiatlux_rules::{Cause, Causes, JudgeOptions, Limb, Rewards, Row, Task, Variant};
use nalgebra::Vector3;

/// Sums of each term over rows 1 and on, with an episode that nothing ends.
fn sums_without_ends(task: Task, variant: Variant, rows: &[Row]) -> Vec<(&'static str, f64)> {
    let mut judge = judge_with(task, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
    let mut rewards = Rewards::new(&judge, variant);
    judge.start(&rows[0]);
    rewards.start(&judge, &rows[0]);
    let mut sums: Vec<_> = rewards.terms().iter().map(|term| (term.name, 0.0)).collect();
    for row in &rows[1..] {
        judge.advance(row);
        for ((_, sum), term) in sums.iter_mut().zip(rewards.advance(&judge, row)) {
            *sum += term.reward;
        }
    }
    sums
}

fn sum_of(sums: &[(&'static str, f64)], name: &str) -> f64 {
    sums.iter().find(|(n, _)| *n == name).unwrap_or_else(|| panic!("no term {name} in {sums:?}")).1
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

fn episode(states: &[&Row]) -> Vec<Row> {
    states.iter().enumerate().map(|(k, state)| row_at(k as u64, state)).collect()
}

/// A run without a flaw: each term is its closed form. The ladder's top point ends 0.38 m beside and 0.98 m below the
/// seat, so its progress stays short of 5; all else is paid in full.
#[test]
fn perfect_errand() {
    let start = start_of(Task::Replace);
    let mut placed = start.clone();
    placed.ladder = body(at(LADDER));
    let mut removed = placed.clone();
    stand_on_platform(&mut removed);
    take(&mut removed, OLD);
    let_go(&mut removed, OLD); // The grip's penalty is another test's.
    let mut disposed = placed.clone();
    put_in_crate(&mut disposed, OLD);
    let mut done = disposed.clone();
    put_in_socket(&mut done, NEW);
    let sums = sums_without_ends(
        Task::Replace,
        Variant::Benchmark,
        &episode(&[&start, &placed, &removed, &disposed, &done, &done]),
    );

    let seat = Vector3::new(FIXTURE[0], FIXTURE[1], FIXTURE[2] - 0.036259);
    let top = |row: &Row| (row.ladder.pose * nalgebra::Point3::new(0.0, 0.1, 1.18)).coords;
    let (far, near) = ((top(&start) - seat).norm(), (top(&done) - seat).norm());
    assert!(close(near, Vector3::new(0.0, 0.38, 2.2 - 0.036259 - 1.18).norm()), "{near}");
    assert!(close(sum_of(&sums, "ladder_progress"), 5.0 * (1.0 - near / far)));
    assert!(close(sum_of(&sums, "fresh_bulb_progress"), 10.0));
    assert!(close(sum_of(&sums, "old_bulb_removal"), 5.0));
    // It ends beside the crate's origin, from where a seated bulb's root is.
    let (seated, resting) = (Vector3::new(4.0, 0.48, 2.2).norm(), Vector3::new(0.0, 0.11, 0.0436).norm());
    assert!(close(sum_of(&sums, "old_bulb_disposal_progress"), 10.0 * (1.0 - resting / seated)));
    for (name, bonus) in [
        ("ladder_ready", 2.0),
        ("fresh_bulb_inserted", 5.0),
        ("old_bulb_removed", 3.0),
        ("old_bulb_disposed", 5.0),
        ("success_bonus", 10.0),
    ] {
        assert!(close(sum_of(&sums, name), bonus), "{name}");
    }
    let penalties: f64 = sums[9..].iter().map(|(_, sum)| sum).sum();
    assert_eq!((sums[9].0, penalties), ("robot_fall", 0.0));
}

#[test]
fn failures_of_the_errand_are_charged_once() {
    let start = start_of(Task::Replace);
    let mut bad = start.clone();
    topple(&mut bad);
    lean_ladder_at_root(&mut bad);
    bad.bulbs[NEW].pose = at([0.0, 0.0, 0.3]);
    bad.bulbs[OLD].pose = at([0.0, 0.0, 0.1]);
    bad.attachments[OLD].seated = false;
    let sums = sums_without_ends(Task::Replace, Variant::Benchmark, &episode(&[&start, &bad, &start, &bad]));
    for (name, charge) in
        [("robot_fall", -4.0), ("ladder_tipped", -4.0), ("fresh_bulb_dropped", -2.0), ("old_bulb_dropped", -2.0)]
    {
        assert!(close(sum_of(&sums, name), charge), "{name}");
    }
}

/// No sequence of rows earns more than 55, at no time; the states are drawn among goals, starts and anywhere, and some
/// numbers are not numbers.
#[test]
fn errand_never_exceeds_its_bound() {
    let mut draw = Draw(55);
    let mut best: f64 = 0.0;
    for _ in 0..150 {
        let mut judge =
            judge_with(Task::Replace, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
        let mut rewards = Rewards::new(&judge, Variant::Benchmark);
        let mut sum = 0.0;
        let calm = draw.one_in(2);
        for step in 0..60 {
            let mut row = draw.row(step);
            if calm {
                // Nothing but the props moves, and the goals are often met.
                row = Row { ladder: row.ladder, bulbs: row.bulbs, attachments: row.attachments, ..room() };
                row.step = step;
                if draw.one_in(3) {
                    // The top point in the seat: no robot does it, but no row may be paid more.
                    row.ladder.pose = at([FIXTURE[0], FIXTURE[1] - 0.1, FIXTURE[2] - 0.036259 - 1.18]);
                }
                if draw.one_in(3) {
                    row.bulbs[NEW] = body(fixture());
                }
                if draw.one_in(3) {
                    put_in_crate(&mut row, OLD);
                    row.bulbs[OLD].pose.translation.vector.z = 0.0401;
                }
            }
            if draw.one_in(10) {
                row.ladder.pose.translation.vector.x = draw.junk();
            }
            if draw.one_in(10) {
                row.bulbs[NEW].pose.translation.vector.z = draw.junk();
            }
            if step == 0 {
                judge.start(&row);
                rewards.start(&judge, &row);
                continue;
            }
            judge.advance(&row);
            rewards.advance(&judge, &row);
            sum += rewards.reward();
            assert!(sum <= 55.0 + 1e-9, "{sum} at {step}");
            best = best.max(sum);
        }
    }
    assert!(best > 40.0, "the draw never comes near the bound: {best}");
}

/// Over any path the payments of a potential add up to its change between the ends.
#[test]
fn potentials_telescope() {
    let mut draw = Draw(3);
    for _ in 0..50 {
        let rows: Vec<Row> = (0..40).map(|step| draw.row(step)).collect();
        let sums = sums_without_ends(Task::Replace, Variant::Benchmark, &rows);
        let seat = |row: &Row| (row.fixture * nalgebra::Point3::new(0.0, 0.0, 0.036259)).coords;
        let ladder = |row: &Row| ((row.ladder.pose * nalgebra::Point3::new(0.0, 0.1, 1.18)).coords - seat(row)).norm();
        let fresh =
            |row: &Row| ((row.bulbs[NEW].pose * nalgebra::Point3::new(0.0, 0.0, 0.036259)).coords - seat(row)).norm();
        let last = &rows[39];
        let gained = |first: f64, last: f64| ((first - last) / first).max(0.0);
        assert!(close(sum_of(&sums, "ladder_progress"), 5.0 * gained(ladder(&rows[0]), ladder(last))));
        assert!(close(sum_of(&sums, "fresh_bulb_progress"), 10.0 * gained(fresh(&rows[0]), fresh(last))));
    }
}

/// Arrival is worth the same from near and far; a step back costs what the step forth paid; standing pays nothing.
#[test]
fn approach() {
    for distance in [0.5, 1.0, 4.0] {
        let away = |part: f64| {
            let mut row = start_of(Task::S05);
            row.robot.pose.translation.vector = Vector3::new(CRATE[0] + part * distance, CRATE[1], 0.79);
            row
        };
        let rows = episode(&[&away(1.0), &away(0.5), &away(0.75), &away(0.75), &away(2.0), &away(0.0)]);
        let mut judge = judge_with(Task::S05, JudgeOptions { end_on: Some(Causes::NONE), ..JudgeOptions::default() });
        let mut rewards = Rewards::new(&judge, Variant::Training);
        judge.start(&rows[0]);
        rewards.start(&judge, &rows[0]);
        let mut paid = Vec::new();
        for row in &rows[1..] {
            judge.advance(row);
            let terms = rewards.advance(&judge, row);
            paid.extend(terms.iter().filter(|term| term.name == "robot_to_crate").map(|term| term.reward));
        }
        // Farther than the start is no worse than the start.
        let expected = [5.0, -2.5, 0.0, -2.5, 10.0];
        assert!(paid.iter().zip(expected).all(|(a, b)| close(*a, b)), "{distance}: {paid:?}");
    }
}

#[test]
fn subtask_pays_its_progress_unscaled() {
    for task in Task::SUBTASKS {
        let rows: Vec<Row> = (0..60).map(|k| row_at(k, &if k == 0 { start_of(task) } else { goal_of(task) })).collect();
        let sums = sums_without_ends(task, Variant::Benchmark, &rows);
        assert_eq!(sums, [("gate_progress", 1.0)], "{task}");
        // The training variant pays it too, and the bonus.
        let sums = sums_without_ends(task, Variant::Training, &rows);
        assert!(close(sum_of(&sums, "gate_progress"), 1.0) && close(sum_of(&sums, "success_bonus"), 10.0), "{task}");
    }
}

/// A failure is charged where it ends the task.
#[test]
fn training_charges_the_failures_that_end_a_task() {
    let charged = |task, options| {
        let rewards = Rewards::new(&judge_with(task, options), Variant::Training);
        let terms = rewards.terms().iter().filter(|term| term.weight == -200.0);
        terms.map(|term| term.name).collect::<Vec<_>>()
    };
    let usual = JudgeOptions::default();
    assert_eq!(charged(Task::S07, usual), ["robot_fall"]);
    assert_eq!(charged(Task::S12, usual), ["robot_fall", "ladder_tipped", "bulb_unseated"]);
    assert_eq!(charged(Task::S11, usual), ["robot_fall", "ladder_tipped", "bulb_crushed", "bulb_dropped"]);
    let struck = JudgeOptions { end_on: Some(Causes::of(&[Cause::Struck])), ..usual };
    assert_eq!(charged(Task::S11, struck), ["bulb_struck"]);
}

/// New heights pay once, and a second ascent over old ground nothing.
#[test]
fn climbing_pays_each_centimetre_once() {
    let at_height = |z: f64| {
        let mut row = start_of(Task::Climb);
        row.robot.pose.translation.vector.z = z;
        row.limb_force[Limb::LeftFoot as usize].z = 200.0;
        row.limb_force[Limb::RightPalm as usize].z = 0.9;
        row
    };
    let start = at_height(0.79);
    let rows = episode(&[&start, &at_height(1.2), &at_height(0.9), &at_height(1.2), &at_height(1.3)]);
    let sums = sums_without_ends(Task::Climb, Variant::Benchmark, &rows);
    assert!(close(sum_of(&sums, "height_gain"), 500.0 * 0.02 * 0.51));
    assert!(close(sum_of(&sums, "limb_contact"), 4.0 * 0.25 * 0.02 * 0.25));
}

/// One step of each penalty on motion.
#[test]
fn motion_penalties() {
    let before = start_of(Task::Climb);
    let mut row = row_at(1, &before);
    row.com_velocity = Vector3::new(0.3, -0.4, 9.0);
    // Turned by a quarter about x: the world's z is the pelvis's y.
    row.robot.pose = turned([0.0, 0.0, 0.9], Vector3::x(), std::f64::consts::FRAC_PI_2);
    row.robot.angular_velocity = Vector3::new(2.0, 5.0, 1.0);
    row.action[7] = 2.0;
    row.joint_velocity[3] = 0.2;
    row.joint_velocity[4] = 9.0;
    row.joint_position[5] = -0.2618;
    row.joint_position[11] = 0.23;
    row.joint_position[13] = -0.3;
    row.joint_position[28] = 1.0;
    row.joint_position[29] = 0.5;
    row.joint_position[52] = -0.25;
    let sums = sums_without_ends(Task::Climb, Variant::Benchmark, &[before, row]);
    for (name, value) in [
        ("com_sway", -0.5 * 0.25),
        ("ang_vel_xy", -0.05 * 5.0),
        ("action_rate", -0.005 * 4.0),
        ("joint_acceleration", -1.25e-7 * 100.0),
        ("ankle_limits", -0.1 * 0.2618),
        ("waist_deviation", -0.1 * 0.3),
        ("finger_deviation", -0.05 * 0.75),
    ] {
        assert!(close(sum_of(&sums, name), 0.02 * value), "{name}: {}", sum_of(&sums, name));
    }
}

/// The right hand's bodies feel both bulbs; the left hand's do not count in the errand.
#[test]
fn force_penalties() {
    let start = start_of(Task::Replace);
    let mut row = row_at(1, &start);
    row.hand_force[OLD][3] = Vector3::new(3.0, 0.0, 0.0);
    row.hand_force[NEW][3] = Vector3::new(-1.0, 4.0, 0.0);
    row.hand_force[NEW][LEFT] = Vector3::new(0.0, 7.0, 0.0);
    let sums = sums_without_ends(Task::Replace, Variant::Benchmark, &[start, row.clone()]);
    assert!(close(sum_of(&sums, "contact_penalty"), -1e-3 * 0.02 * 20.0));
    let sums = sums_without_ends(Task::S11, Variant::Training, &[start_of(Task::Replace), row]);
    assert!(close(sum_of(&sums, "hand_force"), -1e-4 * 0.02 * (17.0 + 49.0)));
}

#[test]
fn hints_of_the_training_variants() {
    let hint = |task: Task, name: &str, change: fn(&mut Row)| {
        let mut row = start_of(task);
        let_go(&mut row, NEW);
        row.bulbs[NEW] = body(row.fixture * at([0.0, 0.0, 0.3]));
        let mut after = row_at(1, &row);
        change(&mut after);
        sum_of(&sums_without_ends(task, Variant::Training, &[row, after]), name)
    };
    let tilt = hint(Task::S11, "axis_alignment", |row| {
        row.bulbs[NEW].pose = row.fixture * turned([0.0, 0.0, 0.3], Vector3::x(), 0.3);
    });
    assert!(close(tilt, -2.0 * libm::tanh(1.0)), "{tilt}");
    let grip = hint(Task::S08, "grip", |row| touch(row, NEW, LEFT, 10.0));
    assert!(close(grip, 2.0 * libm::tanh(1.0)), "{grip}");
    let loaded: fn(&mut Row) = |row| row.limb_force = [Vector3::new(0.0, 0.0, 50.0); 4];
    assert!(close(hint(Task::S02, "limb_contact", loaded), 2.0));
    let one_foot: fn(&mut Row) = |row| row.limb_force[Limb::RightFoot as usize].z = 50.0;
    assert!(close(hint(Task::S02, "limb_contact", one_foot), 0.5));
    assert!(close(hint(Task::S10, "limb_contact", one_foot), 2.0 / 3.0));
    let lower: fn(&mut Row) = |row| row.robot.pose.translation.vector.z -= 0.25;
    assert!(close(hint(Task::S12, "descent", lower), 2.5));
    let reach: fn(&mut Row) = |row| row.palm_position[1] = row.bulbs[NEW].pose.translation.vector;
    assert!(close(hint(Task::S08, "hand_to_bulb", reach), 10.0));
}
