//! Each figure of the published table, from a hair inside to a hair outside.

use crate::common::*;
use fiatlux_rules::{Row, Task, errand};
use nalgebra::Vector3;

/// A task, a criterion, a change of the goal state by a measure, and that measure inside and outside the limit.
type Limit = (Task, &'static str, fn(&mut Row, f64), f64, f64);

/// The pelvis at a horizontal distance from a point, facing it, at its height.
fn stand_off(row: &mut Row, point: [f64; 3], distance: f64) {
    let z = row.robot.pose.translation.vector.z;
    row.robot.pose = at([point[0] - 0.6 * distance, point[1] - 0.8 * distance, z]) * heading(libm::atan2(0.8, 0.6));
}

fn heading(yaw: f64) -> nalgebra::Isometry3<f64> {
    rotated([0.0; 3], Vector3::z(), yaw)
}

fn limits() -> Vec<Limit> {
    use Task::*;
    vec![
        (
            S01,
            "ladder_placed",
            |r, d| r.things[errand::LADDER].pose = at([FIXTURE[0] + d, FIXTURE[1] - 0.1, 0.0]),
            0.669,
            0.671,
        ),
        (S01, "ladder_feet_down", |r, z| r.things[errand::LADDER].pose.translation.vector.z = z, 0.0199, 0.0201),
        (S01, "ladder_feet_down", |r, z| r.things[errand::LADDER].pose.translation.vector.z = z, -0.0199, -0.0201),
        (
            S01,
            "ladder_at_rest",
            |r, v| r.things[errand::LADDER].linear_velocity = Vector3::new(0.6 * v, 0.0, 0.8 * v),
            0.0499,
            0.0501,
        ),
        (
            S01,
            "ladder_at_rest",
            |r, w| r.things[errand::LADDER].angular_velocity = Vector3::new(0.0, 0.6 * w, 0.8 * w),
            0.099,
            0.101,
        ),
        (S01, "standing", |r, z| r.robot.pose.translation.vector.z = z, 0.351, 0.349),
        (S01, "standing", |r, a| r.robot.pose = rotated([0.0, 0.0, 0.8], Vector3::x(), a), 0.999, 1.001),
        (S02, "at_ladder_top", |r, z| r.robot.pose.translation.vector.z = z, 1.0301, 1.0299),
        (S02, "at_ladder_top", |r, d| stand_off(r, [2.0, 1.1, 0.0], d), 0.599, 0.601),
        (S02, "at_ladder_top", |r, v| r.robot.linear_velocity.y = v, 1.499, 1.501),
        (S02, "ladder_upright", |r, a| r.things[errand::LADDER].pose = rotated(LADDER, Vector3::y(), a), 0.599, 0.601),
        (
            S03,
            "old_bulb_removed",
            |r, d| r.things[errand::BULBS[OLD]].pose = r.things[errand::FIXTURE].pose * at([0.0, 0.0, d]),
            0.1001,
            0.0999,
        ),
        (S03, "old_bulb_held", |r, f| r.force_mut(errand::HAND_FORCE[OLD]).fill(Vector3::x() * f), 1.001, 0.999),
        (S03, "old_bulb_elevated", |r, z| r.things[errand::BULBS[OLD]].pose.translation.vector.z = z, 0.1501, 0.1499),
        (S04, "at_ladder_foot", |r, z| r.robot.pose.translation.vector.z = z, 0.9399, 0.9401),
        (S04, "at_ladder_foot", |r, d| stand_off(r, LADDER, d), 0.599, 0.601),
        // From the crate's side at 0.3007 m from its centre, and from its corner.
        (S05, "near_crate", |r, d| r.robot.pose = at([CRATE[0] - 0.3007 - d, CRATE[1], 0.79]), 0.499, 0.501),
        (
            S05,
            "near_crate",
            |r, d| r.robot.pose = at([CRATE[0] - 0.3007 - 0.6 * d, CRATE[1] - 0.2009 - 0.8 * d, 0.79]),
            0.499,
            0.501,
        ),
        (S05, "facing_crate", |r, a| r.robot.pose = at([-3.0, 1.0, 0.79]) * heading(a), 0.499, 0.501),
        (S05, "facing_crate", |r, a| r.robot.pose = at([-3.0, 1.0, 0.79]) * heading(a), -0.499, -0.501),
        (S05, "walking_slowly", |r, v| r.robot.linear_velocity.x = v, 0.999, 1.001),
        // The bulb reaches 0.19267 m along its axis, which lies along the crate's y; the wall is at 0.1876 m and gives
        // 1 mm.
        (
            S06,
            "old_bulb_in_crate",
            |r, y| r.things[errand::BULBS[OLD]].pose.translation.vector.y = CRATE[1] + y,
            0.0042,
            0.0039,
        ),
        (
            S06,
            "old_bulb_in_crate",
            |r, z| r.things[errand::BULBS[OLD]].pose = at([-2.0, 1.0, z - 0.19267]),
            0.1699,
            0.1701,
        ),
        (S06, "old_bulb_at_rest", |r, v| r.things[errand::BULBS[OLD]].linear_velocity.z = v, 0.0499, 0.0501),
        (S06, "old_bulb_released", |r, f| touch(r, OLD, LEFT, f), 0.999, 1.001),
        (S07, "near_fresh_bulb", |r, d| stand_off(r, FRESH, d), 0.629, 0.631),
        // It stands on its cap.
        (
            S08,
            "fresh_bulb_lifted",
            |r, z| r.things[errand::BULBS[NEW]].pose = at([0.0, 0.0, 0.9941 - 0.036259 + z]),
            0.0301,
            0.0299,
        ),
        (S08, "fresh_bulb_gripped", |r, f| touch(r, NEW, RIGHT[1], f), 1.001, 0.999),
        (S08, "fresh_bulb_handled_gently", |r, f| touch(r, NEW, RIGHT[1], f), 49.99, 50.01),
        (S09, "near_ladder", |r, d| stand_off(r, LADDER, d), 0.849, 0.851),
        (S10, "fresh_bulb_elevated", |r, z| r.things[errand::BULBS[NEW]].pose.translation.vector.z = z, 0.4001, 0.3999),
        (Climb, "at_working_height", |r, z| r.robot.pose.translation.vector.z = z, 1.8201, 1.8199),
        (Climb, "near_ladder", |r, d| stand_off(r, [1.6, 0.0, 0.0], d), 0.599, 0.601),
    ]
}

#[test]
fn figures_of_the_table() {
    for (task, criterion, change, inside, outside) in limits() {
        for (value, expected) in [(inside, true), (outside, false)] {
            let mut row = row_at(1, &goal_of(task));
            change(&mut row, value);
            let mut judge = judge(task);
            judge.start(&start_of(task));
            let criteria = judge.advance(&row).criteria;
            let position = task.spec().gate.criteria.iter().position(|c| c.name == criterion).expect(criterion);
            assert_eq!(criteria.as_slice()[position], expected, "{task} {criterion} at {value}");
        }
    }
}
