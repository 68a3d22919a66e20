//! The flat vectors: layout, scale, noise, and the document that describes them.

use std::fmt::Write as _;
use std::sync::Arc;

use crate::common::{Rig, document, q0, sensed, start_row};
use fiatlux_features::FEATURES;
use fiatlux_rules::{Bulb, Row, Task, errand};
use fiatlux_sensing::{
    ClimbPrivileged, LIDAR_RAYS, NoiseSeed, Observer, Privileged, Proprioception, Sensor, Sensors, Setup, Term,
};
use fiatlux_world::Scene;
use nalgebra::{Isometry3, Vector3};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

const SEED: NoiseSeed = NoiseSeed { seed: 2, episode: 9 };

/// A row in which no two numbers are alike.
fn marked(row: &Row) -> Row {
    let mut row = row.clone();
    let mark = |first: f64, index: usize| first + index as f64;
    row.robot.pose = Isometry3::translation(0.3, -0.2, 0.75);
    row.robot.linear_velocity = Vector3::new(1.0, 2.0, 3.0);
    row.robot.angular_velocity = Vector3::new(4.0, 5.0, 6.0);
    for (bulb, factor) in [(Bulb::Old, 1.0), (Bulb::Fresh, 0.5)] {
        for (body, force) in row.force_mut(errand::HAND_FORCE[bulb as usize]).iter_mut().enumerate() {
            *force = factor * Vector3::new(mark(100.0, body), mark(200.0, body), mark(300.0, body));
        }
    }
    for (limb, force) in row.force_mut(errand::LADDER_FORCE).iter_mut().enumerate() {
        *force = Vector3::new(mark(400.0, limb), mark(500.0, limb), mark(600.0, limb));
    }
    for joint in 0..JOINTS {
        row.joint_position[joint] += 0.001 * mark(1.0, joint);
        row.joint_velocity[joint] = 0.01 * mark(1.0, joint);
        row.action[joint] = -mark(1.0, joint);
    }
    row
}

fn rig(scene: &Arc<Scene>, row: &Row, task: Task, seed: Option<NoiseSeed>) -> Rig {
    Rig::new(scene, row, task, Sensors::of(&[Sensor::Flat, Sensor::Lidar, Sensor::Features]), seed)
}

/// The terms of the flat vector.
fn flat_terms(task: Task) -> Vec<Term> {
    let (scene, _) = start_row(task);
    Sensor::Flat.terms(&Setup::new(&scene, task))
}

/// Number by number, at the published places: 6,543 of them, 6,453 in `climb`.
#[test]
fn flat_vectors_have_the_published_order_and_scale() {
    for task in [Task::S03, Task::Climb] {
        let (scene, row) = start_row(task);
        let row = marked(&row);
        let q0 = q0(&scene);
        let mut rig = rig(&scene, &row, task, None);
        let [flat, features, lidar] =
            [Sensor::Flat, Sensor::Features, Sensor::Lidar].map(|sensor| rig.compute(sensor, &row));
        let expected_length = if task == Task::Climb { 6453 } else { 6543 };
        assert_eq!((flat.len(), Sensor::Flat.length(&rig.setup)), (expected_length, expected_length));
        let check = |at: usize, expected: f64| {
            let (found, expected) = (flat[at], expected as f32);
            assert!((found - expected).abs() <= 1e-6 * expected.abs(), "{task:?} {at}: {found}, not {expected}");
        };
        for (at, value) in [4.0, 5.0, 6.0, 0.0, 0.0, -1.0, 1.0, 2.0, 3.0, 0.75].into_iter().enumerate() {
            check(at, value);
        }
        for joint in 0..JOINTS {
            check(10 + joint, row.joint_position[joint] - q0[joint]);
            check(63 + joint, 0.01 * (1.0 + joint as f64));
        }
        let after_touch = if task == Task::Climb {
            for limb in 2..4 {
                for axis in 0..3 {
                    check(116 + 3 * limb + axis, 0.1 * (400.0 + 100.0 * axis as f64 + limb as f64));
                }
            }
            128
        } else {
            // Bodies 0 to 16 are the right hand's, whatever the bulb.
            for body in 0..34 {
                for axis in 0..3 {
                    check(116 + 3 * body + axis, 0.1 * 1.5 * (100.0 * (1 + axis) as f64 + body as f64));
                }
            }
            218
        };
        for index in 0..FEATURES {
            check(after_touch + index, f64::from(features[index]));
        }
        for ray in 0..LIDAR_RAYS {
            check(after_touch + 512 + ray, 0.1 * f64::from(lidar[ray]));
        }
        for joint in 0..JOINTS {
            check(after_touch + 6272 + joint, -(1.0 + joint as f64));
        }
    }
}

/// Contacts, camera, LiDAR and last action are exact.
#[test]
fn terms_without_published_noise_have_none() {
    for task in [Task::S03, Task::Climb] {
        let (scene, row) = start_row(task);
        let row = marked(&row);
        let [noisy, exact] = [Some(SEED), None].map(|seed| rig(&scene, &row, task, seed).compute(Sensor::Flat, &row));
        for term in flat_terms(task) {
            let exempt = !matches!(
                term.name,
                "base_angular_velocity"
                    | "projected_gravity"
                    | "base_linear_velocity"
                    | "base_height"
                    | "joint_position"
                    | "joint_velocity"
            );
            let range = term.offset..term.offset + term.length();
            assert_eq!(exempt, term.noise == 0.0, "{}", term.name);
            assert_eq!(exempt, noisy[range.clone()] == exact[range], "{}", term.name);
        }
    }
}

/// 100,000 draws of a term, as fractions of its published half-width.
fn draws(term: &Term, half_width: f64) -> Vec<f64> {
    const DRAWS: usize = 100_000;
    let (scene, mut row) = start_row(Task::S01);
    let exact = sensed(&mut Observer::new(q0(&scene), None), &row);
    let mut observer = Observer::new(q0(&scene), Some(SEED));
    let mut draws = Vec::with_capacity(DRAWS + term.length());
    while draws.len() < DRAWS {
        let noisy = sensed(&mut observer, &row);
        let noise = values(&noisy, term.name).into_iter().zip(values(&exact, term.name));
        draws.extend(noise.map(|(noisy, exact)| (noisy - exact) / half_width));
        row.step += 1;
    }
    draws.truncate(DRAWS);
    draws
}

fn values(sensed: &Proprioception, name: &str) -> Vec<f64> {
    match name {
        "base_angular_velocity" => sensed.base_angular_velocity.into(),
        "projected_gravity" => sensed.projected_gravity.into(),
        "base_linear_velocity" => sensed.base_linear_velocity.into(),
        "base_height" => vec![sensed.base_height],
        "joint_position" => sensed.joint_position.clone(),
        "joint_velocity" => sensed.joint_velocity.clone(),
        other => panic!("{other} is not proprioception"),
    }
}

/// The noise of each term against the uniform distribution with the published half-width: bounds, and the Kolmogorov-
/// Smirnov statistic, which exceeds 1.95 / sqrt(n) for one sample in a thousand.
#[test]
fn noise_is_uniform_within_the_published_bounds() {
    let published = [
        ("base_angular_velocity", 0.2),
        ("projected_gravity", 0.05),
        ("base_linear_velocity", 0.1),
        ("base_height", 0.05),
        ("joint_position", 0.01),
        ("joint_velocity", 1.5),
    ];
    let terms = flat_terms(Task::S01);
    for (name, half_width) in published {
        let term = terms.iter().find(|term| term.name == name).unwrap();
        assert_eq!(term.noise, half_width, "{}", term.name);
        let mut draws = draws(term, half_width);
        draws.sort_by(f64::total_cmp);
        let n = draws.len() as f64;
        assert!(draws[0] >= -1.0 - 1e-9 && draws[draws.len() - 1] <= 1.0 + 1e-9, "{}", term.name);
        let gap = |(k, draw): (usize, &f64)| {
            let share = (draw + 1.0) / 2.0;
            (share - k as f64 / n).abs().max(((k + 1) as f64 / n - share).abs())
        };
        let statistic = draws.iter().enumerate().map(gap).fold(0.0, f64::max);
        println!("{}: D sqrt(n) = {:.3}", term.name, statistic * n.sqrt());
        assert!(statistic < 1.95 / n.sqrt(), "{}: {statistic}", term.name);
    }
}

/// Row k's noise is the same whether or not other sensors are read, and whichever rows were sensed before.
#[test]
fn noise_does_not_depend_on_other_sensors() {
    let (scene, mut row) = start_row(Task::S02);
    let own = |rig: &mut Rig, row: &Row| rig.compute(Sensor::Proprioception, row);
    let [mut alone, mut among, mut seldom] = [(); 3].map(|()| rig(&scene, &row, Task::S02, Some(SEED)));
    for step in 0..50 {
        row.step = step;
        for sensor in [Sensor::Lidar, Sensor::Privileged, Sensor::HandContact, Sensor::Proprioception] {
            among.compute(sensor, &row);
        }
        if step % 10 == 0 {
            among.compute(Sensor::Flat, &row);
        }
        let sensed = own(&mut alone, &row);
        assert_eq!(own(&mut among, &row), sensed);
        if step % 7 == 3 {
            assert_eq!(own(&mut seldom, &row), sensed);
        }
    }
    // Back to an earlier row.
    row.step = 4;
    assert_eq!(own(&mut seldom, &row), own(&mut rig(&scene, &row, Task::S02, Some(SEED)), &row));
}

#[test]
fn privileged_terms_have_their_places() {
    let (scene, mut row) = start_row(Task::S03);
    let pose = |k: f64| Isometry3::new(Vector3::new(k, k + 0.1, k + 0.2), Vector3::new(0.0, 0.0, 0.1 * k));
    row.robot.pose = pose(1.0);
    row.things[errand::LADDER].pose = pose(2.0);
    row.things[errand::FIXTURE].pose = pose(3.0);
    row.things[errand::FRESH_BULB].pose = pose(4.0);
    row.things[errand::OLD_BULB].pose = pose(5.0);
    row.things[errand::CRATE].pose = pose(6.0);
    let geometry = scene.geometry();
    let flat = Privileged::measure(&geometry, &row).flat();
    for k in 1..=6 {
        let first = k as f64;
        let half = 0.05 * first;
        let expected = [first, first + 0.1, first + 0.2, half.cos(), 0.0, 0.0, half.sin()];
        for (at, expected) in expected.into_iter().enumerate() {
            assert!((flat[7 * (k - 1) + at] - expected).abs() < 1e-12, "pose {k}, number {at}");
        }
    }
    // All turns are about z, so heights of points on z axes are those of their frames.
    let seat = Vector3::new(3.0, 3.1, 3.2 + geometry.seat_z);
    let plug = |k: f64| Vector3::new(k, k + 0.1, k + 0.2 + geometry.seat_z);
    let [x, y, z] = geometry.ladder_top;
    let (sin, cos) = 0.2_f64.sin_cos();
    let top = Vector3::new(2.0 + cos * x - sin * y, 2.1 + sin * x + cos * y, 2.2 + z);
    let distances = [(top - seat).norm(), (plug(4.0) - seat).norm(), (plug(5.0) - seat).norm(), 3.0_f64.sqrt()];
    for (found, expected) in flat[42..46].iter().zip(distances) {
        assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
    }
    // S03 starts with the old bulb in the socket.
    assert_eq!(flat[46..], [1.0, 0.0]);
    let computed = |task| Rig::new(&scene, &row, task, Sensors::NONE, None).compute(Sensor::Privileged, &row);
    assert_eq!(computed(Task::S03), flat.map(|number| number as f32));

    row.robot.linear_velocity = row.robot.pose.rotation * Vector3::new(0.7, 0.8, 0.9);
    let climb = ClimbPrivileged::measure(&row).flat();
    assert_eq!((&climb[..7], &climb[10..]), (&flat[..7], &flat[7..14]));
    assert!((Vector3::from_column_slice(&climb[7..10]) - Vector3::new(0.7, 0.8, 0.9)).norm() < 1e-12);
    let computed = Rig::new(&scene, &row, Task::Climb, Sensors::NONE, None).compute(Sensor::Privileged, &row);
    assert_eq!(computed, climb.map(|number| number as f32));
}

#[test]
fn the_document_has_the_table() {
    let mut text = String::new();
    for (title, task) in [("All tasks but `climb`", Task::S01), ("`climb`", Task::Climb)] {
        let terms = flat_terms(task);
        writeln!(text, "{title}, {} numbers:\n", terms.iter().map(Term::length).sum::<usize>()).unwrap();
        writeln!(text, "| from | count | name | scale | noise | unit | what |").unwrap();
        writeln!(text, "| ---: | ----: | ---- | ----: | ----: | ---- | ---- |").unwrap();
        for term in &terms {
            let (length, Term { name, offset, scale, noise, unit, meaning, .. }) = (term.length(), term);
            let noise = if *noise > 0.0 { format!("{noise}") } else { String::new() };
            writeln!(text, "| {offset} | {length} | `{name}` | {scale} | {noise} | {unit} | {meaning} |").unwrap();
        }
        if task != Task::Climb {
            text.push('\n');
        }
    }
    document("terms", &text);
}
