//! Start states of all tasks: nothing overlaps, bulbs in the hand are held, and the rulebook counts what it says.
//!
//! `FIATLUX_START_SEEDS` sets the number of layout seeds; 100 was shown to hold, 12 run by default.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;
use std::time::{Duration, Instant};

use fiatlux_robot::GainSet;
use fiatlux_rules::{Bulb, Geometry, HAND_BODIES_PER_SIDE, JOINTS, Judge, JudgeOptions, Row, RowDigest, Task, Thresholds};
use fiatlux_tests::{robot, scene};
use fiatlux_world::{ACTION_SCALE, Scene, SceneKind, ShapeOwner, StartError, StartOptions, World, start};

/// Deepest overlap of anything in a start state, m.
const OVERLAP: f64 = 1e-3;
const NO_NOISE: StartOptions = StartOptions { reset_noise: false };

/// The bulb in the hand, from the reference's table of start states.
fn carried(task: Task) -> Option<Bulb> {
    match task {
        Task::S04 | Task::S05 | Task::S06 => Some(Bulb::Old),
        Task::S09 | Task::S10 | Task::S11 => Some(Bulb::Fresh),
        _ => None,
    }
}

fn scene_of(task: Task, seed: u64) -> Arc<Scene> {
    scene(SceneKind::of(task), seed, robot().gains(GainSet::default()))
}

fn started(task: Task, seed: u64, episode: u64, options: &StartOptions) -> World {
    start(scene_of(task, seed), task, episode, options).unwrap()
}

fn judge(task: Task) -> Judge {
    Judge::new(task, Thresholds::default(), Geometry::default(), JudgeOptions::default())
}

fn digest(row: &Row) -> [u8; 32] {
    let mut digest = RowDigest::new(b"start");
    digest.push(row);
    digest.bytes()
}

/// Deepest overlap of any two shapes, the closed hand's own fingers included, m, and their names.
fn deepest_overlap(world: &World) -> (f64, String) {
    let model = &world.scene().model;
    let mut deepest = (0.0, String::new());
    for contact in model.contacts_at(&world.state().qpos, 0.0).unwrap() {
        if -contact.distance > deepest.0 {
            let [a, b] = [contact.shape_a, contact.shape_b].map(|shape| &model.shapes()[shape.0].name);
            deepest = (-contact.distance, format!("{a} and {b}"));
        }
    }
    deepest
}

fn lowest_and_highest(values: &[f64]) -> String {
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(*v), high.max(*v)));
    if values.is_empty() { "-".into() } else { format!("{low:.1}..{high:.1}") }
}

/// Every task starts as its page says, in every room.
#[test]
fn starts_are_as_the_rulebook_says() {
    let seeds: u64 = std::env::var("FIATLUX_START_SEEDS").map_or(12, |n| n.parse().unwrap());
    println!("task     c0 / n  force on a hand, N  overlap, mm  ms a start");
    for task in Task::ALL {
        let (mut forces, mut overlap, mut time) = (Vec::new(), 0.0_f64, Duration::ZERO);
        for seed in 0..seeds {
            let scene = scene_of(task, seed);
            let clock = Instant::now();
            let mut world = start(scene, task, 0, &StartOptions::default()).unwrap();
            time += clock.elapsed();
            let at = format!("{task} seed {seed}");

            let (depth, names) = deepest_overlap(&world);
            assert!(depth < OVERLAP, "{at}: {names} overlap by {depth} m");
            overlap = overlap.max(depth);

            let row = world.row().clone();
            assert_eq!((row.step, row.unconverged), (0, 0), "{at}");
            let mut judge = judge(task);
            let start_count = task.spec().start_count;
            assert_eq!(judge.start(&row).count, start_count, "{at}: {:?}", judge.verdict().conjuncts);
            forces.extend(check_hold(task, &row, &at));

            // Holding the staged posture.
            let row_1 = world.step(&row.action, &row.joint_target).unwrap();
            let verdict = *judge.advance(row_1);
            assert!(verdict.end.is_none() && !verdict.broken && !verdict.dropped, "{at}: {verdict:?}");
            assert!(verdict.count <= start_count, "{at}");
            check_hold(task, row_1, &at);
        }
        let (c0, n) = (task.spec().start_count, task.spec().gate.n());
        let (force, mean) = (lowest_and_highest(&forces), time.as_secs_f64() * 1e3 / seeds as f64);
        println!("{:<8} {c0} / {n}   {force:>18}  {:>11.2}  {mean:>10.1}", task.short_id(), overlap * 1e3);
    }
}

/// The carried bulb is felt by the right hand alone, neither too little nor too much; returns the largest force, N.
fn check_hold(task: Task, row: &Row, at: &str) -> Option<f64> {
    let limits = Thresholds::default();
    let mut largest = None;
    for bulb in Bulb::ALL {
        let forces = row.hand_force[bulb as usize].map(|force| force.norm());
        let most = forces.iter().fold(0.0, |a: f64, b| a.max(*b));
        if carried(task) == Some(bulb) {
            assert!(most > limits.touch_n && most < limits.fragility_n, "{at}: {most} N");
            assert!(forces[HAND_BODIES_PER_SIDE..].iter().all(|force| *force == 0.0), "{at}");
            largest = Some(most);
        } else {
            assert_eq!(most, 0.0, "{at}");
        }
    }
    largest
}

/// Attachment, places and postures, free of noise, against the reference's table.
#[test]
fn starts_without_noise_are_nominal() {
    for task in Task::ALL {
        let world = started(task, 3, 0, &NO_NOISE);
        let (scene, row) = (world.scene(), world.row());
        let robot = &row.robot.pose;
        let position = robot.translation.vector;
        let distance = |to: &nalgebra::Isometry3<f64>| (position - to.translation.vector).xy().norm();
        let facing = |to: &nalgebra::Vector3<f64>| fiatlux_rules::measure::facing_angle(robot, to).abs();
        let [ladder, crate_, fresh] = [row.ladder.pose, row.crate_, row.bulbs[1].pose];

        let seated = row.attachments.map(|attachment| attachment.seated);
        let expected = match task {
            Task::S01 | Task::S02 | Task::S03 | Task::Replace => [true, false],
            Task::S12 => [false, true],
            _ => [false, false],
        };
        assert_eq!(seated, expected, "{task}");
        let place = match task {
            Task::S01 => Some((position.xy() - scene.layout.robot.position).norm(), 0.0, ladder.translation.vector)),
            Task::S02 | Task::S10 | Task::Climb => Some((distance(&ladder), 0.85, ladder.translation.vector)),
            Task::S05 => Some((distance(&ladder), 0.85, crate_.translation.vector)),
            Task::S06 => Some((distance(&crate_), 0.5, crate_.translation.vector)),
            Task::S07 => Some((distance(&crate_), 0.7507, fresh.translation.vector)),
            Task::S08 => Some((distance(&fresh), libm::hypot(0.30, 0.55), fresh.translation.vector)),
            Task::S09 => Some((distance(&scene.world_from_bench.unwrap()), libm::hypot(0.503, 0.922), ladder.translation.vector)),
            _ => None,
        };
    }
}
