//! The controller that is shipped, and what is refused.

use std::sync::Arc;

use fiatlux_robot::Robot;
use fiatlux_wbc::{ARMS, Arms, BodyCommand, Controller, MOVED, Network, Sensed, WbcError};

const SHIPPED: &[u8] = include_bytes!("../../weights/wbc.safetensors");

const ZEROS: [f64; MOVED + ARMS] = [0.0; MOVED + ARMS];

fn upright(joint_position: &[f64]) -> Sensed<'_> {
    Sensed::upright(joint_position, &ZEROS)
}

/// Loading runs the network on an observation whose action PyTorch worked out; it must agree to 1e-5.
#[test]
fn the_shipped_controller_gives_what_pytorch_gave() {
    let network = Network::shipped().unwrap();
    assert!(SHIPPED.len() < 1_000_000);
    for robot in ["g1_bare", "g1_inspire"] {
        network.contract().fits_robot(&Robot::by_name(robot).unwrap()).unwrap();
        network.contract().fits_joints(&network.contract().joints).unwrap();
    }
}

#[test]
fn standing_upright_it_is_content_and_mirrored_states_give_mirrored_targets() {
    let network = Arc::new(Network::shipped().unwrap());
    let mut controller = Controller::new(Arc::clone(&network));
    let mut targets = [0.0; MOVED];
    for _ in 0..10 {
        controller.step(&upright(&ZEROS), &BodyCommand::default(), &mut targets).unwrap();
    }
    for (index, (target, joint)) in targets.iter().zip(&network.contract().joints).enumerate() {
        assert!((target - joint.q0).abs() < 1.2, "{} {target}", joint.name);
        let (other, sign) = fiatlux_wbc::mirrored_action(index);
        let mirrored = f64::from(sign) * (targets[other] - network.contract().joints[other].q0);
        assert!((target - joint.q0 - mirrored).abs() < 1e-4, "{}", joint.name);
    }
}

/// A copy of the file in which a text stands for another one of the same length.
fn with(find: &str, put: &str) -> Vec<u8> {
    assert_eq!(find.len(), put.len());
    let mut bytes = SHIPPED.to_vec();
    let at = bytes.windows(find.len()).position(|window| window == find.as_bytes()).expect("is there");
    bytes[at..at + put.len()].copy_from_slice(put.as_bytes());
    bytes
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let said = |bytes: &[u8]| {
        let error = Network::from_bytes(bytes).unwrap_err();
        let source = std::error::Error::source(&error).map_or(String::new(), ToString::to_string);
        format!("{error}: {source}")
    };
    let engine = format!("benchmark {}", fiatlux_rules::pins::ENGINE_VERSION);
    let other = format!("benchmerk {}", fiatlux_rules::pins::ENGINE_VERSION);
    let message = said(&with(&engine, &other));
    assert!(message.contains("made for engine benchmerk"), "{message}");
    let message = said(&with("base_height", "base_haight"));
    assert!(message.contains("base_haight 1"), "{message}");
    assert!(said(&SHIPPED[..SHIPPED.len() - 1]).contains("is cut or damaged"));
    assert!(said(&SHIPPED[..100]).contains("the file is cut"));
    assert!(said(b"").contains("8 bytes of header length"));
    // The data end with the last layer's weights, or the check's: NaN is found wherever it is, and so is a wrong number.
    let mut bytes = SHIPPED.to_vec();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(said(&bytes).contains("is not finite"));
    let start = end - 4 * 100;
    bytes.copy_from_slice(SHIPPED);
    bytes[start..start + 4].copy_from_slice(&1e3_f32.to_le_bytes());
    assert!(said(&bytes).contains("differs from its export"));

    let network = Network::shipped().unwrap();
    let mut joints = network.contract().joints.clone();
    joints[3].name = "knee".into();
    let message = network.contract().fits_joints(&joints).unwrap_err().to_string();
    assert!(message.contains("joint 3 is left_knee_joint") && message.contains("knee"), "{message}");
    joints.clone_from(&network.contract().joints);
    joints[4].stiffness += 1.0;
    assert!(network.contract().fits_joints(&joints).unwrap_err().to_string().contains("stiffness of joint left_ankle"));
    joints.clone_from(&network.contract().joints);
    assert!(network.contract().fits_joints(&joints[..20]).unwrap_err().to_string().contains("missing"));
}

#[test]
fn nothing_moves_on_a_bad_observation_or_command() {
    let mut controller = Controller::new(Arc::new(Network::shipped().unwrap()));
    let mut targets = [7.0; MOVED];
    let sensed = Sensed { base_linear_velocity: [0.0, f64::NAN, 0.0], ..upright(&ZEROS) };
    let error = controller.step(&sensed, &BodyCommand::default(), &mut targets).unwrap_err();
    assert!(matches!(error, WbcError::Sensed { term: "base_linear_velocity", .. }));
    let error = controller.step(&upright(&ZEROS[..20]), &BodyCommand::default(), &mut targets).unwrap_err();
    assert!(matches!(error, WbcError::Sensed { term: "joint_position", .. }));
    assert_eq!(targets, [7.0; MOVED]);
    let fast = BodyCommand { velocity: [2.0, 0.0, 0.0], ..BodyCommand::default() };
    assert!(controller.check(&fast).unwrap_err().to_string().contains("command vx is 2"));
    controller.check(&BodyCommand { height: 0.56, ..BodyCommand::default() }).unwrap();
    let low = BodyCommand { velocity: [0.3, 0.0, 0.0], height: 0.56, ..BodyCommand::default() };
    assert!(controller.check(&low).unwrap_err().to_string().contains("command height is 0.56"));
}

/// A forearm that points ahead is pulled down by its weight: its target is above the angle, by what its drive needs.
#[test]
fn arms_are_held_against_their_weight() {
    let network = Network::shipped().unwrap();
    let joints = &network.contract().joints;
    let elbow = joints[MOVED..].iter().position(|joint| joint.name == "left_elbow_joint").unwrap();
    let mut arms = Arms::new(joints).unwrap();
    let mut angles = [0.0; ARMS];
    let held = arms.targets(&upright(&ZEROS), &angles).unwrap();
    let effort = (held[elbow] - angles[elbow]) * joints[MOVED + elbow].stiffness;
    assert!((-4.0..-1.0).contains(&effort), "{effort} N m");
    // Upside down it is the other way round, once that is believed.
    let fallen = Sensed { projected_gravity: [0.0, 0.0, 1.0], ..upright(&ZEROS) };
    let turned = (0..100).map(|_| arms.targets(&fallen, &angles).unwrap()).last().unwrap();
    assert!((turned[elbow] + held[elbow]).abs() < 1e-3, "{} {}", turned[elbow], held[elbow]);
    arms.restart();
    assert_eq!(arms.targets(&upright(&ZEROS), &angles).unwrap(), held);

    angles[elbow] = f64::NAN;
    let error = arms.targets(&upright(&ZEROS), &angles).unwrap_err().to_string();
    assert_eq!(error, "the angle of left_elbow_joint is not finite");
    let error = arms.targets(&upright(&ZEROS[..7]), &[0.0; ARMS]).unwrap_err().to_string();
    assert_eq!(error, "the controller needs joint_position, which the observation lacks");
    assert!(Arms::new(&joints[..20]).unwrap_err().to_string().contains("the first 29 joints are not the G1's"));
    let mut soft = joints.clone();
    soft[MOVED].stiffness = 0.0;
    assert!(Arms::new(&soft).unwrap_err().to_string().contains("left_shoulder_pitch_joint has stiffness 0 N m/rad"));
}
