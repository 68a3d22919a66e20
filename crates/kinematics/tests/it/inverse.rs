//! Targets that are within reach are reached, those that are not are refused with the reason.

use fiatlux_dynamics::BodyId;
use fiatlux_kinematics::{Goal, InverseKinematics, KinematicsError, Mechanics, Outcome};
use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};

use crate::{Alone, Draws};

const ARM: [&str; 3] = ["shoulder", "elbow", "wrist"];

fn arm(side: &str) -> Vec<String> {
    ARM.iter().map(|part| format!("{side}_{part}")).collect()
}

/// Share of poses of a palm, drawn by random angles of these joints, that are reached within 1 mm and 0.01 rad.
fn reached(side: &str, waist: bool, targets: usize) -> f64 {
    let alone = Alone::new("g1_inspire");
    let mut names = arm(side);
    names.extend(waist.then(|| "waist".into()));
    let joints = alone.joints(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let palm = alone.site(&format!("{side}_palm"));
    let mut inverse = InverseKinematics::new(&alone.model, alone.ids.root, &joints, false).unwrap();
    let (mut mechanics, mut draws) = (Mechanics::new(&alone.model), Draws(36));
    let mut hits = 0;
    for _ in 0..targets {
        let mut drawn = alone.standing();
        alone.draw(&joints, &mut draws, &mut drawn);
        mechanics.update(&alone.model, &drawn);
        let target = mechanics.world_from_site(&palm);
        let mut state = alone.standing();
        let found = inverse.solve(&alone.model, &mut state, &[Goal::pose(palm, target)]).unwrap();
        // Judged by the pose, not by the report.
        mechanics.update(&alone.model, &state);
        let pose = mechanics.world_from_site(&palm);
        let miss = (pose.translation.vector - target.translation.vector).norm();
        let hit = miss < 1e-3 && pose.rotation.angle_to(&target.rotation) < 0.01;
        assert!(hit || found.outcome != Outcome::Reached, "{found:?}");
        hits += usize::from(hit);
        for (joint, ids) in alone.robot.joints().iter().zip(&alone.ids.joints) {
            assert!((joint.lower..=joint.upper).contains(&state.qpos[ids.qpos]), "{} is beyond its limits", joint.name);
        }
    }
    hits as f64 / targets as f64
}

/// The example `time_kinematics` draws 10,000 a palm.
#[test]
fn palms_reach_what_random_angles_reach() {
    for side in ["left", "right"] {
        for waist in [false, true] {
            let share = reached(side, waist, 1000);
            println!("{side} palm, waist {waist}: {share}");
            assert!(share >= 0.995, "{side} palm, waist {waist}: {share}");
        }
    }
}

/// However far a goal is turned about an axis about which any turn will do, the palm gets there.
#[test]
fn a_free_axis_is_free_at_any_turn() {
    let alone = Alone::new("g1_inspire");
    let names = arm("right");
    let joints = alone.joints(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let palm = alone.site("right_palm");
    let mut inverse = InverseKinematics::new(&alone.model, alone.ids.root, &joints, false).unwrap();
    let (mut mechanics, mut draws) = (Mechanics::new(&alone.model), Draws(37));
    for index in 0..120 {
        let mut drawn = alone.standing();
        alone.draw(&joints, &mut draws, &mut drawn);
        mechanics.update(&alone.model, &drawn);
        let mut target = mechanics.world_from_site(&palm);
        let axis = [Vector3::z_axis(), Vector3::x_axis(), Unit::new_normalize(Vector3::new(0.6, -0.3, 0.5))][index % 3];
        let turn = f64::from(u32::try_from(index).unwrap() % 8) * std::f64::consts::FRAC_PI_4;
        target.rotation = UnitQuaternion::from_axis_angle(&axis, turn) * target.rotation;
        let mut state = alone.standing();
        let found = inverse.solve(&alone.model, &mut state, &[Goal::pose_about(palm, target, axis)]).unwrap();
        mechanics.update(&alone.model, &state);
        let pose = mechanics.world_from_site(&palm);
        let miss = (pose.translation.vector - target.translation.vector).norm();
        let lean = (pose.rotation.inverse() * axis).angle(&(target.rotation.inverse() * axis));
        assert!(miss < 1e-3 && lean < 0.01, "{index}: off by {miss} m and {lean} rad, {found:?}");
    }
}

/// Both soles flat on treads of different height and the centre of mass over them: the base moves, too.
#[test]
fn a_stance_puts_soles_and_centre_of_mass_in_place() {
    let alone = Alone::new("g1_bare");
    let (model, root) = (&alone.model, alone.ids.root);
    let legs = alone.joints(&["hip", "knee", "ankle", "waist"]);
    let mut inverse = InverseKinematics::new(model, root, &legs, true).unwrap();
    let at = |y: f64, x: f64, z: f64| Isometry3::translation(x, y, z);
    let goals = [
        Goal::pose(alone.site("left_sole"), at(0.1, 0.0, 0.0)),
        Goal::pose(alone.site("right_sole"), at(-0.1, 0.1, 0.12)),
        Goal::com_over(0.05, 0.0),
    ];
    let mut state = alone.standing();
    let found = inverse.solve(model, &mut state, &goals).unwrap();
    assert_eq!(found.outcome, Outcome::Reached, "{found:?}");
    let mut mechanics = Mechanics::new(model);
    mechanics.update(model, &state);
    let com = mechanics.center_of_mass(model, root).1;
    assert!((com.xy() - Vector3::new(0.05, 0.0, 0.0).xy()).norm() < 1e-3);
    for (side, goal) in ["left_sole", "right_sole"].iter().zip(&goals) {
        let pose = mechanics.world_from_site(&alone.site(side));
        assert!((pose.translation.vector - goal.world_from_part.translation.vector).norm() < 1e-3);
        assert!(pose.rotation.angle() < 0.01);
    }
}

#[test]
fn what_cannot_be_reached_is_said_with_the_reason() {
    let alone = Alone::new("g1_bare");
    let (model, root) = (&alone.model, alone.ids.root);
    let palm = alone.site("left_palm");
    let names = arm("left");
    let joints = alone.joints(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let mut inverse = InverseKinematics::new(model, root, &joints, false).unwrap();
    let mut state = alone.standing();
    let far = inverse.solve(model, &mut state, &[Goal::position(palm, Vector3::new(3.0, 0.0, 1.0))]).unwrap();
    assert!(far.outcome != Outcome::Reached && far.position_error > 2.0 && far.position_error < 3.0, "{far:?}");

    // The elbow alone: it bends to its limit and no further.
    let elbow = alone.joints(&["left_elbow"]);
    let mut alone_elbow = InverseKinematics::new(model, root, &elbow, false).unwrap();
    let mut mechanics = Mechanics::new(model);
    let ids = alone.ids.joints[alone.robot.joint_index("left_elbow_joint").unwrap()];
    let upper = alone.robot.joints()[alone.robot.joint_index("left_elbow_joint").unwrap()].upper;
    let mut beyond = alone.standing();
    beyond.qpos[ids.qpos] = upper + 0.3;
    mechanics.update(model, &beyond);
    let target = mechanics.world_from_site(&palm).translation.vector;
    let mut state = alone.standing();
    let found = alone_elbow.solve(model, &mut state, &[Goal::position(palm, target)]).unwrap();
    assert_eq!((found.outcome, state.qpos[ids.qpos]), (Outcome::Limit { body: ids.body }, upper));

    let nan = Goal::position(palm, Vector3::new(f64::NAN, 0.0, 0.0));
    assert_eq!(inverse.solve(model, &mut state, &[nan]), Err(KinematicsError::NotFinite { field: "a goal" }));
    let other = InverseKinematics::new(model, root, &[root], false).map(|_| ());
    assert_eq!(other, Err(KinematicsError::Joint { body: root.0, root: root.0 }));
    let fixed = InverseKinematics::new(model, BodyId::WORLD, &[], true).map(|_| ());
    assert_eq!(fixed, Err(KinematicsError::Root(0)));
}

/// A fingertip is brought to where the leader's angle puts it; the joint that follows moves with it and is no choice of its own.
#[test]
fn joints_that_follow_others_move_with_them() {
    let alone = Alone::new("g1_inspire6");
    let (model, root) = (&alone.model, alone.ids.root);
    let [leader, follower] = ["R_index_proximal_joint", "R_index_intermediate_joint"]
        .map(|name| alone.ids.joints[alone.robot.joint_index(name).unwrap()]);
    let tip = alone.site("right_index_tip");
    let mut mechanics = Mechanics::new(model);
    let mut target = alone.standing();
    (target.qpos[leader.qpos], target.qpos[follower.qpos]) = (1.1, 1.1);
    mechanics.update(model, &target);
    let place = mechanics.world_from_site(&tip).translation.vector;
    let mut inverse = InverseKinematics::new(model, root, &[leader.body], false).unwrap();
    let mut state = alone.standing();
    // Where the follower was put does not count.
    state.qpos[follower.qpos] = 0.7;
    let found = inverse.solve(model, &mut state, &[Goal::position(tip, place)]).unwrap();
    assert_eq!(found.outcome, Outcome::Reached, "{found:?}");
    assert!((state.qpos[leader.qpos] - 1.1).abs() < 5e-3 && found.steps < 12, "{found:?}");
    assert_eq!(state.qpos[follower.qpos], state.qpos[leader.qpos]);

    let refused = InverseKinematics::new(model, root, &[follower.body], false).map(|_| ()).unwrap_err();
    assert_eq!(refused, KinematicsError::Follower { body: follower.body.0, leader: leader.body.0 });
}
