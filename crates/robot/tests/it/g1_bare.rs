//! The G1 with welded fingers against the one it is made from.

use fiatlux_dynamics::{Geometry, ModelBuilder};
use fiatlux_robot::{BuildOptions, GainSet, Robot, RobotError};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

const FILE: &str = include_str!("../../robots/g1_bare.toml");

fn pair() -> (Robot, Robot) {
    (Robot::by_name("g1_inspire").unwrap(), Robot::by_name("g1_bare").unwrap())
}

#[test]
fn body_joints_and_gains_are_those_of_the_whole_robot() {
    let (whole, bare) = pair();
    assert_eq!((bare.name(), bare.hand(), bare.joints().len()), ("g1_bare", "bare", 29));
    for (joint, (ours, base)) in bare.joints().iter().zip(whole.joints()).enumerate() {
        assert_eq!((&ours.name, ours.gains, ours.link), (&base.name, base.gains, base.link));
        assert_eq!(bare.links()[ours.link].joint, Some(joint));
    }
    assert_eq!(bare.q0(), &whole.q0()[..29]);
    for set in GainSet::ALL {
        assert_eq!(bare.gains(set).0, whole.gains(set).0[..29]);
    }
    assert_ne!(bare.digest(), whole.digest());
}

#[test]
fn it_weighs_and_stands_the_same() {
    let (whole, bare) = pair();
    assert_eq!(bare.total_mass(), whole.total_mass());
    assert_eq!(bare.standing_height(), whole.standing_height());
    let center = |robot: &Robot| robot.center_of_mass(robot.q0(), &Isometry3::identity()).unwrap();
    assert_eq!(center(&bare), center(&whole));
    let model = |robot: &Robot| {
        let mut builder = ModelBuilder::new();
        robot.add_to(&mut builder, &BuildOptions::new(robot)).unwrap();
        builder.build().unwrap()
    };
    let model = model(&bare);
    assert_eq!((model.nv(), model.drives().len()), (35, 29));
    let mass: f64 = model.bodies().iter().map(|body| body.spec.mass).sum();
    assert!((mass - whole.total_mass()).abs() < 1e-12, "{mass}");
}

/// Wrists, hand base and palm are still sensed; no finger is, and none has a shape.
#[test]
fn its_hands_end_at_the_palm() {
    let (whole, bare) = pair();
    let names: Vec<&str> = bare.hand_links().iter().map(|&link| bare.links()[link].name.as_str()).collect();
    let side = |side: &str| {
        ["wrist_roll_link", "wrist_pitch_link", "wrist_yaw_link", "hand_base_link", "palm"]
            .map(|l| format!("{side}_{l}"))
    };
    assert_eq!(names, [side("right"), side("left")].concat());
    let is_finger = |name: &str| name.starts_with("L_") || name.starts_with("R_");
    let kept: Vec<_> = whole.shapes().iter().filter(|shape| !is_finger(&shape.name)).collect();
    assert_eq!(bare.shapes().iter().collect::<Vec<_>>(), kept);
    assert_eq!((bare.links().len(), bare.palms(), bare.feet()), (whole.links().len(), whole.palms(), whole.feet()));
}

/// A joint is welded at its angle of the standing posture, here a knee that is bent in it.
#[test]
fn welded_joints_keep_their_angle_of_the_standing_posture() {
    let (whole, _) = pair();
    let text = FILE
        .replace("weld_below = [", "weld_below = [\"left_hip_yaw_link\", ")
        .replace("joint_count = 29", "joint_count = 26");
    let welded = Robot::from_toml(&text).unwrap();
    assert_eq!(welded.joint_index("left_knee_joint"), None);
    let world_from_pelvis = Isometry3::new(Vector3::new(0.3, -0.2, 0.8), Vector3::new(0.1, 0.2, 0.3));
    let poses = |robot: &Robot| robot.forward_kinematics(robot.q0(), &world_from_pelvis).unwrap();
    for ((ours, base), link) in poses(&welded).iter().zip(poses(&whole)).zip(whole.links()) {
        let gap = (ours.inverse() * base).to_homogeneous() - nalgebra::Matrix4::identity();
        assert!(gap.norm() < 1e-12, "{}: {gap}", link.name);
    }
}

#[test]
fn broken_files_are_refused_with_the_line_at_fault() {
    for (old, new, at, expected) in [
        ("base = \"g1_inspire\"", "base = \"h1\"", "base", "robot 'h1' is unknown; use one of 'g1_inspire', 'g1_bare'"),
        ("\"left_hand_base_link\"", "\"left_paw\"", "left_paw", "names link 'left_paw'"),
        ("joint_count = 29", "joint_count = 30", "joint_count", "joint_count is 30, the rules leave 29"),
        ("hand_links = 10", "hand_links = 34", "hand_links", "hand_links is 34, the rules leave 10"),
        ("joint_count = 29", "joint_cuont = 29", "joint_cuont", "unknown field `joint_cuont`"),
    ] {
        let text = FILE.replace(old, new);
        let message = Robot::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains(expected), "'{message}' lacks '{expected}'");
        let number: usize = message.strip_prefix("line ").unwrap().split(':').next().unwrap().parse().unwrap();
        assert!(text.lines().nth(number - 1).unwrap().contains(at), "'{message}' points elsewhere");
    }
    // A file cannot stand on one that stands on another.
    let chained = Robot::from_toml(&FILE.replace("base = \"g1_inspire\"", "base = \"g1_bare\""));
    assert!(matches!(chained, Err(RobotError::Syntax { .. })), "{chained:?}");
}

#[test]
fn robots_are_found_by_name_and_by_hand() {
    for name in Robot::NAMES {
        let robot = Robot::by_name(name).unwrap();
        assert_eq!(robot.name(), name);
        assert_eq!(Robot::known(name), Ok(name));
    }
    assert_eq!(Robot::known(""), Ok("g1_inspire"));
    assert_eq!((Robot::known("dex3"), Robot::known("bare")), (Ok("g1_dex3"), Ok("g1_bare")));
    assert_eq!(Robot::by_name("inspire"), Robot::benchmark());
    assert_eq!(Robot::known("g1"), Err(RobotError::Name("g1".into())));
    assert_eq!(Robot::by_name("g1"), Err(RobotError::Name("g1".into())));
    let error = Robot::of_session("", ["knee"].into_iter()).unwrap_err();
    assert!(error.to_string().contains("g1_inspire, g1_bare"), "{error}");
}

/// The lowest corner of the soles, by all corners of all links' shapes, for postures and turns of the pelvis.
#[test]
fn the_soles_touch_the_floor_at_the_height_that_is_given() {
    for robot in [pair().0, pair().1] {
        let knee = robot.joint_index("left_knee_joint").unwrap();
        let roll = robot.joint_index("right_ankle_roll_joint").unwrap();
        for (bend, tilt) in [(0.2, [0.0; 3]), (0.9, [0.1, -0.3, 2.0]), (0.0, [-0.4, 0.2, -1.0])] {
            let mut q = robot.q0().to_vec();
            (q[knee], q[roll]) = (bend, 0.2);
            let rotation = UnitQuaternion::from_euler_angles(tilt[0], tilt[1], tilt[2]);
            let height = robot.height_on_soles(&q, &rotation).unwrap();
            let world_from_pelvis = Isometry3::from_parts(Vector3::new(5.0, -2.0, height).into(), rotation);
            let poses = robot.forward_kinematics(&q, &world_from_pelvis).unwrap();
            let corners = robot.shapes().iter().filter(|shape| robot.feet().contains(&shape.link)).flat_map(|shape| {
                let Geometry::Cuboid { half_extents } = shape.geometry else { panic!("a sole is a box") };
                let world_from_shape = poses[shape.link] * shape.link_from_shape;
                (0..8).map(move |corner| {
                    let sign = Vector3::from_fn(|axis, _| if corner >> axis & 1 == 0 { 1.0 } else { -1.0 });
                    (world_from_shape * Point3::from(half_extents.component_mul(&sign))).z
                })
            });
            let lowest = corners.fold(f64::INFINITY, f64::min);
            assert!(lowest.abs() < 1e-12, "{lowest}");
        }
        assert!(robot.height_on_soles(&[0.0; 3], &UnitQuaternion::identity()).is_err());
    }
}
