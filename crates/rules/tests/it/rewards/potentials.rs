//! Potentials and records: what they pay is the way between two rows, whatever lies between.

use fiatlux_rules::errand;
use nalgebra::{Point3, Vector3};

use super::*;

const SEAT: Point3<f64> = Point3::new(0.0, 0.0, 0.036259);
const TOP: Point3<f64> = Point3::new(0.0, 0.1, 1.18);

/// A term, and what it pays between the first and the last row.
type Potential = (&'static str, fn(&Row, &Row) -> f64);

/// The four potentials of the errand.
fn errand_potentials() -> [Potential; 4] {
    fn approached(first: f64, last: f64) -> f64 {
        (1.0 - last / first).max(0.0)
    }
    fn ladder(row: &Row) -> f64 {
        (row.things[errand::LADDER].pose * TOP - row.things[errand::FIXTURE].pose * SEAT).norm()
    }
    fn plug(row: &Row, bulb: usize) -> f64 {
        (row.things[errand::BULBS[bulb]].pose * SEAT - row.things[errand::FIXTURE].pose * SEAT).norm()
    }
    fn clearance(row: &Row) -> f64 {
        if row.attachments[OLD].seated { 0.0 } else { (10.0 * plug(row, OLD)).min(1.0) }
    }
    fn from_crate(row: &Row) -> f64 {
        let root = if row.attachments[OLD].seated {
            row.things[errand::FIXTURE].pose
        } else {
            row.things[errand::BULBS[OLD]].pose
        };
        (root.translation.vector - row.things[errand::CRATE].pose.translation.vector).norm()
    }
    [
        ("ladder_progress", |first, last| 5.0 * approached(ladder(first), ladder(last))),
        ("fresh_bulb_progress", |first, last| 10.0 * approached(plug(first, NEW), plug(last, NEW))),
        ("old_bulb_removal", |first, last| 5.0 * (clearance(last) - clearance(first))),
        ("old_bulb_disposal_progress", |first, last| 10.0 * approached(from_crate(first), from_crate(last))),
    ]
}

/// Names of the training variants' terms that are differences of a potential.
const TRAINING_POTENTIALS: [&str; 11] = [
    "robot_to_ladder",
    "ladder_to_fixture",
    "limb_contact",
    "hand_to_bulb",
    "old_bulb_removal",
    "robot_to_crate",
    "bulb_to_crate",
    "robot_to_bulb",
    "grip",
    "fresh_bulb_to_seat",
    "axis_alignment",
];

/// Everything anywhere; the old bulb often near the seat, where its removal is in progress.
fn anywhere(draw: &mut Draw, step: u64) -> Row {
    let mut row = draw.row(step);
    if !draw.one_in(3) {
        row.things[errand::BULBS[OLD]].pose = row.things[errand::FIXTURE].pose * at([0.0, 0.0, 0.12 * draw.unit()]);
    }
    row
}

/// At every row of any path the payments add up to the change of the potential since row 0, however often bulbs are
/// seated and freed on the way.
#[test]
fn sums_telescope() {
    let mut draw = Draw(3);
    let mut moved = [0; 4];
    for _ in 0..500 {
        let first = anywhere(&mut draw, 0);
        let mut meter = Meter::endless(Task::Replace, Variant::Benchmark, &first);
        for step in 1..60 {
            let row = anywhere(&mut draw, step);
            meter.show(&row);
            for (count, (name, expected)) in moved.iter_mut().zip(errand_potentials()) {
                let expected = expected(&first, &row);
                assert!(close(meter.paid(name), expected), "{name} at {step}: {} for {expected}", meter.paid(name));
                *count += u64::from(expected.abs() > 0.1);
            }
        }
    }
    assert!(moved.iter().all(|count| *count > 3_000), "{moved:?}");
}

#[test]
fn round_trips_pay_nothing() {
    let mut draw = Draw(4);
    let mut seen = std::collections::BTreeMap::new();
    for task in Task::ALL {
        for _ in 0..50 {
            let first = start_of(task);
            let mut meter = Meter::endless(task, Variant::Training, &first);
            for step in 1..40 {
                let goal = row_at(step, &goal_of(task));
                meter.show(&if draw.one_in(4) { goal } else { draw.row(step) });
                for (name, paid) in &meter.paid {
                    let most = seen.entry(*name).or_insert(0.0_f64);
                    *most = most.max(paid.abs());
                }
            }
            meter.show(&row_at(40, &first));
            for (name, paid) in &meter.paid {
                assert!(!is_potential(task, name) || close(*paid, 0.0), "{task} {name}: {paid}");
            }
        }
    }
    for name in TRAINING_POTENTIALS.into_iter().chain(errand_potentials().map(|(name, _)| name)) {
        assert!(seen[name] > 0.1, "the draw leaves {name} where it was: {}", seen[name]);
    }
}

fn is_potential(task: Task, name: &str) -> bool {
    match task {
        // `climb` pays each step for limbs, and a record of heights.
        Task::Climb => false,
        Task::Replace => errand_potentials().iter().any(|(potential, _)| *potential == name),
        _ => TRAINING_POTENTIALS.contains(&name),
    }
}

/// A step back costs to the bit what the same step forth paid.
#[test]
fn retreat_pays_the_negative_of_the_advance() {
    let start = start_of(Task::Replace);
    let mut near = start.clone();
    near.things[errand::LADDER].pose.translation.vector += Vector3::new(1.1, -0.3, 0.0);
    near.things[errand::BULBS[NEW]].pose.translation.vector += Vector3::new(0.9, 0.7, 0.4);
    near.attachments[OLD].seated = false;
    near.things[errand::BULBS[OLD]] = body(near.things[errand::FIXTURE].pose * at([0.0, 0.0, 0.07]));
    let mut nearer = near.clone();
    nearer.things[errand::LADDER].pose.translation.vector += Vector3::new(0.7, -0.2, 0.0);
    nearer.things[errand::BULBS[NEW]].pose.translation.vector += Vector3::new(0.3, 0.7, 0.1);
    nearer.things[errand::BULBS[OLD]] = body(near.things[errand::FIXTURE].pose * at([0.03, 0.0, 0.08]));
    let mut meter = Meter::endless(Task::Replace, Variant::Benchmark, &start);
    meter.show(&row_at(1, &near));
    for step in 1..4 {
        meter.show(&row_at(2 * step, &nearer));
        let forth = errand_potentials().map(|(name, _)| meter.last(name));
        assert!(forth.iter().all(|paid| *paid > 0.0), "{forth:?}");
        meter.show(&row_at(2 * step + 1, &near));
        assert_eq!(errand_potentials().map(|(name, _)| -meter.last(name)), forth);
    }
    meter.show(&row_at(8, &near));
    assert_eq!(errand_potentials().map(|(name, _)| meter.last(name)), [0.0; 4], "standing still");
}

/// Arrival is worth the same from anywhere: with all distances scaled, the same path pays the same.
#[test]
fn payment_does_not_depend_on_the_start_distance() {
    // Parts of the start distance, and what the step to each pays of 10. Farther than the start is no worse than it.
    let path = [(0.5, 5.0), (0.75, -2.5), (0.75, 0.0), (2.0, -2.5), (0.1, 9.0), (0.0, 1.0), (1.0, -10.0)];
    let way = Vector3::new(2.0, -6.0, 3.0) / 7.0;
    // A goal at the origin, so that a millimetre is not lost in metres.
    let away = |distance: f64| {
        let mut row = start_of(Task::Replace);
        row.things[errand::FIXTURE].pose = at([0.0, 0.0, -0.036259]);
        row.things[errand::CRATE].pose = at([0.0; 3]);
        row.things[errand::LADDER] = body(at((way * distance - Vector3::new(0.0, 0.1, 1.18)).into()));
        row.things[errand::BULBS[NEW]] = body(at((way * distance - Vector3::new(0.0, 0.0, 0.036259)).into()));
        row.things[errand::BULBS[OLD]] = body(at((way * distance).into()));
        row.attachments.fill(fiatlux_rules::AttachmentRow::FREE);
        row
    };
    let approaches = [("ladder_progress", 0.5), ("fresh_bulb_progress", 1.0), ("old_bulb_disposal_progress", 1.0)];
    for start in [1e-3, 0.02, 0.5, 1.0, 4.0, 40.0, 1e4] {
        let mut meter = Meter::endless(Task::Replace, Variant::Benchmark, &away(start));
        for (step, (part, pays)) in (1..).zip(path) {
            meter.show(&row_at(step, &away(part * start)));
            for (name, share) in approaches {
                let paid = meter.last(name);
                assert!((paid - pays * share).abs() < 1e-9, "{name} from {start} m to {part}: {paid}");
            }
        }
    }
    // Below a millimetre it is measured against a millimetre: what is left is worth what it is of that.
    for start in [0.0, 1e-6, 0.25e-3, 0.9e-3] {
        let mut meter = Meter::endless(Task::Replace, Variant::Benchmark, &away(start));
        for (step, (millimetres, level)) in (1..).zip([(0.0, 1.0), (0.5, 0.5), (3.0, 0.0), (0.25, 0.75)]) {
            meter.show(&row_at(step, &away(1e-3 * millimetres)));
            for (name, share) in approaches {
                let expected = 10.0 * share * (level - (1.0 - start / 1e-3));
                let paid = meter.paid(name);
                assert!((paid - expected).abs() < 1e-9, "{name} from {start} m to {millimetres} mm: {paid}");
            }
        }
    }
}

/// The removal starts from the clearance that row 0 has, and a bulb in the socket has none.
#[test]
fn removal_starts_from_its_own_clearance() {
    let with = |clearance: f64, seated: bool| {
        let mut row = start_of(Task::Replace);
        row.things[errand::BULBS[OLD]] = body(row.things[errand::FIXTURE].pose * at([0.0, 0.0, clearance]));
        row.attachments[OLD].seated = seated;
        row
    };
    for (states, paid) in [
        ([with(0.0, true), with(0.012, true), with(0.10, false)], 5.0),
        ([with(0.03, false), with(0.02, false), with(0.06, false)], 1.5),
        ([with(0.03, true), with(0.02, false), with(3.0, false)], 5.0),
        ([with(0.2, false), with(0.5, false), with(0.0, true)], -5.0),
    ] {
        let meter = play(Task::Replace, Variant::Benchmark, &states.each_ref());
        assert!(close(meter.paid("old_bulb_removal"), paid), "{}", meter.paid("old_bulb_removal"));
    }
}

/// New heights pay once, and a second ascent over old ground nothing; descents are their mirror image.
#[test]
fn records_pay_each_centimetre_once() {
    let path = [0.79, 1.2, 0.9, 1.2, 1.3, 0.5];
    for (task, name, sign, expected) in [
        (Task::Climb, "height_gain", 1.0, [4.1, 0.0, 0.0, 1.0, 0.0]),
        (Task::S02, "height_gain", 1.0, [4.1, 0.0, 0.0, 1.0, 0.0]),
        (Task::S10, "height_gain", 1.0, [4.1, 0.0, 0.0, 1.0, 0.0]),
        (Task::S04, "descent", -1.0, [4.1, 0.0, 0.0, 1.0, 0.0]),
        (Task::S12, "descent", -1.0, [4.1, 0.0, 0.0, 1.0, 0.0]),
    ] {
        let state = |z: f64| {
            let mut row = start_of(task);
            row.robot.pose.translation.vector.z = 2.0 + sign * z;
            row
        };
        let mut meter = Meter::endless(task, Variant::Training, &state(path[0]));
        for (step, (z, pays)) in (1..).zip(path[1..].iter().zip(expected)) {
            meter.show(&row_at(step, &state(*z)));
            assert!(close(meter.last(name), pays), "{task} at {z}: {}", meter.last(name));
        }
    }
}

/// Measurements that are not finite pay nothing, and leave no trace: rows of junk between two good ones change no sum of a
/// potential, and a record goes on from where it was. A state that is not finite ends the episode and pays failures alone.
#[test]
fn what_is_not_finite_pays_nothing() {
    for junk in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for task in Task::ALL {
            let (start, goal) = (start_of(task), goal_of(task));
            let mut spoilt = start.clone();
            spoilt.com_velocity.fill(junk);
            spoilt.world_from_palm.iter_mut().for_each(|palm| palm.translation.vector = Vector3::repeat(junk));
            hand_forces(&mut spoilt).for_each(|force| force.fill(junk));
            spoilt.force_mut(errand::LADDER_FORCE).iter_mut().for_each(|force| force.fill(junk));
            spoilt.action.fill(junk);
            let mut wild = spoilt.clone();
            for body in [&mut wild.robot].into_iter().chain(&mut wild.things[..errand::FIXTURE]) {
                body.pose.translation.vector.fill(junk);
                body.pose.rotation.as_mut_unchecked().coords.fill(junk);
                body.angular_velocity.fill(junk);
            }
            wild.joint_position.fill(junk);
            wild.joint_velocity.fill(junk);
            let mut meter = Meter::endless(task, Variant::Training, &start);
            meter.show(&row_at(1, &wild));
            assert!(meter.rewards.reward().is_finite(), "{task} {junk}");
            assert!(meter.paid.iter().all(|(_, paid)| *paid <= 0.0), "{task} {junk}: {:?}", meter.paid);
            assert_eq!(meter.paid("diverged"), -4.0, "{task} {junk}");

            let mut meter = Meter::endless(task, Variant::Training, &start);
            meter.show(&row_at(1, &spoilt));
            assert!(meter.rewards.reward().is_finite(), "{task} {junk}");
            for (name, paid) in &meter.paid {
                assert!(!is_potential(task, name) || *paid <= 0.0, "{task} {name} {junk}: {paid}");
                assert!(!is_rate(task, name) && !is_record(name) || *paid == 0.0, "{task} {name} {junk}: {paid}");
            }
            meter.show(&row_at(2, &goal));
            let clean = play(task, Variant::Training, &[&start, &goal]);
            for (name, paid) in &clean.paid {
                let lasting = is_potential(task, name) || is_record(name);
                assert!(
                    !lasting || close(meter.paid(name), *paid),
                    "{task} {name} {junk}: {} {paid}",
                    meter.paid(name)
                );
            }
        }
    }
}

/// A bulb at infinity has not been taken out of its socket, for all that it is far from it.
#[test]
fn an_infinite_clearance_pays_nothing() {
    for task in [Task::Replace, Task::S03] {
        let start = start_of(task);
        let mut lost = start.clone();
        lost.attachments[OLD].seated = false;
        for junk in [f64::INFINITY, f64::NEG_INFINITY] {
            lost.things[errand::BULBS[OLD]].pose.translation.vector.z = junk;
            let meter = play(task, Variant::Training, &[&start, &lost]);
            assert_eq!(meter.paid("old_bulb_removal"), 0.0, "{task} {junk}");
        }
    }
}

/// A finite height that is too large to weigh pays nothing either.
#[test]
fn what_overflows_pays_nothing() {
    let mut start = start_of(Task::Climb);
    let mut after = start.clone();
    after.robot.pose.translation.vector.z = 1e308;
    assert_eq!(play(Task::Climb, Variant::Benchmark, &[&start, &after]).paid("height_gain"), 0.0);
    start.com_velocity.x = 1e200;
    assert_eq!(play(Task::Climb, Variant::Benchmark, &[&start, &start]).paid("com_sway"), 0.0);
}

fn is_record(name: &str) -> bool {
    ["height_gain", "descent"].contains(&name)
}

fn is_rate(task: Task, name: &str) -> bool {
    let motion = ["com_sway", "ang_vel_xy", "action_rate", "joint_acceleration", "ankle_limits", "waist_deviation"];
    let others = ["finger_deviation", "contact_penalty", "hand_force"];
    motion.contains(&name) || others.contains(&name) || (task == Task::Climb && name == "limb_contact")
}
