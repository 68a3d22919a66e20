//! The robot inside the dynamics engine.

use fiatlux_dynamics::{Geometry, Joint, Model, ModelBuilder, ShapeId};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotError, RobotIds};
use nalgebra::{Isometry3, Point3, Vector3};

fn build(robot: &Robot, options: &BuildOptions) -> (Model, RobotIds) {
    let mut builder = ModelBuilder::new();
    let placed = robot.add_to(&mut builder, options).unwrap();
    let model = builder.build().unwrap();
    let ids = placed.ids(&model).unwrap();
    (model, ids)
}

#[test]
fn every_joint_has_its_body_and_drive() {
    let robot = Robot::benchmark().unwrap();
    let (model, ids) = build(&robot, &BuildOptions::new(&robot));
    assert_eq!((model.bodies().len(), model.nq(), model.nv(), model.drives().len()), (55, 60, 59, 53));
    for (joint, at) in robot.joints().iter().zip(&ids.joints) {
        let body = &model.bodies()[at.body.0];
        assert_eq!(body.spec.name, robot.links()[joint.link].name);
        assert_eq!((body.qpos_start, body.dof_start), (at.qpos, at.dof));
        assert_eq!(model.drives()[at.drive], (at.body, joint.gains.drive()));
        let Joint::Hinge(hinge) = &body.spec.joint else { panic!("{} is not a hinge", joint.name) };
        assert_eq!((hinge.lower, hinge.upper, hinge.armature), (joint.lower, joint.upper, joint.gains.armature));
    }
    let firsts: Vec<&str> = [1, 2, 5, 12, 19, 25, 31, 43].map(|i| model.bodies()[i].spec.name.as_str()).into();
    let expected = [
        "pelvis",
        "waist_yaw_link",
        "left_shoulder_pitch_link",
        "right_shoulder_pitch_link",
        "left_hip_pitch_link",
        "right_hip_pitch_link",
        "L_thumb_proximal_base",
        "R_thumb_proximal_base",
    ];
    assert_eq!(firsts, expected);
}

/// Welding must not change what the robot weighs, where its mass is or how it turns.
#[test]
fn welded_links_keep_mass_moment_and_inertia() {
    let robot = Robot::benchmark().unwrap();
    let (model, _) = build(&robot, &BuildOptions::new(&robot));
    let poses = robot.forward_kinematics(&[0.0; 53], &Isometry3::identity()).unwrap();
    let about_origin = |mass: f64, com: Vector3<f64>, pose: &Isometry3<f64>, inertia: &nalgebra::Matrix3<f64>| {
        let arm = (pose * Point3::from(com)).coords;
        let rotation = *pose.rotation.to_rotation_matrix().matrix();
        let steiner = nalgebra::Matrix3::from_diagonal_element(arm.norm_squared()) - arm * arm.transpose();
        (mass, mass * arm, rotation * inertia * rotation.transpose() + mass * steiner)
    };
    let sum = |parts: Vec<(f64, Vector3<f64>, nalgebra::Matrix3<f64>)>| {
        parts
            .into_iter()
            .fold((0.0, Vector3::zeros(), nalgebra::Matrix3::zeros()), |a, b| (a.0 + b.0, a.1 + b.1, a.2 + b.2))
    };
    let links =
        sum(robot.links().iter().zip(&poses).map(|(l, p)| about_origin(l.mass, l.com, p, &l.inertia)).collect());
    let bodies = sum(model.bodies()[1..]
        .iter()
        .map(|b| {
            let link = robot.link_index(&b.spec.name).unwrap();
            about_origin(b.spec.mass, b.spec.com, &poses[link], &b.spec.inertia)
        })
        .collect());
    assert!((links.0 - bodies.0).abs() < 1e-12);
    assert!((links.1 - bodies.1).norm() < 1e-12);
    assert!((links.2 - bodies.2).norm() < 1e-12);
}

#[test]
fn shapes_keep_the_label_of_their_link() {
    let robot = Robot::benchmark().unwrap();
    let mut options = BuildOptions::new(&robot);
    (options.first_label, options.first_cull_group, options.hand_friction) = (100, 7, Some(0.8));
    let (model, ids) = build(&robot, &options);
    assert_eq!(model.shapes().len(), robot.shapes().len());
    for (shape, spec) in robot.shapes().iter().zip(model.shapes()) {
        assert_eq!(spec.label, ids.first_label + shape.link as u32);
        assert_eq!(spec.body, ids.links[shape.link].body);
        assert_eq!(spec.cull_group, 7 + shape.group);
        let hand = robot.hand_links().contains(&shape.link) && !spec.name.contains("wrist");
        let material = (spec.material.friction, spec.material.priority);
        assert_eq!(material, if hand { (0.8, 1) } else { (0.5, 0) }, "{}", spec.name);
    }
    let palm = robot.palms()[0];
    assert_eq!(ids.links[palm].body, model.body("left_wrist_yaw_link").unwrap());
    // Capsules and spheres are much faster to collide than boxes.
    let boxes = model.shapes().iter().filter(|s| matches!(s.geometry, Geometry::Cuboid { .. })).count();
    assert_eq!((model.shapes().len(), boxes), (56, 7));
}

#[test]
fn gains_can_be_changed_before_building() {
    let robot = Robot::benchmark().unwrap();
    let mut options = BuildOptions::new(&robot);
    options.gains = robot.gains(GainSet::Sonic);
    let ankle = robot.joint_index("left_ankle_pitch_joint").unwrap();
    let before = options.gains.0[ankle];
    options.gains.scale([ankle], 8.0);
    let (model, ids) = build(&robot, &options);
    let drive = model.drives()[ids.joints[ankle].drive].1;
    assert_eq!((drive.stiffness, drive.damping), (8.0 * before.stiffness, 8.0 * before.damping));
    options.gains.0.pop();
    let refused = robot.add_to(&mut ModelBuilder::new(), &options);
    assert_eq!(refused, Err(RobotError::Gains { expected: 53, found: 52 }));
}

#[test]
fn a_second_robot_of_the_same_name_is_refused() {
    let robot = Robot::benchmark().unwrap();
    let options = BuildOptions::new(&robot);
    let mut builder = ModelBuilder::new();
    robot.add_to(&mut builder, &options).unwrap();
    assert!(matches!(robot.add_to(&mut builder, &options), Err(RobotError::Engine(_))));
}

/// Names of the shapes that overlap in a posture.
fn overlaps(robot: &Robot, q: &[f64]) -> Vec<(String, String)> {
    let (model, ids) = build(robot, &BuildOptions::new(robot));
    let mut qpos = model.reference_state().qpos;
    for (at, angle) in ids.joints.iter().zip(q) {
        qpos[at.qpos] = *angle;
    }
    let name = |shape: ShapeId| model.shapes()[shape.0].name.clone();
    let contacts = model.contacts_at(&qpos, 0.0).unwrap();
    contacts.iter().filter(|c| c.distance < 0.0).map(|c| (name(c.shape_a), name(c.shape_b))).collect()
}

#[test]
fn nothing_overlaps_while_standing_or_at_zero() {
    let robot = Robot::benchmark().unwrap();
    assert_eq!(overlaps(&robot, robot.q0()), []);
    assert_eq!(overlaps(&robot, &[0.0; 53]), []);
}

#[test]
fn an_arm_does_not_pass_through_the_trunk() {
    let robot = Robot::benchmark().unwrap();
    let mut q = robot.q0().to_vec();
    q[robot.joint_index("left_shoulder_roll_joint").unwrap()] = -0.8;
    let found = overlaps(&robot, &q);
    assert!(
        found.iter().any(|(a, b)| [a, b].iter().all(|n| n.contains("torso") || n.contains("left_shoulder_yaw"))),
        "{found:?}"
    );
}
