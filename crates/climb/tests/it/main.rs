//! The plan of the ladder, played on the free ladder as a session does it: noise on the joints' angles, targets clamped.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod network;
#[path = "../../../kinematics/tests/it/room.rs"]
mod room;

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_climb::{Arm, Body, Keyframe, Plan, Player, approach, armed, raised, stand};
use fiatlux_dynamics::{Mechanics, ShapeId, State};
use fiatlux_kinematics::{Work, at_once};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use room::{Draws, Room};

/// Control step, s.
const DT: f64 = 0.02;

/// The end of a play.
#[derive(Debug)]
struct Played {
    /// Where it fell, s.
    fell: Option<f64>,
    /// Height of the pelvis above the floor, m.
    height: f64,
    /// Way of the ladder, m, and its largest tilt, rad.
    ladder: (f64, f64),
    /// Largest effort relative to its limit, and the joint.
    effort: (f64, String),
    /// Largest force of the ladder on a part of the robot other than its feet, N.
    touch: f64,
    /// Largest distance of the pelvis from where it is wanted, m.
    off: f64,
    /// Largest way of each sole on the level, m.
    slip: [f64; 2],
}

fn pose(state: &State, at: usize) -> Isometry3<f64> {
    let q = &state.qpos[at..at + 7];
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[4], q[5], q[6]));
    Isometry3::from_parts(Vector3::new(q[0], q[1], q[2]).into(), rotation)
}

fn body() -> Body {
    let robot = Robot::by_name("g1_inspire").unwrap();
    let gains = robot.gains(GainSet::default());
    Body::new(robot, gains).unwrap()
}

/// Plays a plan from its first posture at this speed for some time, s.
fn play(plan: &Plan, rate: f64, seconds: f64, seed: u64) -> Played {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let spec = SceneSpec::new(SceneKind::CoupledLadder, seed, robot.gains(GainSet::default()));
    let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap();
    let (model, ids) = (&scene.model, &scene.robot_ids);
    let mut state = model.reference_state();
    let mut mechanics = Mechanics::new(model);
    mechanics.update(model, &state);
    let platform = scene.site("ladder_platform").unwrap();
    let ladder = mechanics.world_from_site(&platform);
    let origin = ladder * Isometry3::translation(0.0, -0.1, -ladder.translation.z);
    let world_from_plan = origin * Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2);
    let first = &plan.keyframes[0];
    state.set_pose(model, ids.root, &(world_from_plan * first.pelvis));
    ids.joints.iter().zip(&first.angles).for_each(|(joint, angle)| state.qpos[joint.qpos] = *angle);
    let mut player = Player::new(body(), plan.clone(), world_from_plan).unwrap();
    player.rate = rate;
    let mut room = Room::new(&scene, state, Some(Draws(7 + seed)));
    let mut played = Played {
        fell: None,
        height: 0.0,
        ladder: (0.0, 0.0),
        effort: (0.0, String::new()),
        touch: 0.0,
        off: 0.0,
        slip: [0.0; 2],
    };
    let soles = [0, 1].map(|side| ids.site(&robot.soles()[side].site));
    let feet = soles.map(|sole| sole.body);
    mechanics.update(model, &room.state);
    let stood = soles.map(|sole| mechanics.world_from_site(&sole).translation.vector);
    let is_ladder = |shape: ShapeId| model.bodies()[model.shapes()[shape.0].body.0].root == platform.body;
    for step in 0..(seconds / DT) as usize {
        let angles = room.angles();
        let targets = player.step(&pose(&room.state, ids.root_qpos), &angles).unwrap().to_vec();
        room.step(targets);
        for contact in room.dynamics.contacts() {
            let body = |shape: ShapeId| model.shapes()[shape.0].body;
            let [a, b] = [contact.shape_a, contact.shape_b];
            let other = if is_ladder(a) { b } else { a };
            if is_ladder(a) != is_ladder(b)
                && model.bodies()[body(other).0].root == ids.root
                && !feet.contains(&body(other))
            {
                played.touch = played.touch.max(contact.force.norm());
            }
        }
        mechanics.update(model, &room.state);
        let now = mechanics.world_from_site(&platform);
        let moved = (now.translation.vector - ladder.translation.vector).norm();
        played.ladder = (played.ladder.0.max(moved), played.ladder.1.max(now.rotation.angle_to(&ladder.rotation)));
        for (side, sole) in soles.iter().enumerate() {
            let way = mechanics.world_from_site(sole).translation.vector - stood[side];
            played.slip[side] = played.slip[side].max(way.xy().norm());
        }
        played.height = room.state.qpos[ids.root_qpos + 2];
        let due = (world_from_plan * player.wanted().unwrap().pelvis).translation.vector;
        played.off = played.off.max((pose(&room.state, ids.root_qpos).translation.vector - due).norm());
        if played.off > 0.2 {
            played.fell = Some(step as f64 * DT);
            break;
        }
    }
    Played { effort: room.effort, ..played }
}

/// Rooms 1000 to 1000 + `many`, or room 1000 alone where only a few minutes are given.
fn rooms(many: u64) -> std::ops::Range<u64> {
    1000..1000 + if std::env::var_os("FIATLUX_ALL_ROOMS").is_some() { many } else { 1 }
}

#[test]
fn the_plan_climbs_to_the_platform() {
    let plan = fiatlux_climb::ladder().unwrap();
    let (mut up, count) = (0, rooms(64).count());
    for room in rooms(64) {
        let played = play(&plan, 2.0, 1.2 * plan.seconds() / 2.0, room);
        println!("room {room}: {played:?}");
        up += usize::from(played.fell.is_none() && played.height > 1.82 && played.ladder.0 < 0.001);
    }
    println!("{up} of {count}");
    assert!(up * 10 >= count * 9, "{up} of {count}");
}

/// Floor, treads and platform, m.
const SURFACES: [f64; 6] = [0.0, 0.235, 0.47, 0.71, 0.94, 1.18];

/// Where the feet are in a keyframe, by the surface next to the soles, and which of them bears.
fn stance(body: &Body, key: &Keyframe) -> String {
    let mut mechanics = Mechanics::new(&body.model);
    mechanics.update(&body.model, &body.state(&key.pelvis, &key.angles));
    let places = [0, 1].map(|side| {
        let height = mechanics.world_from_site(&body.ids.site(&body.robot.soles()[side].site)).translation.z;
        let away = |surface: &f64| (height - surface).abs();
        let nearest = SURFACES.into_iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
        if key.bears[side] > 0.0 { format!("{nearest:.3}") } else { "up".into() }
    });
    format!("left {}, right {}", places[0], places[1])
}

#[test]
fn stances_of_the_way_up_hold() {
    stances_hold(&fiatlux_climb::ladder().unwrap());
}

#[test]
fn stances_of_the_way_down_hold() {
    stances_hold(&fiatlux_climb::descent().unwrap());
}

fn stances_hold(plan: &Plan) {
    let (body, is_slow) = (body(), std::env::var_os("FIATLUX_ALL_ROOMS").is_some());
    let mut table = BTreeMap::<String, Stood>::new();
    for (room, index) in rooms(20).flat_map(|room| picked(plan).into_iter().map(move |index| (room, index))) {
        let key = Keyframe { seconds: 1.0, ..plan.keyframes[index].clone() };
        let (name, bears) = (stance(&body, &key), key.bears);
        let played = play(&Plan { keyframes: vec![key] }, 1.0, if is_slow { 30.0 } else { 2.0 }, room);
        let holds = played.fell.is_none() && played.off < 0.05 && played.ladder.0 < 0.001;
        let stood = table.entry(name).or_default();
        (stood.held, stood.count) = (stood.held + usize::from(holds), stood.count + 1);
        if !holds {
            stood.failed.push(room);
            continue;
        }
        stood.off = stood.off.max(played.off);
        for side in (0..2).filter(|side| bears[*side] > 0.0) {
            stood.slip[side] = stood.slip[side].max(played.slip[side]);
        }
        if played.effort.0 > stood.effort.0 {
            stood.effort = played.effort;
        }
    }
    for (name, Stood { held, count, effort: (effort, joint), off, slip, failed }) in &table {
        println!(
            "{name}: {held} of {count}, effort {:.0} % ({joint}), pelvis off by {:.0} mm, soles by {:.1} and {:.1} mm, not in {failed:?}",
            100.0 * effort,
            1e3 * off,
            1e3 * slip[0],
            1e3 * slip[1]
        );
    }
    let sum = |of: fn(&Stood) -> usize| table.values().map(of).sum::<usize>();
    let (held, count) = (sum(|row| row.held), sum(|row| row.count));
    println!("{held} of {count}");
    assert!(count > 50 && held * 20 >= count * 19, "{held} of {count}");
}

/// A stance over all rooms; the largest numbers are those of the rooms in which it was.
#[derive(Debug, Default)]
struct Stood {
    held: usize,
    count: usize,
    effort: (f64, String),
    off: f64,
    /// Ways of the soles that bear, left first.
    slip: [f64; 2],
    failed: Vec<u64>,
}

/// Postures of a plan where the weight begins to move, half way and at the end: with both feet down and with one.
fn picked(plan: &Plan) -> Vec<usize> {
    let bearing = |index: usize| plan.keyframes[index].bears.map(|part| part > 0.0);
    let (mut picked, mut start) = (Vec::new(), 0);
    for end in 1..=plan.keyframes.len() {
        if end == plan.keyframes.len() || bearing(end) != bearing(start) {
            let last = (end - 1 - start) as f64;
            picked.extend([0.0, 0.5, 0.9].map(|part| start + (last * part) as usize));
            start = end;
        }
    }
    picked
}

#[test]
fn a_way_to_the_first_posture_is_found() {
    let (body, plan) = (body(), fiatlux_climb::ladder().unwrap());
    let first = &plan.keyframes[0];
    let mut angles = body.robot.q0()[..fiatlux_robot::BODY].to_vec();
    let arms = fiatlux_robot::MOVED..fiatlux_robot::BODY;
    angles[arms.clone()].iter_mut().for_each(|angle| *angle += 0.3);
    let away = Isometry3::translation(-0.1, 0.02, 0.0) * first.pelvis;
    let still = stand(&body, &away, &angles, first).unwrap();
    let last = still.keyframes.last().unwrap();
    assert_eq!(last.angles[arms.clone()], first.angles[arms], "arms come in before a foot is set");
    let way = at_once(approach(&body, &last.pelvis, &last.angles, first, 0, Work::unlimited())).unwrap();
    let end = way.keyframes.last().unwrap();
    assert_eq!((end.pelvis, &end.angles), (first.pelvis, &first.angles));
    assert!(way.seconds() < 60.0, "{}", way.seconds());
    for pair in way.keyframes.windows(2) {
        let turn = |(a, b): (&f64, &f64)| (a - b).abs();
        let most = pair[0].angles.iter().zip(&pair[1].angles).map(turn).fold(0.0, f64::max);
        assert!(most / pair[1].seconds < 1.0, "{most} rad in {} s", pair[1].seconds);
    }
}

/// Middles of the soles and centre of mass in a posture, m.
fn measure(body: &Body, key: &Keyframe) -> ([Vector3<f64>; 2], Vector3<f64>) {
    let mut mechanics = Mechanics::new(&body.model);
    mechanics.update(&body.model, &body.state(&key.pelvis, &key.angles));
    let sole = |side: usize| mechanics.world_from_site(&body.ids.site(&body.robot.soles()[side].site));
    let soles = [sole(0), sole(1)].map(|pose| pose.translation.vector);
    (soles, mechanics.center_of_mass(&body.model, body.ids.root).1)
}

/// The climb with the arms drawn in: the feet step where they did, with the weight where it was, and wrists stay as they are.
#[test]
fn a_plan_takes_other_arms() {
    let body = body();
    let plan = fiatlux_climb::ladder_with_bulb().unwrap();
    let arm = Arm::DRAWN_IN;
    let other = armed(&body, &plan, &arm).unwrap();
    let mut legs = 0;
    for (key, other) in plan.keyframes.iter().zip(&other.keyframes) {
        let ((soles, com), (other_soles, other_com)) = (measure(&body, key), measure(&body, other));
        let ways = soles.iter().zip(&other_soles).map(|(one, other)| (one - other).norm());
        assert!(ways.fold(0.0, f64::max) < 3e-3 && (com - other_com).xy().norm() < 3e-3, "{com} {other_com}");
        assert_eq!((key.seconds, key.bears, key.ranges), (other.seconds, other.bears, other.ranges));
        for ((joint, before), now) in body.robot.joints().iter().zip(&key.angles).zip(&other.angles) {
            assert_eq!(
                *now,
                arm.reaching(&joint.name).unwrap_or(if joint.name.contains("wrist") { *before } else { *now })
            );
        }
        legs += usize::from(key.angles[..12] != other.angles[..12]);
    }
    assert!(legs * 10 < plan.keyframes.len(), "legs moved in {legs} postures");
    for pair in other.keyframes.windows(2) {
        let turns = pair[0].angles.iter().zip(&pair[1].angles).map(|(one, other)| (one - other).abs());
        let fastest = turns.fold(0.0, f64::max) / pair[1].seconds;
        assert!(fastest < 0.6, "{fastest} rad/s");
    }
}

/// In the limits of the published draw of sizes.
#[test]
fn a_plan_is_raised_with_the_ladder() {
    let body = body();
    for (plan, factor) in [(fiatlux_climb::ladder(), 1.1), (fiatlux_climb::descent(), 0.95)] {
        let plan = plan.unwrap();
        let raised = raised(&body, &plan, factor).unwrap();
        for (key, high) in plan.keyframes.iter().zip(&raised.keyframes) {
            let ((soles, com), (high_soles, high_com)) = (measure(&body, key), measure(&body, high));
            for (sole, high) in soles.into_iter().zip(high_soles) {
                assert!((high - Vector3::new(sole.x, sole.y, factor * sole.z)).norm() < 3e-3, "{sole} {high}");
            }
            assert!((high_com - com).xy().norm() < 3e-3, "{com} {high_com}");
            assert_eq!((key.seconds, key.bears, key.ranges), (high.seconds, high.bears, high.ranges));
        }
    }
    assert_eq!(raised(&body, &fiatlux_climb::ladder().unwrap(), 2.0), None);
}

/// The right foot does on the other side what the left one did.
#[test]
fn a_mirrored_plan_steps_on_the_other_side() {
    let (body, plan) = (body(), fiatlux_climb::descent().unwrap());
    let mirrored = plan.mirrored();
    for (key, other) in plan.keyframes.iter().zip(&mirrored.keyframes) {
        let (([left, right], com), ([other_left, other_right], other_com)) =
            (measure(&body, key), measure(&body, other));
        for (one, other) in [(left, other_right), (right, other_left), (com, other_com)] {
            let other = Vector3::new(other.x, -other.y, other.z);
            assert!((one - other).norm() < 2e-3, "{one} {other}");
        }
        let [low, high] = [key, other].map(|key| key.bears);
        assert_eq!((low[0], low[1]), (high[1], high[0]));
    }
    assert_eq!(mirrored.mirrored(), plan);
}

#[test]
fn a_reversed_plan_takes_as_long() {
    let plan = fiatlux_climb::ladder().unwrap();
    let (first, last) = (plan.keyframes[0].seconds, plan.keyframes.last().unwrap().seconds);
    let reversed = plan.reversed();
    assert!((reversed.seconds() - last - (plan.seconds() - first)).abs() < 1e-9);
    let (early, late) = (plan.at(first + 7.3).unwrap(), reversed.at(reversed.seconds() - 7.3).unwrap());
    assert!((early.pelvis.translation.vector - late.pelvis.translation.vector).norm() < 1e-9);
    assert_eq!(Plan::default().reversed(), Plan::default());
}

#[test]
fn a_plan_is_read_as_it_was_written() {
    let plan = fiatlux_climb::ladder().unwrap();
    let again = Plan::read(&plan.write()).unwrap();
    assert_eq!(again.keyframes.len(), plan.keyframes.len());
    for (a, b) in plan.keyframes.iter().zip(&again.keyframes) {
        let turn = a.pelvis.rotation.angle_to(&b.pelvis.rotation);
        let way = (a.pelvis.translation.vector - b.pelvis.translation.vector).norm();
        assert!(a.angles == b.angles && a.bears == b.bears && a.ranges == b.ranges && a.seconds == b.seconds);
        assert!(way < 1e-9 && turn < 3e-4, "{way} {turn}");
    }
    let late = plan.at(1e3).unwrap();
    assert_eq!(late, *plan.keyframes.last().unwrap());
    let half = plan.at(plan.keyframes[0].seconds + plan.keyframes[1].seconds / 2.0).unwrap();
    let middle = (plan.keyframes[0].angles[3] + plan.keyframes[1].angles[3]) / 2.0;
    assert!((half.angles[3] - middle).abs() < 1e-9, "{half:?}");
    assert_eq!(Plan::default().at(0.0), None);
    for broken in ["1 2 3", "x", &plan.write().replacen("10000 10000", "-1 10000", 1)] {
        assert!(Plan::read(broken).is_err(), "{}", &broken[..3]);
    }
}

/// After the climb, the robot faces what it is to reach.
#[test]
fn the_turn_ends_with_the_face_to_the_guard_rail() {
    let plan = fiatlux_climb::turn().unwrap();
    let up = fiatlux_climb::ladder().unwrap();
    let (first, last) = (up.keyframes.last().unwrap(), plan.keyframes.last().unwrap());
    assert!((first.pelvis.translation.vector - plan.keyframes[0].pelvis.translation.vector).norm() < 0.1);
    assert!((last.pelvis.rotation * Vector3::x()).x > 0.99);
    let (mut stood, count) = (0, rooms(16).count());
    for room in rooms(16) {
        let played = play(&plan, 2.0, 1.15 * plan.seconds() / 2.0, room);
        println!("room {room}: {played:?}");
        stood += usize::from(played.fell.is_none() && played.height > 1.82 && played.ladder.0 < 0.001);
    }
    println!("{stood} of {count}");
    assert!(stood * 10 >= count * 9, "{stood} of {count}");
}

/// A ladder of another height has a turn, too.
#[test]
fn the_turn_fits_other_heights() {
    let plan = fiatlux_climb::turn().unwrap();
    for factor in [0.95, 1.05] {
        let raised = raised(&body(), &plan, factor).unwrap();
        let [before, after] = [&plan, &raised].map(|plan| plan.keyframes.last().unwrap().pelvis.translation.z);
        assert!((after - before - (factor - 1.0) * 1.18).abs() < 0.01, "{before} {after}");
    }
}
