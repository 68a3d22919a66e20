//! The G1 of the data file against its published figures.

use fiatlux_dynamics::Geometry;
use fiatlux_robot::{GainSet, Robot, RobotError};
use nalgebra::{Isometry3, Vector3};

fn g1() -> Robot {
    Robot::benchmark().expect("the embedded robot loads")
}

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance
}

#[test]
fn masses_are_those_of_the_weighed_robot() {
    let robot = g1();
    assert!(close(robot.total_mass(), 34.58, 0.005), "{}", robot.total_mass());
    for side in robot.hand_links().chunks(17) {
        // The three wrist links are not part of the hand unit.
        let unit: f64 = side[3..].iter().map(|&l| robot.links()[l].mass).sum();
        assert!(close(unit, 0.790, 1e-9), "{unit}");
    }
}

/// Heights and centre of mass as MuJoCo gives them for the same figures.
#[test]
fn stands_flat_with_the_pelvis_at_its_published_height() {
    let robot = g1();
    assert!(close(robot.standing_height(), 0.788, 5e-4), "{}", robot.standing_height());
    let poses = robot.forward_kinematics(robot.q0(), &Isometry3::identity()).unwrap();
    for &foot in robot.feet() {
        assert!(poses[foot].rotation.angle() < 1e-9, "the sole is tilted by {}", poses[foot].rotation.angle());
    }
    let com = robot.center_of_mass(robot.q0(), &Isometry3::identity()).unwrap();
    assert!((com - Vector3::new(0.03182, 0.00008, -0.08153)).norm() < 1e-4, "{com}");
}

/// The source gives (0.022, 0, -0.088) for the published masses, with 0.192 kg for each hand.
#[test]
fn centre_of_mass_agrees_with_the_source_for_its_lighter_hands() {
    let light = include_str!("../../robots/g1_inspire.toml")
        .replace("mass = 0.7396329", "mass = 0.14143")
        .replace("mass = 0.7396398", "mass = 0.14143")
        .replace("total_mass = 34.5811", "total_mass = 33.3847");
    let robot = Robot::from_toml(&light).unwrap();
    let com = robot.center_of_mass(robot.q0(), &Isometry3::identity()).unwrap();
    assert!((com - Vector3::new(0.022, 0.0, -0.088)).norm() < 1e-3, "{com}");
}

#[test]
fn joints_stand_in_public_order() {
    let robot = g1();
    let names: Vec<&str> = robot.joints().iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names.len(), 53);
    let places = [
        (0, "left_hip_pitch_joint"),
        (5, "left_ankle_roll_joint"),
        (6, "right_hip_pitch_joint"),
        (12, "waist_yaw_joint"),
        (13, "waist_roll_joint"),
        (14, "waist_pitch_joint"),
        (15, "left_shoulder_pitch_joint"),
        (22, "right_shoulder_pitch_joint"),
        (28, "right_wrist_yaw_joint"),
        (29, "L_thumb_proximal_yaw_joint"),
        (40, "L_pinky_intermediate_joint"),
        (41, "R_thumb_proximal_yaw_joint"),
        (52, "R_pinky_intermediate_joint"),
    ];
    for (index, name) in places {
        assert_eq!(names[index], name);
        assert_eq!(robot.joint_index(name), Some(index));
    }
    let bent: Vec<(&str, f64)> = names.iter().copied().zip(robot.q0().iter().copied()).filter(|x| x.1 != 0.0).collect();
    let expected = ["left", "right"].map(|side| {
        [("hip_pitch", -0.05), ("knee", 0.2), ("ankle_pitch", -0.15)].map(|(j, q)| (format!("{side}_{j}_joint"), q))
    });
    let expected: Vec<(&str, f64)> = expected.iter().flatten().map(|(name, q)| (name.as_str(), *q)).collect();
    assert_eq!(bent, expected);
}

#[test]
fn sensed_hand_links_are_right_then_left() {
    let robot = g1();
    let names: Vec<&str> = robot.hand_links().iter().map(|&l| robot.links()[l].name.as_str()).collect();
    assert_eq!(names.len(), 34);
    assert_eq!(
        names[..6],
        [
            "right_wrist_roll_link",
            "right_wrist_pitch_link",
            "right_wrist_yaw_link",
            "right_hand_base_link",
            "right_palm",
            "R_thumb_proximal_base"
        ]
    );
    assert_eq!(names[16], "R_pinky_intermediate");
    assert_eq!(names[17], "left_wrist_roll_link");
    assert_eq!(names[33], "L_pinky_intermediate");
    // 63 links of the source and two palms.
    assert_eq!(robot.links().len(), 65);
    for frame in ["imu_in_pelvis", "d435_link", "mid360_link"] {
        assert_eq!(robot.links()[robot.link_index(frame).unwrap()].mass, 0.0);
    }
}

/// Figures of the published configuration and of the controllers trained at 10 Hz.
#[test]
fn gains_match_their_tables() {
    let robot = g1();
    let check = |set, table: &[(&str, f64, f64, f64)]| {
        let gains = robot.gains(set);
        for &(name, stiffness, damping, effort_limit) in table {
            let g = gains.0[robot.joint_index(name).unwrap()];
            assert!(close(g.stiffness, stiffness, 5e-4 * stiffness), "{set} {name}: {g:?}");
            assert!(close(g.damping, damping, 5e-4 * damping), "{set} {name}: {g:?}");
            assert_eq!(g.effort_limit, effort_limit, "{set} {name}");
        }
    };
    check(
        GainSet::Fiatlux,
        &[
            ("left_hip_pitch_joint", 150.0, 2.0, 139.0),
            ("right_hip_yaw_joint", 150.0, 2.0, 88.0),
            ("left_knee_joint", 200.0, 4.0, 139.0),
            ("right_ankle_roll_joint", 40.0, 2.0, 50.0),
            ("waist_yaw_joint", 250.0, 5.0, 88.0),
            ("waist_pitch_joint", 250.0, 5.0, 50.0),
            ("left_shoulder_roll_joint", 100.0, 2.0, 25.0),
            ("right_shoulder_yaw_joint", 50.0, 2.0, 25.0),
            ("left_elbow_joint", 50.0, 2.0, 25.0),
            ("left_wrist_roll_joint", 20.0, 1.0, 25.0),
            ("right_wrist_yaw_joint", 20.0, 1.0, 5.0),
            ("L_thumb_distal_joint", 3.0, 1.0, 0.5),
        ],
    );
    check(
        GainSet::Sonic,
        &[
            ("left_hip_pitch_joint", 99.0984, 6.30880, 139.0),
            ("right_hip_yaw_joint", 40.1792, 2.55789, 88.0),
            ("left_knee_joint", 99.0984, 6.30880, 139.0),
            ("right_ankle_roll_joint", 28.5012, 1.81445, 50.0),
            ("waist_yaw_joint", 40.1792, 2.55789, 88.0),
            ("waist_pitch_joint", 28.5012, 1.81445, 50.0),
            ("left_shoulder_roll_joint", 14.2506, 0.90722, 25.0),
            ("left_wrist_roll_joint", 14.2506, 0.90722, 25.0),
            ("right_wrist_yaw_joint", 16.7783, 1.06814, 5.0),
            ("R_index_proximal_joint", 3.0, 1.0, 0.5),
        ],
    );
    let gear = [
        ("left_hip_pitch_joint", 150.0, 2.0, 139.0),
        ("right_ankle_roll_joint", 40.0, 2.0, 50.0),
        ("waist_yaw_joint", 250.0, 5.0, 88.0),
        ("left_shoulder_roll_joint", 100.0, 5.0, 25.0),
        ("right_elbow_joint", 40.0, 2.0, 25.0),
        ("right_wrist_yaw_joint", 20.0, 2.0, 5.0),
        ("R_index_proximal_joint", 3.0, 1.0, 0.5),
    ];
    for (set, knee) in [(GainSet::Gear, 200.0), (GainSet::GearLerobot, 300.0)] {
        check(set, &gear);
        check(set, &[("right_knee_joint", knee, 4.0, 139.0)]);
    }
}

/// GEAR's sets name each joint of the body: without fingers, none keeps the gains of its file by a misspelt name.
#[test]
fn gear_gains_are_of_all_joints_of_the_body() {
    let robot = g1();
    let body = &robot.joints()[..29];
    for set in [GainSet::Gear, GainSet::GearLerobot] {
        let gains = robot.gains(set).0;
        let arms = body.iter().zip(&gains).filter(|(joint, gains)| joint.gains.damping != gains.damping);
        // The benchmark's shoulders of pitch and roll have a damping of 2, its wrists of 1.
        assert_eq!(arms.count(), 2 * (2 + 3), "{set}");
        assert!(gains[..29].iter().all(|gains| gains.damping >= 2.0), "{set}");
    }
}

/// Left and right are mirror images. The source's hands differ by fractions of a millimetre, and the zero of its
/// right thumb's yaw is 0.1135 rad off.
#[test]
fn left_mirrors_right() {
    let robot = g1();
    let flip = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
    let (mut links, mut shapes) = (0, 0);
    for left in robot.links().iter().filter(|l| l.name.starts_with("left_") && l.name.ends_with("_link")) {
        if left.name.contains("hand") {
            continue;
        }
        let right = &robot.links()[robot.link_index(&left.name.replace("left", "right")).unwrap()];
        assert_eq!(left.mass, right.mass, "{}", left.name);
        assert!((flip(left.com) - right.com).norm() < 2e-6, "{}: {} {}", left.name, left.com, right.com);
        links += 1;
    }
    let mut q = robot.q0().to_vec();
    q[robot.joint_index("R_thumb_proximal_yaw_joint").unwrap()] = -0.1135;
    let poses = robot.forward_kinematics(&q, &Isometry3::identity()).unwrap();
    for left in robot.shapes().iter().filter(|s| s.name.starts_with("left_") || s.name.starts_with("L_")) {
        let name = left.name.replacen("left_", "right_", 1).replacen("L_", "R_", 1);
        let right = robot.shapes().iter().find(|s| s.name == name).unwrap();
        let (a, b) = (poses[left.link] * left.link_from_shape, poses[right.link] * right.link_from_shape);
        let gap = (flip(a.translation.vector) - b.translation.vector).norm();
        assert!(gap < 1e-3, "{}: {gap}", left.name);
        assert_eq!(size(&left.geometry), size(&right.geometry), "{}", left.name);
        shapes += 1;
    }
    assert_eq!((links, shapes), (13, 26));
}

fn size(geometry: &Geometry) -> [i64; 3] {
    let nm = |x: f64| (x * 1e9).round() as i64;
    match *geometry {
        Geometry::HalfSpace | Geometry::Hull(_) => [0; 3],
        Geometry::Sphere { radius } => [nm(radius), 0, 0],
        Geometry::Capsule { radius, half_length } => [nm(radius), nm(half_length), 0],
        Geometry::Cuboid { half_extents } => [nm(half_extents.x), nm(half_extents.y), nm(half_extents.z)],
    }
}

#[test]
fn soles_are_at_their_published_height() {
    let robot = g1();
    for &foot in robot.feet() {
        let sole = robot.shapes().iter().find(|s| s.link == foot).unwrap();
        let Geometry::Cuboid { half_extents } = sole.geometry else { panic!("the sole is a box") };
        assert!(close(sole.link_from_shape.translation.z - half_extents.z, -0.035, 1e-12));
    }
}

#[test]
fn gain_sets_are_refused_by_name() {
    for set in GainSet::ALL {
        assert_eq!(set.to_string().parse(), Ok(set));
    }
    assert_eq!("stiff".parse::<GainSet>(), Err(RobotError::GainSet("stiff".into())));
}

#[test]
fn kinematics_refuses_a_wrong_posture() {
    let robot = g1();
    assert!(robot.forward_kinematics(&[0.0; 52], &Isometry3::identity()).is_err());
    assert!(robot.forward_kinematics(&[f64::NAN; 53], &Isometry3::identity()).is_err());
}

/// The effort that holds a joint is the slope of the potential energy over its angle, which the centre of mass gives.
#[test]
fn efforts_that_hold_the_links_are_the_slope_of_the_potential_energy() {
    let robot = g1();
    let gravity = Vector3::new(2.0, -1.0, -9.5);
    let mut q = robot.q0().to_vec();
    for (index, angle) in q.iter_mut().enumerate() {
        *angle += 0.3 * libm::sin(index as f64);
    }
    let energy = |q: &[f64]| {
        let com = robot.center_of_mass(q, &Isometry3::identity()).unwrap();
        -robot.total_mass() * gravity.dot(&com)
    };
    let efforts = robot.holding_efforts(&q, gravity.into()).unwrap();
    assert!(efforts.iter().any(|effort| effort.abs() > 5.0));
    for (index, effort) in efforts.iter().enumerate() {
        let at = |change: f64| {
            let mut changed = q.clone();
            changed[index] += change;
            energy(&changed)
        };
        let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
        assert!(close(*effort, slope, 1e-5), "{}: {effort} and {slope}", robot.joints()[index].name);
    }
    assert!(robot.holding_efforts(&q, [0.0, f64::NAN, 0.0]).is_err());
}

/// Soles and palms where the data sheets have them; a fingertip is the far end of its finger.
#[test]
fn sites_are_palms_soles_and_fingertips() {
    let robot = g1();
    let names: Vec<String> = robot.sites().into_iter().map(|site| site.name).collect();
    let fingers = ["thumb", "index", "middle", "ring", "pinky"];
    let tips = ["left", "right"].iter().flat_map(|side| fingers.map(|finger| format!("{side}_{finger}_tip")));
    let others = ["left_palm", "right_palm", "left_sole", "right_sole"].map(String::from);
    assert_eq!(names, others.into_iter().chain(tips).collect::<Vec<_>>());

    let at_rest = Isometry3::translation(0.0, 0.0, robot.standing_height());
    let poses = robot.forward_kinematics(robot.q0(), &at_rest).unwrap();
    for sole in robot.soles() {
        for corner in sole.corners() {
            assert!((poses[sole.site.link] * nalgebra::Point3::from(corner)).z.abs() < 1e-9);
        }
        assert_eq!(sole.half_extents, [0.101, 0.033]);
    }
    for site in robot.sites().iter().filter(|site| site.name.ends_with("_tip")) {
        let palm = robot.palms()[usize::from(site.name.starts_with("right"))];
        let from_palm = |pose: Isometry3<f64>| (pose.translation.vector - poses[palm].translation.vector).norm();
        let (tip, knuckle) = (from_palm(poses[site.link] * site.link_from_site), from_palm(poses[site.link]));
        assert!(tip > knuckle + 0.01 && tip < 0.15, "{}: {tip} {knuckle}", site.name);
    }
    let bare = Robot::by_name("g1_bare").unwrap().sites();
    assert_eq!(bare.len(), 4, "welded fingers have no shapes");
}
