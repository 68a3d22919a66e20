//! Fingers close between two postures, press no harder than they may, and know whose they are.

use fiatlux_proto::v3::Joint;
use fiatlux_robot::{BODY, Robot};
use fiatlux_skills::grip::{Carrying, FINGERS, Finger, Grip, HandBodies, Hold, finger, grasp_of, on_side, side};

const STIFFNESS: f64 = 2.0;

fn joints(robot: &Robot) -> Vec<Joint> {
    let joint = |joint: &fiatlux_robot::Joint| Joint {
        name: joint.name.clone(),
        lower: joint.lower,
        upper: joint.upper,
        stiffness: STIFFNESS,
        effort_limit: 0.5,
        ..Joint::default()
    };
    robot.joints().iter().map(joint).collect()
}

/// The grasp moves every joint of the right hand and no other.
#[test]
fn every_hand_has_its_own_grasp() {
    for name in ["g1_inspire", "g1_dex3"] {
        let robot = Robot::by_name(name).unwrap();
        let grasp = grasp_of(&robot, 1);
        let fingers = robot.joints().iter().skip(BODY).map(|joint| joint.name.as_str());
        let right: Vec<&str> = fingers.filter(|name| side(name).unwrap().0 == 1).collect();
        assert!(right.iter().all(|name| grasp.contains_key(*name) && finger(name).is_some()), "{name}: {grasp:?}");
        assert_eq!(grasp.len(), right.len(), "{name}");
    }
}

/// The left hand has the same grasp by its own names, and what is on no side keeps its name.
#[test]
fn the_left_hand_has_the_mirrored_grasp() {
    for name in ["g1_inspire", "g1_dex3", "g1_inspire6"] {
        let robot = Robot::by_name(name).unwrap();
        let [left, right] = [0, 1].map(|side| grasp_of(&robot, side));
        assert_eq!(left.len(), right.len(), "{name}");
        assert!(left.keys().all(|joint| side(joint).unwrap().0 == 0 && robot.joint_index(joint).is_some()), "{left:?}");
        assert!(right.iter().all(|(joint, angle)| left[&on_side(joint, 0)] == *angle), "{name}");
    }
    assert_eq!(["R_a", "right_a", "L_a", "waist_a"].map(|name| on_side(name, 1)), ["R_a", "right_a", "R_a", "waist_a"]);
}

/// A finger that presses against something stops short of it, however it is turned, and opens freely.
#[test]
fn a_torque_bounds_what_closes_and_not_what_opens() {
    for (name, joint) in [("g1_inspire", "R_index_proximal_joint"), ("g1_dex3", "right_hand_thumb_1_joint")] {
        let robot = Robot::by_name(name).unwrap();
        let (all, index) = (joints(&robot), robot.joint_index(joint).unwrap());
        let closed = grasp_of(&robot, 1);
        let grip = Grip::new(&all, &[(joint.to_owned(), 0.0)].into(), &closed);
        let way = closed[joint];
        let mut sensed = vec![0.0; all.len()];
        sensed[index] = 0.5 * way;
        let target = |share: f64, torque: Option<f64>| {
            let mut targets = vec![0.0; all.len()];
            grip.write(&[Finger { share, torque }; FINGERS.len()], Some(&sensed), &mut targets);
            targets[index]
        };
        assert_eq!(target(1.0, None), way);
        let bend = target(1.0, Some(0.1)) - sensed[index];
        assert!((bend - way.signum() * 0.1 / STIFFNESS).abs() < 1e-12, "{name}: {bend}");
        assert_eq!(target(0.0, Some(0.1)), 0.0, "{name} opens");
    }
}

/// A grip is at its limit where a target asks one of its own joints for all that its drive has, either way; a hold at its start is not.
#[test]
fn a_grip_knows_when_its_drives_give_all_that_they_have() {
    let robot = Robot::by_name("g1_inspire").unwrap();
    let (all, closed) = (joints(&robot), grasp_of(&robot, 1));
    let grip = Grip::new(&all, &closed, &closed);
    let [own, other] =
        ["R_index_proximal_joint", "L_index_proximal_joint"].map(|name| robot.joint_index(name).unwrap());
    let sensed = vec![0.3; all.len()];
    let asks = |joint: usize, torque: f64| {
        let mut targets = sensed.clone();
        targets[joint] += torque / STIFFNESS;
        grip.is_at_limit(&sensed, &targets)
    };
    assert!(asks(own, 0.51) && asks(own, -0.51));
    assert!(!asks(own, 0.49) && !asks(other, 2.0) && !asks(0, 2.0));
    let mut targets = vec![0.0; all.len()];
    Hold::new(&all, Carrying::FRESH, &vec![9.0; all.len()]).write(&sensed, &mut targets);
    assert!(!grip.is_at_limit(&sensed, &targets));
}

const CARRYING: Carrying = Carrying { presses: 0.8, keeps: 0.6 };

#[test]
fn a_hold_keeps_its_targets_near_the_fingers() {
    let robot = Robot::by_name("g1_inspire").unwrap();
    let all = joints(&robot);
    let (start, sensed) = (vec![1.0; all.len()], vec![0.2; all.len()]);
    let mut targets = vec![7.0; all.len()];
    Hold::new(&all, CARRYING, &start).write(&sensed, &mut targets);
    assert!(targets[..BODY].iter().all(|target| *target == 7.0), "the body is not its");
    assert!(targets[BODY..].iter().all(|target| (target - 0.2 - 0.8 * 0.5 / STIFFNESS).abs() < 1e-12), "{targets:?}");
}

/// Guards that a finger that gives way presses more: its target follows what is sensed for two seconds alone.
#[test]
fn a_hold_stays_where_it_is_once_it_has_settled() {
    let robot = Robot::by_name("g1_inspire").unwrap();
    let all = joints(&robot);
    let (start, mut targets) = (vec![1.0; all.len()], vec![0.0; all.len()]);
    let mut hold = Hold::new(&all, CARRYING, &start);
    let mut after = |hold: &mut Hold, steps: u32, angle: f64| {
        (0..steps).for_each(|_| hold.write(&vec![angle; all.len()], &mut targets));
        targets[BODY]
    };
    let first = after(&mut hold, 1, 0.2);
    let settled = after(&mut hold, 98, 0.3);
    assert!(settled > first + 0.09, "{first} {settled}");
    // Opened, it presses more.
    assert_eq!(after(&mut hold, 100, 0.2), settled);
    // Closed farther, it would press less: it keeps six tenths of its torque.
    let closed = after(&mut hold, 200, 0.5);
    assert!((closed - 0.5 - 0.6 * 0.8 * 0.5 / STIFFNESS).abs() < 1e-3, "{closed}");
    // And its first target again where it opens.
    assert_eq!(after(&mut hold, 200, 0.3), settled);
}

#[test]
fn forces_are_felt_by_side_and_finger() {
    let names = ["R_index_tip", "right_palm", "L_thumb_distal", "lamp"].map(str::to_owned);
    let forces = [3.0, 0.0, 4.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 9.0, 9.0, 9.0];
    let [left, right] = HandBodies::new(&names).touch(&forces);
    assert_eq!((left.fingers, left.palm), ([1.0, 0.0, 0.0, 0.0, 0.0], 0.0));
    assert_eq!((right.fingers, right.palm, right.largest()), ([0.0, 5.0, 0.0, 0.0, 0.0], 2.0, 5.0));
}
