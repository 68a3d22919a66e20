//! The plan of the ladder, played on the free ladder with noise on angles and speeds of the joints. Targets go to the engine as
//! they are; a session clamps them to the joints' limits, and with that the robot falls.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::sync::Arc;

use fiatlux_climb::{Body, Plan, Player};
use fiatlux_dynamics::{Dynamics, Input, Mechanics, State};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene, SceneConfig, SceneKind, SceneSpec};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Noise, uniform within 1.
struct Draws(u64);

impl Draws {
    fn one(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 * 2.0_f64.powi(-52) - 1.0
    }
}

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
}

fn pose(state: &State, at: usize) -> Isometry3<f64> {
    let q = &state.qpos[at..at + 7];
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[4], q[5], q[6]));
    Isometry3::from_parts(Vector3::new(q[0], q[1], q[2]).into(), rotation)
}

fn play(plan: &Plan, room: u64) -> Played {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let spec = SceneSpec::new(SceneKind::CoupledLadder, room, robot.gains(GainSet::default()));
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
    let body = Body::new(Robot::clone(&robot), robot.gains(GainSet::default())).unwrap();
    let mut player = Player::new(body, plan.clone(), world_from_plan).unwrap();
    let (mut dynamics, mut draws) = (Dynamics::new(model), Draws(7 + room));
    let mut targets = vec![0.0; model.drives().len()];
    let mut played = Played { fell: None, height: 0.0, ladder: (0.0, 0.0), effort: (0.0, String::new()), touch: 0.0 };
    let feet = [0, 1].map(|side| ids.site(&robot.soles()[side].site).body);
    let is_ladder =
        |shape: fiatlux_dynamics::ShapeId| model.bodies()[model.shapes()[shape.0].body.0].root == platform.body;
    while player.time() < plan.seconds() + 2.0 {
        let angles: Vec<f64> = ids.joints.iter().map(|joint| state.qpos[joint.qpos] + 0.01 * draws.one()).collect();
        let speeds: Vec<f64> = ids.joints.iter().map(|joint| state.qvel[joint.dof] + 1.5 * draws.one()).collect();
        let wanted = player.step(&pose(&state, ids.root_qpos), &angles, &speeds).unwrap();
        wanted.iter().zip(&ids.joints).for_each(|(target, joint)| targets[joint.drive] = *target);
        for _ in 0..SUBSTEPS {
            dynamics.step(model, &mut state, &Input { targets: &targets, ..Input::default() }, PHYSICS_DT);
        }
        for (joint, there) in robot.joints().iter().zip(&ids.joints) {
            let share = dynamics.efforts()[there.drive].abs() / joint.gains.effort_limit;
            if share > played.effort.0 {
                played.effort = (share, joint.name.clone());
            }
        }
        for contact in dynamics.contacts() {
            let body = |shape: fiatlux_dynamics::ShapeId| model.shapes()[shape.0].body;
            let [a, b] = [contact.shape_a, contact.shape_b];
            let other = if is_ladder(a) { b } else { a };
            if is_ladder(a) != is_ladder(b)
                && model.bodies()[body(other).0].root == ids.root
                && !feet.contains(&body(other))
            {
                played.touch = played.touch.max(contact.force.norm());
            }
        }
        mechanics.update(model, &state);
        let now = mechanics.world_from_site(&platform);
        let moved = (now.translation.vector - ladder.translation.vector).norm();
        let tilt = now.rotation.angle_to(&ladder.rotation);
        played.ladder = (played.ladder.0.max(moved), played.ladder.1.max(tilt));
        played.height = state.qpos[ids.root_qpos + 2];
        let due = (world_from_plan * player.wanted().unwrap().pelvis).translation.vector;
        if (pose(&state, ids.root_qpos).translation.vector - due).norm() > 0.2 {
            played.fell = Some(player.time());
            break;
        }
    }
    played
}

#[test]
fn the_plan_climbs_to_the_platform() {
    let is_slow = std::env::var_os("FIATLUX_ALL_ROOMS").is_some();
    let plan = fiatlux_climb::ladder().unwrap();
    let rooms = if is_slow { 1000..1064 } else { 1000..1001 };
    let (mut up, count) = (0, rooms.clone().count());
    for room in rooms {
        let played = play(&plan, room);
        println!("room {room}: {played:?}");
        up += usize::from(played.fell.is_none() && played.height > 1.82 && played.ladder.0 < 0.001);
    }
    println!("{up} of {count}");
    assert!(up * 10 >= count * 8, "{up} of {count}");
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
    let half = plan.at(1.15).unwrap();
    let middle = (plan.keyframes[0].angles[3] + plan.keyframes[1].angles[3]) / 2.0;
    assert!((half.angles[3] - middle).abs() < 1e-9, "{half:?}");
    assert_eq!(Plan::default().at(0.0), None);
    for broken in ["1 2 3", "x", &plan.write().replacen("10000 10000", "-1 10000", 1)] {
        assert!(Plan::read(broken).is_err(), "{}", &broken[..3]);
    }
}
