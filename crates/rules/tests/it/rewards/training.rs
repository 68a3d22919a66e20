//! The training variants of the twelve subtasks.

use fiatlux_rules::{Cause, Limb, errand};
use nalgebra::Vector3;

use super::*;

const TANH_1: f64 = 0.761_594_155_955_764_9;

/// A task's own term: its weight, a change of the start state, and what the step to the changed state pays.
type Own = (&'static str, f64, fn(&mut Row), f64);

/// Section 1.7 of the reference facts: the terms beyond those that all tasks share.
fn own_terms(task: Task) -> Vec<Own> {
    let up: Own = ("height_gain", 500.0, |r| r.robot.pose.translation.vector.z += 0.3, 3.0);
    let down: Own = ("descent", 500.0, |r| r.robot.pose.translation.vector.z -= 0.25, 2.5);
    let limbs: Own = ("limb_contact", 100.0, |r| load(r, &[Limb::LeftFoot, Limb::RightPalm]), 1.0);
    // The right palm carries.
    let free_limbs: Own = ("limb_contact", 100.0, |r| load(r, &[Limb::LeftFoot, Limb::RightPalm]), 2.0 / 3.0);
    let old_force: Own = ("hand_force", -1e-4, |r| press(r, OLD), -1e-4 * 0.02 * 58.0);
    let fresh_force: Own = ("hand_force", -1e-4, |r| press(r, NEW), -1e-4 * 0.02 * 58.0);
    let part_way_to_ladder: fn(&mut Row) = |r| go_towards(r, r.things[errand::LADDER].pose.translation.vector, 0.5);
    match task {
        Task::S01 => vec![
            ("robot_to_ladder", 500.0, part_way_to_ladder, 5.0),
            ("ladder_to_fixture", 500.0, lift_ladder_to_seat, 10.0),
        ],
        Task::S02 => vec![up, limbs],
        Task::S03 => vec![
            ("hand_to_bulb", 500.0, |r| reach(r, OLD, 0.75), 7.5),
            (
                "old_bulb_removal",
                500.0,
                |r| {
                    r.attachments[OLD].seated = false;
                    r.things[errand::BULBS[OLD]] = body(r.things[errand::FIXTURE].pose * at([0.0, 0.0, 0.04]));
                },
                4.0,
            ),
            old_force,
        ],
        Task::S04 => vec![down, free_limbs, old_force],
        Task::S05 => {
            vec![(
                "robot_to_crate",
                500.0,
                |r| go_towards(r, r.things[errand::CRATE].pose.translation.vector, 0.25),
                2.5,
            )]
        }
        Task::S06 => vec![(
            "bulb_to_crate",
            500.0,
            |r| {
                let goal = r.things[errand::CRATE].pose.translation.vector;
                let bulb = &mut r.things[errand::OLD_BULB].pose.translation.vector;
                *bulb = bulb.lerp(&goal, 0.5);
            },
            5.0,
        )],
        Task::S07 => vec![(
            "robot_to_bulb",
            500.0,
            |r| go_towards(r, r.things[errand::BULBS[NEW]].pose.translation.vector, 0.75),
            7.5,
        )],
        Task::S08 => vec![
            ("hand_to_bulb", 500.0, |r| reach(r, NEW, 0.5), 5.0),
            // The largest force on one body, of either hand.
            (
                "grip",
                100.0,
                |r| {
                    touch(r, NEW, LEFT, 10.0);
                    touch(r, NEW, RIGHT[0], 9.0);
                },
                2.0 * TANH_1,
            ),
            fresh_force,
        ],
        Task::S09 => vec![("robot_to_ladder", 500.0, part_way_to_ladder, 5.0)],
        Task::S10 => vec![up, free_limbs, fresh_force],
        Task::S11 => vec![
            (
                "fresh_bulb_to_seat",
                500.0,
                |r| r.things[errand::BULBS[NEW]] = body(r.things[errand::FIXTURE].pose),
                10.0,
            ),
            // 0.3 rad off the axis in place of a start that is far off; turning about the axis costs nothing.
            (
                "axis_alignment",
                100.0,
                |r| r.things[errand::BULBS[NEW]].pose.rotation = off_axis(r, 0.3),
                2.0 * (1.0 - TANH_1) - 2.0 * (1.0 - libm::tanh((std::f64::consts::PI - 1.2) / 0.3)),
            ),
            fresh_force,
        ],
        Task::S12 => vec![down, limbs],
        Task::Replace | Task::Climb => Vec::new(),
    }
}

/// Weights of the terms that all tasks share, besides the charges for failures.
const SHARED: [(&str, f64); 9] = [
    ("gate_progress", 1.0),
    ("success_bonus", 500.0),
    ("com_sway", -0.5),
    ("ang_vel_xy", -0.05),
    ("action_rate", -0.005),
    ("joint_acceleration", -1.25e-7),
    ("ankle_limits", -1.0),
    ("waist_deviation", -0.1),
    ("finger_deviation", -0.05),
];

/// Failures that end a task, which it charges 200 for.
fn charges(task: Task) -> &'static [&'static str] {
    match task {
        Task::S01 | Task::S02 => &["robot_fall", "ladder_tipped"],
        Task::S03 | Task::S04 | Task::S10 | Task::S11 => {
            &["robot_fall", "ladder_tipped", "bulb_crushed", "bulb_dropped"]
        }
        Task::S05 | Task::S06 => &["robot_fall", "bulb_crushed"],
        Task::S07 => &["robot_fall"],
        Task::S08 => &["robot_fall", "bulb_dropped"],
        Task::S09 => &["robot_fall", "ladder_tipped", "bulb_crushed"],
        Task::S12 => &["robot_fall", "ladder_tipped", "bulb_unseated"],
        Task::Replace | Task::Climb => &[],
    }
}

fn load(row: &mut Row, limbs: &[Limb]) {
    limbs.iter().for_each(|limb| row.force_mut(errand::LADDER_FORCE)[*limb as usize] = Vector3::new(0.0, 0.0, 50.0));
}

/// A bulb presses on either hand by 3 N and 7 N, and the other bulb harder.
fn press(row: &mut Row, bulb: usize) {
    hand_forces(row).for_each(|force| force.fill(0.0));
    touch(row, bulb, RIGHT[0], 3.0);
    touch(row, bulb, LEFT, 7.0);
    touch(row, 1 - bulb, LEFT, 9.0);
}

/// Part of the way over the floor, and upwards, which is not an approach.
fn go_towards(row: &mut Row, goal: Vector3<f64>, part: f64) {
    let place = &mut row.robot.pose.translation.vector;
    let height = place.z;
    *place = place.lerp(&goal, part);
    place.z = height + 0.1;
}

/// The right palm part of its way to a bulb's root, the left one there.
fn reach(row: &mut Row, bulb: usize, part: f64) {
    let goal = row.things[errand::BULBS[bulb]].pose.translation.vector;
    let [left, right] = &mut row.world_from_palm;
    left.translation.vector = goal;
    right.translation.vector = right.translation.vector.lerp(&goal, part);
}

fn off_axis(row: &Row, angle: f64) -> nalgebra::UnitQuaternion<f64> {
    let twist = rotated([0.0; 3], Vector3::z(), 2.0);
    (row.things[errand::FIXTURE].pose * rotated([0.0; 3], Vector3::x(), angle) * twist).rotation
}

#[test]
fn own_terms_are_their_closed_forms() {
    for task in Task::SUBTASKS {
        for (name, _, change, pays) in own_terms(task) {
            let start = start_of(task);
            let mut after = start.clone();
            change(&mut after);
            let meter = play(task, Variant::Training, &[&start, &after]);
            assert!(close(meter.paid(name), pays), "{task} {name}: {} for {pays}", meter.paid(name));
        }
    }
}

/// No task has a term that it should not have, or lacks one, or weighs it otherwise.
#[test]
fn terms_and_weights_are_those_of_the_table() {
    for task in Task::SUBTASKS {
        let rewards = Rewards::new(&judge(task), Variant::Training, joint_groups());
        let mut terms: Vec<_> = rewards.terms().iter().map(|term| (term.name, term.weight)).collect();
        let mut expected = SHARED.to_vec();
        expected.extend(charges(task).iter().chain(&["diverged"]).map(|name| (*name, -200.0)));
        expected.extend(own_terms(task).iter().map(|(name, weight, _, _)| (*name, *weight)));
        for list in [&mut terms, &mut expected] {
            list.sort_by(|a, b| a.0.cmp(b.0));
        }
        assert_eq!(terms, expected, "{task}");
        // The benchmark shapes nothing.
        let rewards = Rewards::new(&judge(task), Variant::Benchmark, joint_groups());
        assert!(rewards.terms().iter().map(|term| term.name).eq(["gate_progress"]), "{task}");
    }
}

/// Each failure is charged 4 on the step that it ends, and no row after that pays it again.
#[test]
fn failures_are_charged_once() {
    for task in Task::SUBTASKS {
        for name in charges(task).iter().chain(&["diverged"]) {
            let start = start_of(task);
            let mut bad = start.clone();
            match *name {
                "robot_fall" => topple(&mut bad),
                "ladder_tipped" => lean_ladder(&mut bad),
                "bulb_crushed" => [OLD, NEW].into_iter().for_each(|bulb| touch(&mut bad, bulb, LEFT, 50.5)),
                "bulb_dropped" => {
                    errand::BULBS.into_iter().for_each(|bulb| bad.things[bulb] = body(at([0.0, 1.0, 0.14])));
                }
                "bulb_unseated" => bad.attachments[NEW].seated = false,
                "diverged" => bad.joint_speed_peak = 201.0,
                other => panic!("{other}"),
            }
            if *name == "bulb_dropped" {
                bad.attachments[OLD].seated = false;
            }
            let mut meter = Meter::new(task, Variant::Training, &start);
            for (step, state) in (1..).zip([&start, &start, &bad, &bad, &start, &bad]) {
                meter.show(&row_at(step, state));
                assert_eq!(meter.last(name), if step == 3 { -4.0 } else { 0.0 }, "{task} {name} {step}");
            }
        }
    }
}

/// A session that ends on other conditions charges those.
#[test]
fn charges_follow_what_ends_the_task() {
    let options = JudgeOptions { end_on: Some(Causes::of(&[Cause::Impact])), ..JudgeOptions::default() };
    let rewards = Rewards::new(&judge_with(Task::S11, options), Variant::Training, joint_groups());
    let charged = rewards.terms().iter().filter(|term| term.weight == -200.0).map(|term| term.name);
    assert!(charged.eq(["diverged", "bulb_impact"]));
}

/// Either variant pays gate progress as it is, 1 for a run that ends in the goal, and the training variant the bonus.
#[test]
fn progress_is_paid_unscaled() {
    for task in Task::SUBTASKS {
        let (start, goal) = (start_of(task), goal_of(task));
        let states: Vec<&Row> = std::iter::once(&start).chain(std::iter::repeat_n(&goal, 60)).collect();
        assert_eq!(play(task, Variant::Benchmark, &states).paid, [("gate_progress", 1.0)], "{task}");
        let meter = play(task, Variant::Training, &states);
        assert!(close(meter.paid("gate_progress"), 1.0) && meter.paid("success_bonus") == 10.0, "{task}");
    }
}
