#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_dynamics::{BodySpec, Coupling, Drive, Hull, Material, ModelBuilder, ShapeSpec};
use nalgebra::{Matrix3, Translation3};

use super::*;

/// A floor, a free trunk with two arms given out of depth-first order, and a hand on the first arm.
fn small_model() -> Model {
    let mut builder = ModelBuilder::new();
    let hinge = |drive| {
        Joint::Hinge(Hinge { axis: Vector3::y_axis(), lower: -0.5, upper: f64::INFINITY, armature: 0.01, drive })
    };
    let drive = Drive { stiffness: 40.0, damping: 2.5, effort_limit: 35.0, speed_limit: f64::INFINITY };
    let free_drive = Drive { effort_limit: f64::INFINITY, ..drive };
    let mut add = |name: &str, parent, joint, x| {
        let spec = BodySpec {
            name: name.into(),
            parent,
            parent_from_body: Isometry3::translation(x, 0.0, 0.25),
            joint,
            mass: 1.5,
            com: Vector3::new(0.0, 0.0, 0.1),
            inertia: Matrix3::from_diagonal(&Vector3::new(0.1, 0.2, 0.25)),
        };
        builder.add_body(spec).expect("a valid model")
    };
    let trunk = add("trunk", BodyId::WORLD, Joint::Free, 0.0);
    let left = add("left <arm> & \"co\"", trunk, hinge(Some(drive)), 0.1);
    let right = add("right", trunk, hinge(Some(free_drive)), -0.1);
    let hand = add("hand", left, hinge(None), 0.3);
    let material = Material::new(0.8, 0);
    let geometries = [
        (BodyId::WORLD, "floor", Geometry::HalfSpace, material),
        (BodyId::WORLD, "bench", Geometry::Cuboid { half_extents: Vector3::new(0.1, 0.2, 0.3) }, material),
        (trunk, "ball", Geometry::Sphere { radius: 0.05 }, Material { torsion: 1e-4, rolling: 5e-4, ..material }),
        (hand, "pin", Geometry::Capsule { radius: 0.01, half_length: 0.02 }, Material::new(1.2, 1)),
    ];
    let corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]].map(Vector3::from);
    let stone = Geometry::Hull(Arc::new(Hull::new("stone", &corners).expect("a solid")));
    let geometries = geometries.into_iter().chain([(right, "stone", stone, material)]);
    for (cull_group, (body, name, geometry, material)) in geometries.enumerate() {
        let (name, body_from_shape, cull_group) = (name.into(), Isometry3::identity(), cull_group as u16);
        builder
            .add_shape(ShapeSpec { name, body, body_from_shape, geometry, material, cull_group, label: 0 })
            .expect("a valid model");
    }
    builder.exclude(right, hand);
    builder.exclude(trunk, BodyId::WORLD);
    builder.build().expect("a valid model")
}

fn export(option_set: OptionSet) -> String {
    let model = small_model();
    let mut state = model.reference_state();
    // Quarter turn about x: the world's y is then the body's z reversed.
    let pose = Isometry3::from_parts(
        Translation3::new(1.0, 2.0, 3.0),
        UnitQuaternion::from_quaternion(Quaternion::new(0.5f64.sqrt(), 0.5f64.sqrt(), 0.0, 0.0)),
    );
    state.set_pose(&model, BodyId(1), &pose);
    state.qpos[7..].copy_from_slice(&[0.1, 0.2, 0.3]);
    state.qvel.copy_from_slice(&[1.0, 2.0, 3.0, 0.0, 4.0, 0.0, 0.4, 0.5, 0.6]);
    let site = |body, x| Site { body: BodyId(body), body_from_site: Isometry3::translation(x, 0.0, 0.5) };
    let sites = vec![("tip".into(), site(4, 0.1)), ("mark".into(), site(0, 2.0))];
    let cameras = vec![("eye".into(), site(4, 0.1), 1.0_f64.to_radians() * 60.0)];
    let names = Names { sites, cameras, joints: Vec::new() };
    to_mjcf(&model, &state, &[0.7, -0.7], &MjcfOptions { name: "small".into(), timestep: 0.005, option_set, names })
}

#[track_caller]
fn check_contains(xml: &str, expected: &[&str]) {
    for line in expected {
        assert!(xml.lines().any(|l| l.trim() == *line), "missing {line} in\n{xml}");
    }
}

#[test]
fn every_tag_is_closed_in_order_and_every_attribute_quoted() {
    let xml = export(OptionSet::Nearest);
    let mut open = Vec::new();
    for line in xml.lines().map(str::trim) {
        let inner = line.strip_prefix('<').and_then(|l| l.strip_suffix('>')).expect("one tag a line");
        assert!(!inner.contains(['<', '>']), "stray bracket in {line}");
        assert_eq!(inner.matches('"').count() % 2, 0, "stray quote in {line}");
        let tag = inner.trim_matches('/').split(' ').next().expect("a tag");
        if inner.starts_with('/') {
            assert_eq!(open.pop(), Some(tag), "{line}");
        } else if !inner.ends_with('/') {
            open.push(tag);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

#[test]
fn bodies_and_joints() {
    let inertial = r#"<inertial pos="0 0 0.1" mass="1.5" diaginertia="0.1 0.2 0.25"/>"#;
    check_contains(
        &export(OptionSet::Nearest),
        &[
            r#"<body name="trunk" pos="0 0 0.25" quat="1 0 0 0">"#,
            r#"<freejoint name="trunk"/>"#,
            inertial,
            r#"<joint name="hand" type="hinge" axis="0 1 0" range="-0.5 1000000" armature="0.01"/>"#,
            r#"<exclude body1="world" body2="trunk"/>"#,
            r#"<exclude body1="right" body2="hand"/>"#,
        ],
    );
}

#[test]
fn a_coupling_is_an_equality_of_two_joints() {
    assert!(!export(OptionSet::Nearest).contains("equality"));
    let mut builder = ModelBuilder::new();
    let mut above = BodyId::WORLD;
    for name in ["inner", "outer"] {
        let hinge = Hinge { axis: Vector3::y_axis(), lower: -1.0, upper: 1.0, armature: 0.0, drive: None };
        let spec = BodySpec {
            name: name.into(),
            parent: above,
            parent_from_body: Isometry3::identity(),
            joint: Joint::Hinge(hinge),
            mass: 1.0,
            com: Vector3::zeros(),
            inertia: Matrix3::identity(),
        };
        above = builder.add_body(spec).unwrap();
    }
    builder.couple(Coupling { follower: above, leader: BodyId(1), ratio: 1.6, offset: -0.2 }).unwrap();
    let (model, names) = (builder.build().unwrap(), Names::default());
    let options = MjcfOptions { name: "finger".into(), timestep: 0.005, option_set: OptionSet::Nearest, names };
    let xml = to_mjcf(&model, &model.reference_state(), &[], &options);
    let equality = r#"<joint joint1="outer" joint2="inner" polycoef="-0.2 1.6 0 0 0" solref="0.01 1" solimp="0.9999 0.9999 0.001"/>"#;
    // The follower's range bounds the leader, and has no force of its own.
    let outer = r#"<joint name="outer" type="hinge" axis="0 1 0" range="-1 1" limited="false"/>"#;
    let inner = r#"<joint name="inner" type="hinge" axis="0 1 0" range="-0.5 0.7499999999999999"/>"#;
    check_contains(&xml, &[inner, outer, "<equality>", equality, "</equality>"]);
}

#[test]
fn a_tilted_inertia_is_written_in_full() {
    let mut builder = ModelBuilder::new();
    let inertia = Matrix3::new(0.3, 0.01, 0.02, 0.01, 0.2, 0.03, 0.02, 0.03, 0.25);
    let spec = BodySpec {
        name: "block".into(),
        parent: BodyId::WORLD,
        parent_from_body: Isometry3::identity(),
        joint: Joint::Free,
        mass: 1.0,
        com: Vector3::zeros(),
        inertia,
    };
    builder.add_body(spec).expect("a valid model");
    let model = builder.build().expect("a valid model");
    let options =
        MjcfOptions { name: "block".into(), timestep: 1e-3, option_set: OptionSet::Nearest, names: Names::default() };
    let xml = to_mjcf(&model, &model.reference_state(), &[], &options);
    let inertial = r#"<inertial pos="0 0 0" mass="1" fullinertia="0.3 0.2 0.25 0.01 0.02 0.03"/>"#;
    let laws = r#"integrator="implicitfast" cone="elliptic" impratio="100""#;
    check_contains(&xml, &[inertial, &format!(r#"<option timestep="0.001" gravity="0 0 -9.81" {laws}/>"#)]);
    assert!(!xml.contains("ctrl") && !xml.contains("<actuator"), "nothing is driven:\n{xml}");
}

/// Each within the tag of its body; a site of the world comes before all bodies.
#[test]
fn sites() {
    let xml = export(OptionSet::Nearest);
    let place = |text: &str| xml.find(text).unwrap_or_else(|| panic!("missing {text} in\n{xml}"));
    let tip = place(r#"<site name="tip" pos="0.1 0 0.5" quat="1 0 0 0"/>"#);
    assert!(tip > place(r#"<body name="hand""#) && tip < place(r#"<body name="right""#));
    assert!(place(r#"<site name="mark" pos="2 0 0.5" quat="1 0 0 0"/>"#) < place("<body "));
}

/// A camera looks along the site's x with z up; MuJoCo's along its -z with y up.
#[test]
fn cameras_turn_into_mujoco_s() {
    let xml = export(OptionSet::Nearest);
    let line = xml.lines().find(|line| line.contains(r#"<camera name="eye""#)).unwrap();
    assert!(line.contains(r#"pos="0.1 0 0.5" quat=""#), "{line}");
    let field = |name: &str| line.split(&format!("{name}=\"")).nth(1).unwrap().split('"').next().unwrap();
    let q: Vec<f64> = field("quat").split(' ').map(|number| number.parse().unwrap()).collect();
    let turn = UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3]));
    assert!((turn * -Vector3::z() - Vector3::x()).norm() < 1e-9 && (turn * Vector3::y() - Vector3::z()).norm() < 1e-9);
    assert!((field("fovy").parse::<f64>().unwrap() - 60.0).abs() < 1e-9, "{line}");
}

/// Joints, actuators and cameras of a robot have the names of the contract.
#[test]
fn names_are_those_of_the_contract() {
    let scene = ExportScene::robot_only("g1_inspire", true).unwrap();
    let options = MjcfOptions {
        name: scene.name.clone(),
        timestep: 0.005,
        option_set: OptionSet::Nearest,
        names: scene.names.clone(),
    };
    let xml = to_mjcf(&scene.model, &scene.state, &scene.targets, &options);
    let robot = Robot::by_name("g1_inspire").unwrap();
    for joint in robot.joints() {
        let name = &joint.name;
        assert!(xml.contains(&format!(r#"<joint name="{name}""#)), "{name}");
        assert!(xml.contains(&format!(r#"<position name="{name}" joint="{name}""#)), "{name}");
    }
    for camera in robot.cameras() {
        assert!(xml.contains(&format!(r#"<camera name="{}""#, camera.name)));
    }
    check_contains(
        &xml,
        &[
            r#"<site name="imu" pos="0 0 0" quat="1 0 0 0"/>"#,
            r#"<gyro name="base_angular_velocity" site="imu"/>"#,
            r#"<velocimeter name="base_linear_velocity" site="imu"/>"#,
            r#"<accelerometer name="base_acceleration" site="imu"/>"#,
            r#"<framequat name="base_quaternion" objtype="site" objname="imu"/>"#,
        ],
    );
    assert!(!export(OptionSet::Nearest).contains("<sensor>"), "without a robot there is nothing to sense");
}

#[test]
fn shapes() {
    check_contains(
        &export(OptionSet::Nearest),
        &[
            r#"<geom name="floor" type="plane" size="0 0 1" pos="0 0 0" quat="1 0 0 0" friction="0.8 0 0" condim="3" material="floor"/>"#,
            r#"<geom name="bench" type="box" size="0.1 0.2 0.3" pos="0 0 0" quat="1 0 0 0" friction="0.8 0 0" condim="3" material="wood"/>"#,
            r#"<geom name="ball" type="sphere" size="0.05" pos="0 0 0" quat="1 0 0 0" friction="0.8 0.0001 0.0005" condim="6" material="robot"/>"#,
            r#"<geom name="pin" type="capsule" size="0.01 0.02" pos="0 0 0" quat="1 0 0 0" friction="1.2 0 0" condim="3" priority="1" material="robot"/>"#,
            r#"<geom name="stone" type="mesh" mesh="stone" pos="0 0 0" quat="1 0 0 0" friction="0.8 0 0" condim="3" material="robot"/>"#,
            r#"<mesh name="stone" vertex="0 0 0 0.1 0 0 0 0.2 0 0 0 0.3"/>"#,
        ],
    );
}

#[test]
fn names_are_escaped_and_damping_is_where_the_laws_want_it() {
    let escaped = "left &lt;arm&gt; &amp; &quot;co&quot;";
    let joint = format!(r#"<joint name="{escaped}" type="hinge" axis="0 1 0" range="-0.5 1000000" armature="0.01""#);
    let position = format!(r#"<position name="{escaped}" joint="{escaped}" kp="40""#);
    check_contains(
        &export(OptionSet::Nearest),
        &[
            &format!("{joint}/>"),
            &format!(r#"{position} kv="2.5" forcerange="-35 35"/>"#),
            r#"<position name="right" joint="right" kp="40" kv="2.5"/>"#,
        ],
    );
    check_contains(
        &export(OptionSet::Defaults),
        &[
            &format!(r#"{joint} damping="2.5"/>"#),
            &format!(r#"{position} forcerange="-35 35"/>"#),
            r#"<option timestep="0.005" gravity="0 0 -9.81"/>"#,
        ],
    );
}

/// Depth first, the hand comes before the right arm; the spin is in the trunk's axes.
#[test]
fn the_keyframe_is_in_the_order_and_terms_of_mujoco() {
    let xml = export(OptionSet::Nearest);
    let key = xml.lines().find(|l| l.contains("<key ")).expect("a keyframe");
    let field = |name: &str| -> Vec<f64> {
        let text = key.split(&format!(" {name}=\"")).nth(1).expect("the field").split('"').next().expect("a value");
        text.split(' ').map(|number| number.parse().expect("a number")).collect()
    };
    let half = 0.5f64.sqrt();
    assert_eq!(field("qpos"), [1.0, 2.0, 3.0, half, half, 0.0, 0.0, 0.1, 0.3, 0.2]);
    assert_eq!(field("ctrl"), [0.7, -0.7]);
    for (found, expected) in field("qvel").iter().zip([1.0, 2.0, 3.0, 0.0, 0.0, -4.0, 0.4, 0.6, 0.5]) {
        assert!((found - expected).abs() < 1e-15, "{key}");
    }
    let order: Vec<&str> = xml.lines().filter(|l| l.contains("objtype")).map(str::trim).collect();
    assert_eq!(order.len(), 5);
    assert_eq!(order[3], r#"<element objtype="body" objname="right"/>"#);
}
