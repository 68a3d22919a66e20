//! The G1 with Dex3 hands against the one with Inspire hands, and its grasp.

use fiatlux_robot::{BODY, GainSet, LEGS, MOVED, Robot};

const FILE: &str = include_str!("../../robots/g1_dex3.toml");

fn dex3() -> Robot {
    Robot::by_name("g1_dex3").unwrap()
}

/// Code counts joints from the first one on: the files' groups say the same.
#[test]
fn every_robot_begins_with_legs_waist_and_arms() {
    for name in Robot::NAMES {
        let robot = Robot::by_name(name).unwrap();
        let groups = robot.joint_groups();
        let mut legs: Vec<usize> = groups.legs.iter().chain(&groups.ankles).copied().collect();
        legs.sort_unstable();
        assert!(legs.into_iter().eq(0..LEGS), "{name}");
        assert!(groups.waist.iter().copied().eq(LEGS..MOVED), "{name}");
        assert!(groups.fingers.iter().copied().eq(BODY..robot.joints().len()), "{name}");
    }
}

#[test]
fn its_body_is_that_of_the_g1() {
    let (ours, inspire) = (dex3(), Robot::by_name("g1_inspire").unwrap());
    assert_eq!((ours.hand(), ours.joints().len(), ours.hand_links().len()), ("dex3", 43, 24));
    for (ours, other) in ours.joints().iter().zip(inspire.joints()).take(BODY) {
        assert_eq!((&ours.name, ours.gains, ours.axis), (&other.name, other.gains, other.axis));
        assert_eq!((ours.lower, ours.upper), (other.lower, other.upper));
    }
    let is_of_hand = |name: &str| name.contains("_hand_") || name.contains("palm") || &name[1..2] == "_";
    let body = |robot: &Robot| -> Vec<_> {
        let links = robot.links().iter().filter(|link| !is_of_hand(&link.name));
        links.map(|link| (link.name.clone(), link.mass, link.parent_from_link)).collect()
    };
    assert_eq!(body(&ours), body(&inspire));
    let shapes = |robot: &Robot| -> Vec<_> {
        let shapes = robot.shapes().iter().filter(|shape| !is_of_hand(&robot.links()[shape.link].name));
        shapes.map(|shape| (shape.name.clone(), shape.link_from_shape, shape.geometry.clone())).collect()
    };
    assert_eq!(shapes(&ours), shapes(&inspire));
    for set in GainSet::ALL {
        assert_eq!(ours.gains(set).0[..BODY], inspire.gains(set).0[..BODY]);
    }
}

/// Each palm's frame is where the fingers start; its face looks at the other palm, and the index finger is on the same side as
/// on the other hand.
#[test]
fn its_fingers_have_tips_ahead_of_the_palms() {
    let robot = dex3();
    let links = robot.forward_kinematics(robot.q0(), &nalgebra::Isometry3::identity()).unwrap();
    let sites = robot.sites();
    let names: Vec<&str> = sites.iter().map(|site| site.name.as_str()).collect();
    let fingers = ["thumb", "middle", "index"];
    for side in ["left", "right"] {
        for name in fingers.map(|finger| format!("{side}_{finger}_tip")).into_iter().chain([format!("{side}_palm")]) {
            assert!(names.contains(&name.as_str()), "{name} is not in {names:?}");
        }
        let pose = |name: String| {
            let site = sites.iter().find(|site| site.name == name).unwrap();
            links[site.link] * site.link_from_site
        };
        let palm = pose(format!("{side}_palm"));
        // A straight finger: 45.8 mm and 51.96 mm from its knuckle, less what the fitted box is shorter than the mesh.
        for finger in ["middle", "index"] {
            let tip = palm.inverse() * pose(format!("{side}_{finger}_tip"));
            assert!((-0.0985..-0.085).contains(&tip.translation.y), "{side} {finger} {tip}");
            let outwards = tip.rotation * nalgebra::Vector3::z();
            assert!((outwards + nalgebra::Vector3::y()).norm() < 1e-9, "{side} {finger} {outwards}");
        }
        let thumb = palm.inverse() * pose(format!("{side}_thumb_tip"));
        assert!(thumb.translation.x < -0.1, "{side} {thumb}");
    }
}

#[test]
fn broken_grasps_are_refused_by_line_and_field() {
    for (old, new, expected) in [
        ("link = \"right_palm\"\nglass", "link = \"right_plam\"\nglass", "names link 'right_plam'"),
        ("glass_height = 0.1531", "glass_height = inf", "glass_height outside 0 to 1"),
        ("glass_tilt = [0, 0]", "glass_tilt = [0, 4]", "glass_tilt outside -3.2 to 3.2"),
        ("grip.right_hand_thumb_1_joint = -0.6", "grip.right_hand_thumb_1_joint = -6", "beyond its limits"),
        ("grip.right_hand_thumb_1_joint", "grip.right_thumb_1_joint", "names joint 'right_thumb_1_joint'"),
    ] {
        assert!(FILE.contains(old), "the file has no '{old}'");
        let error = Robot::from_toml(&FILE.replacen(old, new, 1)).unwrap_err().to_string();
        assert!(error.contains("bulb_grasp") && error.contains(expected), "{error}");
        let line: usize = error.strip_prefix("line ").and_then(|rest| rest.split(':').next()?.parse().ok()).unwrap();
        let at = FILE.lines().nth(line - 1).unwrap();
        assert!(old.lines().any(|part| at.contains(part.split(' ').next().unwrap())), "'{error}' points at '{at}'");
    }
}
