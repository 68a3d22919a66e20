//! Needs of a learner: a robot on a floor, wrenches and pushes, resets to rows that were changed, worlds that differ from their
//! scene.

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, BodyVariation, DriveVariation, PreparedVariation, Variation, Wrench};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{BodyRow, Cause, Judge, JudgeOptions, Limb, Protocol, Row, Task, Thresholds, errand};
use fiatlux_world::{
    AppliedWrench, ControlInput, LadderPart, Push, Scene, SceneConfig, SceneKind, SceneParts, SceneSpec, StartError,
    StartOptions, Target, World, WorldError, start,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

fn scene_of(robot: &str, parts: impl Into<SceneParts>) -> Arc<Scene> {
    let robot = Arc::new(Robot::by_name(robot).unwrap());
    let spec = SceneSpec::new(parts, 0, robot.gains(GainSet::Fiatlux));
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

fn on_floor(robot: &str) -> World {
    World::new(scene_of(robot, SceneParts::FLOOR))
}

/// Holds the standing posture, on which the robot stays up for half a second.
fn hold(world: &mut World, wrenches: &[AppliedWrench], push: Option<Push>) -> Row {
    let q0 = world.scene().robot.q0().to_vec();
    let action = vec![0.0; q0.len()];
    let input = ControlInput { wrenches, push, ..ControlInput::new(&action, &q0) };
    world.step_with(&input).unwrap().clone()
}

#[test]
fn a_robot_on_a_floor_is_a_scene() {
    for (robot, joints, bodies) in [("g1_bare", 29, 5), ("g1_inspire", 53, 17)] {
        let mut world = on_floor(robot);
        let scene = Arc::clone(world.scene());
        assert_eq!(scene.spec, SceneSpec::floor(scene.robot.gains(GainSet::Fiatlux)));
        assert_eq!((scene.model.nv(), scene.model.drives().len()), (6 + joints, joints));
        assert_eq!((world.row().layout.joints, world.row().layout.hand_bodies_per_side), (joints, bodies));
        assert_eq!(scene.model.shapes().len(), 1 + scene.robot.shapes().len());
        assert!(scene.footprints().is_empty());
        for _ in 0..10 {
            hold(&mut world, &[], None);
        }
        let weight = scene.robot.total_mass() * 9.81;
        let row = world.row();
        let feet = row.force(errand::FLOOR_FORCE)[Limb::LeftFoot as usize].z
            + row.force(errand::FLOOR_FORCE)[Limb::RightFoot as usize].z;
        assert!((feet - weight).abs() < 0.1 * weight, "{feet} N of {weight}");
        assert_eq!(row.force(errand::LADDER_FORCE), [Vector3::zeros(); 4]);
    }
}

/// Rows have followers where their leaders put them: at a start with noise and a bulb in the hand, in every step whatever an action says for
/// them, and in a row that was given with them elsewhere.
#[test]
fn joints_that_follow_others_do_so_in_every_row() {
    let scene = scene_of("g1_inspire6", SceneKind::of(Task::S09));
    #[track_caller]
    fn check(world: &World) {
        let (row, joints) = (world.row(), world.scene().robot.joints());
        for (index, joint) in joints.iter().enumerate() {
            let Some(follows) = joint.follows else { continue };
            assert_eq!(row.joint_position[index], follows.angle(row.joint_position[follows.leader]), "{}", joint.name);
            assert_eq!(row.joint_velocity[index], follows.ratio * row.joint_velocity[follows.leader], "{}", joint.name);
            assert_eq!(row.joint_effort[index], 0.0, "{}", joint.name);
        }
    }
    let mut world = start(Arc::clone(&scene), Task::S09, 0, &StartOptions::default()).unwrap();
    check(&world);
    let follower = scene.robot.joint_index("R_index_intermediate_joint").unwrap();
    let begun = world.row().clone();
    let mut targets = begun.joint_target.clone();
    let ends = [0.0, 1.5].map(|angle| {
        targets[follower] = angle;
        world.reset_to(&begun).unwrap();
        for _ in 0..10 {
            world.step(&vec![0.0; targets.len()], &targets).unwrap();
            check(&world);
        }
        world.row().joint_position.clone()
    });
    assert_eq!(ends[0], ends[1], "a follower's target has no effect");
    let mut off = begun;
    off.joint_position[follower] += 0.3;
    off.joint_velocity[follower] = 2.0;
    world.reset_to(&off).unwrap();
    check(&world);
}

#[test]
fn worlds_that_take_turns_run_as_alone() {
    let scene = scene_of("g1_inspire", SceneKind::CoupledLadder);
    let mut alone = [(), ()].map(|()| World::new(Arc::clone(&scene)));
    let q0 = scene.robot.q0().to_vec();
    let actions = [0.0, 0.3].map(|size| vec![size; q0.len()]);
    let targets = actions.each_ref().map(|action| q0.iter().zip(action).map(|(q, a)| q + 0.5 * a).collect::<Vec<_>>());
    let mut stage = World::new(Arc::clone(&scene));
    let mut rows = [stage.row().clone(), stage.row().clone()];
    for _ in 0..25 {
        for world in 0..2 {
            let input = ControlInput::new(&actions[world], &targets[world]);
            stage.step_row(&mut rows[world], &input).unwrap();
            assert_eq!(rows[world], *alone[world].step(&actions[world], &targets[world]).unwrap());
        }
    }
    // Wrenches act where a world's own bodies are, and each world has the masses of its own.
    let torso = scene.robot.link_index("torso_link").unwrap();
    let wrench = Wrench { force: Vector3::new(40.0, 0.0, 0.0), torque: Vector3::zeros() };
    let wrenches = [AppliedWrench { target: Target::Link(torso), point: Some(Vector3::z()), wrench }];
    let heavier = BodyVariation { mass: 1.3, com_offset: Vector3::new(0.02, 0.0, 0.0) };
    let body = scene.model.body("torso_link").unwrap();
    let heavier = Variation { bodies: vec![(body, heavier)], ..Variation::default() };
    alone[1].set_variation(&heavier).unwrap();
    let variations = [PreparedVariation::default(), heavier.prepare(&scene.model).unwrap()];
    for _ in 0..25 {
        for world in 0..2 {
            let input = ControlInput { wrenches: &wrenches, ..ControlInput::new(&actions[world], &targets[world]) };
            stage.vary(&variations[world]);
            stage.step_row(&mut rows[world], &input).unwrap();
            assert_eq!(rows[world], *alone[world].step_with(&input).unwrap());
        }
    }
}

/// No rule takes what the scene lacks for something: no gate holds, nothing is held, dropped or tipped.
#[test]
fn what_a_scene_lacks_is_neutral_in_its_rows() {
    let mut world = on_floor("g1_bare");
    let mut rows = vec![world.row().clone()];
    rows.extend((0..5).map(|_| hold(&mut world, &[], None)));
    for row in &rows {
        assert!(row.present.iter().all(|present| !present));
        assert!(row.things.iter().all(|thing| *thing == BodyRow::at_rest(Isometry3::identity())));
        assert!(row.attachments.iter().all(|attachment| !attachment.seated));
    }
    for task in Task::ALL {
        let mut judge = Judge::new(
            Protocol::Published,
            task,
            Thresholds::default(),
            world.scene().geometry(),
            JudgeOptions::default(),
        );
        judge.start(&rows[0]);
        for row in &rows[1..] {
            let verdict = judge.advance(row);
            assert!(verdict.sustained == 0 && !verdict.success, "{task}");
            for cause in [Cause::Success, Cause::Tip, Cause::Crush, Cause::Drop, Cause::Impact] {
                assert!(!verdict.conditions.contains(cause), "{task}: {cause}");
            }
        }
    }
    // A row of a whole scene does not bring bulbs and ladder with it.
    let other = World::new(scene_of("g1_bare", SceneKind::FreeLadder));
    world.reset_to(other.row()).unwrap();
    assert_eq!((&world.row().present, &world.row().things), (&rows[0].present, &rows[0].things));
    assert_eq!(world.row().attachments, rows[0].attachments);
}

#[test]
fn parts_can_be_left_out_one_by_one() {
    let all = SceneParts::of(SceneKind::CoupledLadder);
    let has = |scene: &Scene, prefix: &str| scene.model.shapes().iter().any(|shape| shape.name.starts_with(prefix));
    for (parts, gone) in [
        (SceneParts { ladder: None, ..all }, "ladder_"),
        (SceneParts { bulbs: false, ..all }, "old_bulb_"),
        (SceneParts { fixture: false, ..all }, "fixture_"),
        (SceneParts { furniture: false, ..all }, "bench_"),
        (SceneParts { room: false, ..all }, "room_wall"),
    ] {
        let scene = scene_of("g1_bare", parts);
        for prefix in ["ladder_", "old_bulb_", "fixture_", "bench_", "room_wall"] {
            assert_eq!(has(&scene, prefix), prefix != gone, "{prefix} without {gone}");
        }
        assert_eq!(scene.body(errand::LADDER).is_some(), gone != "ladder_");
        assert_eq!(
            (scene.body(errand::OLD_BULB).is_some(), scene.body(errand::FRESH_BULB).is_some()),
            (gone != "old_bulb_", gone != "old_bulb_")
        );
        let mut world = World::new(scene);
        hold(&mut world, &[], None);
        let task = Task::S02;
        let refused = start(Arc::clone(world.scene()), task, 0, &StartOptions::default());
        assert!(matches!(refused, Err(StartError::Scene { .. })), "{gone}");
    }
    let fixed = scene_of("g1_bare", SceneParts { ladder: Some(LadderPart::Fixed), ..SceneParts::FLOOR });
    assert!(fixed.body(errand::LADDER).is_none() && has(&fixed, "ladder_"));
    assert_eq!(fixed.world_from(errand::LADDER), scene_of("g1_bare", SceneKind::Climb).world_from(errand::LADDER));
}

#[test]
fn footprints_hold_the_shapes_of_what_stands_still() {
    let scene = scene_of("g1_bare", SceneKind::FreeLadder);
    let footprints = scene.footprints();
    let names: Vec<&str> = footprints.iter().map(|footprint| footprint.name.as_str()).collect();
    for name in ["bench", "crate", "fixture", "wall_west", "wall_east", "wall_south", "ceiling"] {
        assert_eq!(names.iter().filter(|found| **found == name).count(), 1, "{name} in {names:?}");
    }
    assert!(!names.contains(&"ladder"), "a ladder that can move is not a footprint");
    let find = |name: &str| footprints.iter().find(|footprint| footprint.name == name).unwrap();
    let crate_ = find("crate");
    let center = crate_.outline.iter().sum::<nalgebra::Vector2<f64>>() / 4.0;
    assert!((center - scene.layout.crate_.unwrap()).norm() < 1e-9);
    assert!((crate_.outline[2] - crate_.outline[0]).x - 2.0 * scene.config.crate_.outer_half[0] < 1e-9);
    assert!((find("bench").top - 1.5).abs() < 1.0 && find("ceiling").bottom > 2.0 && find("fixture").bottom > 1.5);
    // Counter-clockwise.
    for footprint in &footprints {
        let [a, b, c, _] = footprint.outline;
        assert!((b - a).perp(&(c - b)) > 0.0 && footprint.bottom < footprint.top, "{}", footprint.name);
    }
    let fixed = scene_of("g1_bare", SceneKind::Climb).footprints();
    assert!(fixed.iter().any(|footprint| footprint.name == "ladder"));
}

#[test]
fn a_push_is_a_change_of_the_roots_velocity() {
    // In the air, so that only gravity acts besides it.
    let mut world = on_floor("g1_bare");
    let mut row = world.row().clone();
    row.robot.pose.translation.z += 2.0;
    let step = |world: &mut World, push| {
        world.reset_to(&row).unwrap();
        hold(world, &[], push).com_velocity
    };
    let free = step(&mut world, None);
    let linear = Vector3::new(0.5, -0.3, 0.2);
    let pushed = step(&mut world, Some(Push { linear, angular: Vector3::zeros() }));
    assert!((pushed - free - linear).norm() < 1e-6, "{pushed} {free}");
    // The same as a row whose pelvis has that velocity.
    let mut moving = row.clone();
    moving.robot.linear_velocity += linear;
    moving.robot.angular_velocity += Vector3::new(0.1, 0.2, 0.3);
    world.reset_to(&moving).unwrap();
    let by_row = hold(&mut world, &[], None);
    world.reset_to(&row).unwrap();
    let by_push = hold(&mut world, &[], Some(Push { linear, angular: Vector3::new(0.1, 0.2, 0.3) }));
    assert_eq!(by_row, by_push);
}

#[test]
fn a_wrench_is_held_for_the_control_step() {
    let mut world = on_floor("g1_bare");
    let mut row = world.row().clone();
    row.robot.pose.translation.z += 2.0;
    row.robot.pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.7);
    let scene = Arc::clone(world.scene());
    let mut step = |wrenches: &[AppliedWrench]| {
        world.reset_to(&row).unwrap();
        hold(&mut world, wrenches, None)
    };
    let free = step(&[]);
    let (force, still) = (Vector3::new(30.0, -20.0, 50.0), Vector3::zeros());
    let torso = scene.robot.link_index("torso_link").unwrap();
    let at_com = AppliedWrench { target: Target::Link(torso), point: None, wrench: Wrench { force, torque: still } };
    let pulled = step(&[at_com]);
    // Impulse over mass, wherever the force acts; the steps' own error is of second order in their length.
    let gained = pulled.com_velocity - free.com_velocity;
    let expected = force * 0.02 / scene.robot.total_mass();
    assert!((gained - expected).norm() < 0.01 * expected.norm(), "{gained} {expected}");

    // The same force at the link's centre of mass given as a point, and on its body at that point.
    let com = scene.robot.links()[torso].com;
    assert_eq!(step(&[AppliedWrench { point: Some(com), ..at_com }]), pulled);
    let ids = scene.robot_ids.links[torso];
    let point = (ids.body_from_link * nalgebra::Point3::from(com)).coords;
    assert_eq!(step(&[AppliedWrench { target: Target::Body(ids.body), point: Some(point), ..at_com }]), pulled);

    // A force off the centre turns as the torque that goes with it does.
    let arm = Vector3::new(0.0, 0.1, 0.2);
    let off_center = step(&[AppliedWrench { point: Some(com + arm), ..at_com }]);
    world_turn(&scene, &row, torso, arm, force, &at_com, &off_center);
    assert_ne!(off_center, pulled);
}

/// Compares a force off the centre with the force and its torque about the centre.
fn world_turn(
    scene: &Arc<Scene>,
    row: &Row,
    link: usize,
    arm: Vector3<f64>,
    force: Vector3<f64>,
    at_com: &AppliedWrench,
    off_center: &Row,
) {
    let mut world = World::new(Arc::clone(scene));
    world.reset_to(row).unwrap();
    let torque = (world.world_from_link(link).rotation * arm).cross(&force);
    let turned = hold(&mut world, &[AppliedWrench { wrench: Wrench { force, torque }, ..*at_com }], None);
    let gap = turned.robot.angular_velocity - off_center.robot.angular_velocity;
    assert!(gap.norm() < 1e-9, "{gap}");
}

#[test]
fn inputs_that_make_no_sense_change_nothing() {
    let mut world = on_floor("g1_bare");
    let before = world.row().clone();
    let (q0, action) = (world.scene().robot.q0().to_vec(), vec![0.0; 29]);
    let wrench = Wrench { force: Vector3::x(), torque: Vector3::zeros() };
    let bad = Wrench { force: Vector3::x() * f64::NAN, ..wrench };
    let infinite = Some(Vector3::y() * f64::INFINITY);
    let on = |target, point, wrench| [AppliedWrench { target, point, wrench }];
    for wrenches in [
        on(Target::Link(999), None, wrench),
        on(Target::Body(BodyId(999)), None, wrench),
        on(Target::Body(BodyId::WORLD), None, wrench),
        on(Target::Link(0), None, bad),
        on(Target::Link(0), infinite, wrench),
    ] {
        let input = ControlInput { wrenches: &wrenches, ..ControlInput::new(&action, &q0) };
        assert!(matches!(world.step_with(&input), Err(WorldError::Wrench { index: 0, .. })));
    }
    let push = Some(Push { linear: Vector3::zeros(), angular: Vector3::x() * f64::NAN });
    let input = ControlInput { push, ..ControlInput::new(&action, &q0) };
    assert_eq!(world.step_with(&input).err(), Some(WorldError::Push));
    assert_eq!(*world.row(), before);
}

#[test]
fn a_reset_measures_what_follows_from_the_row() {
    for (robot, kind) in [("g1_bare", SceneKind::FreeLadder), ("g1_inspire", SceneKind::Climb)] {
        let scene = scene_of(robot, kind);
        let mut first = World::new(Arc::clone(&scene));
        for _ in 0..7 {
            hold(&mut first, &[], None);
        }
        // A row as it was measured comes back to the last bit, and so does all that a world says of it.
        let mut second = World::new(Arc::clone(&scene));
        second.reset_to(first.row()).unwrap();
        assert_eq!(second.row(), first.row());
        for link in 0..scene.robot.links().len() {
            assert_eq!(second.world_from_link(link), first.world_from_link(link));
        }
        // A row that was changed by hand is measured anew.
        let mut moved = first.row().clone();
        let shift = Isometry3::translation(0.5, -0.25, 0.125);
        moved.robot.pose = shift * moved.robot.pose;
        moved.robot.linear_velocity += Vector3::x();
        second.reset_to(&moved).unwrap();
        let row = second.row();
        for (ours, before) in row.world_from_palm.iter().zip(&first.row().world_from_palm) {
            let moved = ours.translation.vector - before.translation.vector - shift.translation.vector;
            assert!(moved.norm() < 1e-12);
        }
        assert!((row.com_velocity - first.row().com_velocity - Vector3::x()).norm() < 1e-12);
        let palm = scene.robot.palms()[0];
        assert_eq!(second.world_from_link(palm), row.world_from_palm[0]);
        assert_eq!(
            (row.joint_effort.clone(), row.force(errand::FLOOR_FORCE)),
            (first.row().joint_effort.clone(), first.row().force(errand::FLOOR_FORCE))
        );
    }
}

/// A posture that is drawn and set down touches the floor with its lowest sole, and no deeper.
#[test]
fn a_drawn_posture_can_be_set_on_its_soles() {
    let mut world = on_floor("g1_bare");
    let scene = Arc::clone(world.scene());
    let mut row = world.row().clone();
    row.joint_position[scene.robot.joint_index("right_knee_joint").unwrap()] = 0.6;
    let rotation = UnitQuaternion::from_euler_angles(0.05, -0.1, 1.0);
    let height = scene.robot.height_on_soles(&row.joint_position, &rotation).unwrap();
    row.robot.pose = Isometry3::from_parts(Vector3::new(3.0, 1.0, height).into(), rotation);
    world.reset_to(&row).unwrap();
    let contacts = scene.model.contacts_at(&world.state().qpos, 0.05).unwrap();
    let floor = contacts.iter().filter(|contact| {
        use fiatlux_world::ShapeOwner::Floor;
        scene.owner(contact.shape_a) == Floor || scene.owner(contact.shape_b) == Floor
    });
    let lowest = floor.map(|contact| contact.distance).fold(f64::INFINITY, f64::min);
    assert!(lowest.abs() < 1e-9, "{lowest}");
}

/// One scene, two worlds: one has other masses, gains and friction, the other moves as before.
#[test]
fn a_world_can_differ_from_its_scene() {
    let scene = scene_of("g1_bare", SceneParts::FLOOR);
    let roll = |variation: Option<&Variation>| {
        let mut world = World::new(Arc::clone(&scene));
        if let Some(variation) = variation {
            world.set_variation(variation).unwrap();
        }
        (0..10).map(|_| hold(&mut world, &[], None)).last().unwrap()
    };
    let nominal = roll(None);
    assert_eq!(roll(Some(&Variation::default())), nominal);
    let torso = scene.model.body("torso_link").unwrap();
    let knee = scene.model.body("left_knee_link").unwrap();
    let mut variation = Variation {
        bodies: vec![(torso, BodyVariation { mass: 1.3, com_offset: Vector3::new(0.02, 0.0, 0.0) })],
        drives: vec![(knee, DriveVariation { stiffness: 0.8, damping: 1.2, effort_limit: 1.0 })],
        frictions: vec![],
        gravity: None,
    };
    let heavier = roll(Some(&variation));
    let load = |row: &Row| row.force(errand::FLOOR_FORCE)[0].z + row.force(errand::FLOOR_FORCE)[1].z;
    assert!(load(&heavier) > load(&nominal) + 10.0, "{} N, {} N", load(&heavier), load(&nominal));

    // The friction of the hands alone, as a scene that was built with it has it.
    scene.set_hand_friction(0.4, &mut variation);
    assert!(!variation.frictions.is_empty());
    let spec = SceneSpec { hand_friction: Some(0.4), ..scene.spec.clone() };
    let built = Scene::build(&scene.config, Arc::clone(&scene.robot), spec).unwrap();
    for (index, (ours, other)) in scene.model.shapes().iter().zip(built.model.shapes()).enumerate() {
        let set = variation.frictions.iter().find(|(shape, _)| shape.0 == index).map(|(_, friction)| *friction);
        assert_eq!(set.unwrap_or(ours.material.friction), other.material.friction, "{}", ours.name);
    }
    let mut world = World::new(Arc::clone(&scene));
    let wrong = Variation { frictions: vec![(fiatlux_dynamics::ShapeId(9999), 0.5)], ..Variation::default() };
    assert!(matches!(world.set_variation(&wrong), Err(WorldError::Variation(_))));
}

/// The tasks that need no fingers start with a robot that has none that move, and the others say what they lack.
#[test]
fn tasks_start_with_welded_fingers_where_nothing_is_held() {
    for (task, starts) in
        [(Task::S01, true), (Task::S02, true), (Task::S12, true), (Task::Climb, true), (Task::S06, false)]
    {
        let scene = scene_of("g1_bare", SceneKind::of(task));
        match start(scene, task, 0, &StartOptions::default()) {
            Ok(world) => assert!(starts && world.row().present[errand::OLD_BULB]),
            Err(error) => assert!(!starts && error.to_string().contains("start.carry.grip"), "{task}: {error}"),
        }
    }
}
