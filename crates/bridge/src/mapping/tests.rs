#![allow(clippy::unwrap_used)]

use fiatlux_robot::lidar::{RANGE, RAYS};

use super::*;
use crate::{ActionTerms, CameraTerms, Contract, Frames, ModelChunk, Sensed, check_chunk, check_contract};

fn robot() -> Robot {
    Robot::benchmark().unwrap()
}

fn shipped(name: &str) -> Mapping {
    Mapping::open(name, &robot()).unwrap()
}

/// Sizes from the models' documentation: 43 and 35, 49 and 53, 46 and 78, and those of the five others.
#[test]
fn shipped_mappings_have_the_dimensions_of_their_models() {
    let widths = |mapping: &Mapping, keys: &[Key]| keys.iter().map(|key| mapping.width(key)).sum::<usize>();
    for (name, state, action, horizon) in [
        ("unitree_g1", 43, 35, 30),
        ("real_g1", 49, 53, 40),
        ("unitree_g1_sonic", 46, 78, 40),
        ("openpi_g1", 20, 23, 50),
        ("behavior_g1", 23, 23, 16),
        ("roboarena_g1", 8, 8, 10),
        ("lerobot_g1", 4, 7, 20),
        ("lerobot_g1_hand", 63, 33, 20),
    ] {
        let mapping = shipped(name);
        assert_eq!(mapping.name, name);
        let found = (widths(&mapping, &mapping.states), widths(&mapping, &mapping.actions), mapping.horizon);
        assert_eq!(found, (state, action, horizon), "{name}");
    }
    for (_, dialect) in Dialect::ALL {
        assert!(shipped(default_mapping(dialect)).dialects.contains(&dialect));
    }
    assert_eq!(shipped("unitree_g1").label(), "unitree_g1:dex3-inspire-1");
    assert_eq!(shipped("unitree_g1_sonic").token(), Some(("motion_token", 64)));
}

/// The group is the hand's own joints, whatever hand the robot has; a robot without fingers is refused.
#[test]
fn a_group_is_the_fingers_of_a_hand() {
    for (name, fingers) in [("g1_inspire", 12), ("g1_dex3", 7)] {
        let robot = Robot::by_name(name).unwrap();
        let mapping = Mapping::open("lerobot_g1_hand", &robot).unwrap();
        let Some(KeyPart::Joints(joints)) = mapping.actions[0].parts.last() else { panic!("{name}") };
        assert_eq!(joints.len(), fingers, "{name}");
        assert!(joints.iter().all(|joint| robot.joints()[*joint].name.to_lowercase().starts_with('r')), "{name}");
    }
    let problem = Mapping::open("lerobot_g1_hand", &Robot::by_name("g1_bare").unwrap()).unwrap_err().to_string();
    assert!(problem.contains("no joints in its right_hand"), "{problem}");
}

/// Guards that errors in a file name the field.
#[test]
fn wrong_files_are_refused() {
    let text = include_str!("../../mappings/unitree_g1.toml");
    for (from, to, says) in [
        ("horizon = 30", "horizon = 0", "horizon: it is 0"),
        ("prefix = 20", "prefix = 31", "prefix: it is 31"),
        ("rate_hz = 50", "rate_hz = 30", "rate_hz: 30 is not 50 divided"),
        ("\"gr00t-flat\"", "\"groot\"", "'groot' is not a known dialect"),
        ("size = [640, 480]", "size = [320, 240]", "name a resize rule"),
        ("sensor = \"camera\"", "sensor = \"wrist\"", "sensor 'wrist' is not known"),
        ("delta = [0]", "delta = [0, -20]", "rising numbers"),
        ("group = \"waist\"", "group = \"tail\"", "group 'tail' is not known"),
        ("group = \"waist\"", "joints = [\"tail_joint\"]", "no joint 'tail_joint'"),
        ("{ group = \"waist\" }", "{ group = \"waist\", skip = 1 }", "a part needs exactly one of"),
        ("term = \"height\"", "term = \"depth\"", "term 'depth' is not known"),
        ("dex3-inspire-1", "nowhere.toml", "give a file, or one of dex3-inspire-1"),
        ("declared = \"relative\"", "declared = \"odd\"", "representation 'odd' is not known"),
        ("key = \"left_leg\"", "key = \"right_leg\"", "the key 'right_leg' appears twice"),
        ("name = \"unitree_g1\"", "name = \"a b\"", "letters, digits"),
        ("horizon = 30", "horizon = 30\nlidar_sees_room = true", "lidar_sees_room: no state has a part lidar"),
        ("{ skip = 9 }", "", ""),
    ] {
        if to.is_empty() {
            continue;
        }
        let error = Mapping::from_toml("test", &text.replacen(from, to, 1), &robot()).unwrap_err().to_string();
        assert!(error.contains(says), "{from} -> {to}: {error}");
    }
    let tokens = include_str!("../../mappings/unitree_g1_sonic.toml");
    for (from, to, says) in [
        ("body = \"tokens\"", "", "set body = \"tokens\""),
        ("body = \"tokens\"", "body = \"tokens\"\nhold_arms = true", "only body = \"wbc\" can hold arms"),
        ("body = \"tokens\"", "body = \"tokens\"\nbend_low = true", "only body = \"wbc\" can bend low"),
        ("{ token = 64 }", "{ skip = 64 }", "needs one token in the actions, which have 0"),
        ("{ token = 64 }", "{ token = 32 }, { token = 32 }", "which have 2"),
        ("{ token = 64 }", "{ token = 64 }, { group = \"waist\" }", "belongs to the decoder of the tokens"),
        (
            "{ token = 64 }",
            "{ token = 64 }, { term = \"navigate\" }",
            "it commands the whole-body controller; set body = \"wbc\"",
        ),
    ] {
        let error = Mapping::from_toml("test", &tokens.replacen(from, to, 1), &robot()).unwrap_err().to_string();
        assert!(error.contains(says), "{from} -> {to}: {error}");
    }
    let (head, tail) = text.split_once("# Relative keys").unwrap();
    for (from, to, says) in [
        ("group = \"waist\"", "group = \"left_arm\"", "commanded twice"),
        ("group = \"waist\"", "group = \"left_leg\"", "belongs to the whole-body controller"),
        ("term = \"height\"", "term = \"projected_gravity\"", "does not belong in the action"),
    ] {
        let text = format!("{head}# Relative keys{}", tail.replacen(from, to, 1));
        let error = Mapping::from_toml("test", &text, &robot()).unwrap_err().to_string();
        assert!(error.contains(says), "{from} -> {to}: {error}");
    }
}

/// The complete state of one of our data sets: terms in order, joint angles relative to the standing posture.
#[test]
fn a_state_has_the_terms_of_proprioception() {
    let terms = [
        "base_angular_velocity",
        "projected_gravity",
        "base_linear_velocity",
        "height",
        "joint_position",
        "joint_velocity",
    ];
    let parts = terms.map(|term| format!("{{ term = \"{term}\" }}")).join(", ");
    let text = include_str!("../../mappings/lerobot_g1.toml");
    let text = text.replace("{ term = \"projected_gravity\" }, { term = \"height\" }", &parts);
    let text = text.replace("sensor = \"camera\"", "sensor = \"none\"");
    let robot = robot();
    let mapping = Mapping::from_toml("test", &text, &robot).unwrap();
    let q: Vec<f64> = robot.q0().iter().map(|angle| angle + 0.25).collect();
    let velocity = vec![-0.5; q.len()];
    let sensed = Sensed {
        base_angular_velocity: [1.0, 2.0, 3.0],
        base_linear_velocity: [4.0, 5.0, 6.0],
        ..Sensed::still(&q, &velocity, 0.75)
    };
    let seen = mapping.observe(&robot, &sensed, &Frames::default(), 0, "go", "it").unwrap();
    let (key, numbers) = &seen.states[0];
    assert_eq!((key.as_str(), numbers.len()), ("state", 116));
    assert_eq!(numbers[..10], [1.0, 2.0, 3.0, 0.0, 0.0, -1.0, 4.0, 5.0, 6.0, 0.75]);
    assert!(numbers[10..63].iter().all(|turned| (turned - 0.25).abs() < 1e-6));
    assert_eq!(numbers[63..], [-0.5; 53]);
    let short = Sensed { joint_velocity: &velocity[1..], ..sensed };
    assert!(mapping.observe(&robot, &short, &Frames::default(), 0, "go", "it").is_err());
}

/// A mapping that `python -m fiatlux.train_lerobot` wrote; `python/tests/test_train_lerobot.py` compares the file with what it writes.
const WRITTEN: &str = include_str!("../../tests/written_mapping.toml");

/// Forces within their limit and the nearest ranges follow the body in the state; what the session lacks is named.
#[test]
fn a_written_mapping_has_forces_and_sectors() {
    let robot = robot();
    let mapping = Mapping::from_toml("test", WRITTEN, &robot).unwrap();
    assert!(mapping.lidar_sees_room && mapping.has_lidar() && mapping.has_contact());
    assert_eq!((mapping.sensors(), mapping.lookbacks()), (vec!["camera", "chest_camera"], vec![0, 15, 50]));
    assert_eq!(mapping.width(&mapping.actions[0]), 45);
    let (q, zeros) = (robot.q0().to_vec(), vec![0.0; robot.q0().len()]);
    let bodies = robot.hand_links().len();
    let forces: Vec<f32> = (0..3 * bodies).map(|at| [25.0, -7.5, -30.0][at % 3]).collect();
    let mut scan = vec![RANGE as f32; RAYS];
    (scan[180 + 90], scan[31 * 180 + 179]) = (2.5, 0.75);
    let sensed = Sensed { hand_contact_force: &forces, lidar: &scan, ..Sensed::still(&q, &zeros, 0.75) };
    let mut frames = Frames::default();
    for sensor in mapping.sensors() {
        frames.push(&mapping, 0, sensor, crate::Picture::new(64, 48, vec![9; 3 * 64 * 48]).unwrap());
    }
    let see = |sensed: &Sensed<'_>| mapping.observe(&robot, sensed, &frames, 0, "go", "it");
    let seen = see(&sensed).unwrap();
    assert_eq!(seen.images[1].1.shape(), [3, 48, 64, 3]);
    let state = &seen.states[0].1;
    let (felt, near) = state[63..].split_at(3 * bodies);
    assert!(felt.chunks(3).all(|force| *force == [20.0, -7.5, -20.0]), "{felt:?}");
    assert_eq!(near, [10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 2.5, 10.0, 10.0, 10.0, 10.0, 0.75]);
    for (lacking, says) in [
        (Sensed { hand_contact_force: &forces[3..], ..sensed }, "name hand_contact there"),
        (Sensed { lidar: &[], ..sensed }, "a scan of the LiDAR of 5760 numbers (it has 0)"),
    ] {
        let error = see(&lacking).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let (contract, _) = fitting(&mapping);
    check_contract(&mapping, &contract).unwrap();
    let error = check_contract(&shipped("lerobot_g1_hand"), &contract).unwrap_err().to_string();
    assert!(error.contains("frames 'camera': the server has [-10, -3, 0], the mapping has [0]"), "{error}");
    for (from, to, says) in [
        ("horizon = 4", "horizon = 401", "horizon"),
        ("lidar = 12", "lidar = 7", "state 'state': lidar is 7; give a number of sectors that divides 180"),
        ("lidar = 12", "lidar = 0", "lidar is 0"),
        ("lidar = 12", "lidar = 360", "lidar is 360"),
        ("contact = 20.0", "contact = -1", "state 'state': contact is -1; give a limit"),
        ("contact = 20.0", "contact = nan", "contact is NaN"),
        ("contact = 20.0", "contact = 20, lidar = 4", "exactly one of"),
        ("{ group = \"left_hand\" }", "{ contact = 20 }", "does not belong in the action"),
        ("{ group = \"left_hand\" }", "{ lidar = 4 }", "does not belong in the action"),
    ] {
        assert!(WRITTEN.contains(from));
        let error = Mapping::from_toml("test", &WRITTEN.replacen(from, to, 1), &robot).unwrap_err().to_string();
        assert!(error.contains(says), "{from} -> {to}: {error}");
    }
}

fn fitting(mapping: &Mapping) -> (Contract, ModelChunk) {
    let cameras = mapping.cameras.iter().map(|camera| CameraTerms {
        key: camera.key.clone(),
        size: Some(camera.size),
        delta: Some(camera.delta.clone()),
    });
    let actions = mapping.actions.iter().map(|key| ActionTerms {
        key: key.key.clone(),
        width: Some(mapping.width(key)),
        representation: Some(key.declared),
    });
    let contract = Contract {
        cameras: Some(cameras.collect()),
        states: Some(mapping.states.iter().map(|key| (key.key.clone(), Some(mapping.width(key)))).collect()),
        state_frames: Some(1),
        actions: Some(actions.collect()),
        language: Some(vec![mapping.language.clone()]),
        horizon: Some(mapping.horizon),
        ..Contract::default()
    };
    let part = |key: &Key| {
        let width = mapping.width(key);
        (key.key.clone(), width, vec![0.1; width * mapping.horizon])
    };
    let parts = mapping.actions.iter().map(part).collect();
    (contract, ModelChunk { rows: mapping.horizon, parts, server_s: None })
}

/// Guards that each of ten kinds of difference is named in the error.
#[test]
fn ten_wrong_mappings_are_refused_by_name() {
    type Change = fn(&mut Mapping);
    let changes: [(&str, Change); 11] = [
        ("camera 'ego_view': the server has it, the mapping has nothing", |m| m.cameras[0].key = "ego".into()),
        ("picture size 'ego_view': the server has [640, 480], the mapping has [320, 240]", |m| {
            m.cameras[0].size = [320, 240];
        }),
        ("frames 'ego_view': the server has [0], the mapping has [-20, 0]", |m| m.cameras[0].delta = vec![-20, 0]),
        ("state key 'left_leg': the server has it, the mapping has nothing", |m| drop(m.states.remove(0))),
        ("dimension 'left_arm': the server has 7, the mapping has 6", |m| m.states[3].parts = vec![KeyPart::Skip(6)]),
        ("dimension 'waist': the server has 3, the mapping has 4", |m| m.actions[4].parts = vec![KeyPart::Skip(4)]),
        ("action key 'navigate_command': the server has it, the mapping has nothing", |m| drop(m.actions.pop())),
        ("action key 'tail': the server has nothing", |m| m.actions[0].key = "tail".into()),
        ("horizon: the server has 30 rows, the mapping has 16", |m| m.horizon = 16),
        ("representation 'left_arm': the server has relative, the mapping has absolute", |m| {
            m.actions[0].declared = Representation::Absolute;
        }),
        ("language key 'task': the server has 'annotation.human.task_description'", |m| m.language = "task".into()),
    ];
    let good = shipped("unitree_g1");
    let (contract, chunk) = fitting(&good);
    check_contract(&good, &contract).unwrap();
    check_chunk(&good, &chunk).unwrap();
    for (says, change) in changes {
        let mut wrong = good.clone();
        change(&mut wrong);
        let error = check_contract(&wrong, &contract).unwrap_err().to_string();
        assert!(error.contains(says), "{says}\n{error}");
    }
    // The first answer shows differences that the contract leaves out.
    for change in [changes[5].1, changes[6].1, changes[7].1, changes[8].1] {
        let mut wrong = good.clone();
        change(&mut wrong);
        assert!(check_chunk(&wrong, &chunk).is_err());
    }
    let arena = shipped("roboarena_g1");
    let config = Contract {
        image_size: Some([320, 180]),
        camera_count: Some(3),
        action_space: Some("joint_velocity".into()),
        ..Contract::default()
    };
    let error = check_contract(&arena, &config).unwrap_err().to_string();
    for says in ["camera: the server has 3 cameras", "[320, 180]", "joint_velocity"] {
        assert!(error.contains(says), "{error}");
    }
}

/// Arms, hands, waist and commands end up in the right fields; a relative arm adds to the posture at the question.
#[test]
fn a_chunk_becomes_targets_and_commands() {
    let robot = robot();
    let mut mapping = shipped("unitree_g1");
    let (_, mut chunk) = fitting(&mapping);
    let q: Vec<f64> = robot.q0().to_vec();
    for (key, width, numbers) in &mut chunk.parts {
        match key.as_str() {
            "navigate_command" => *numbers = [0.3, -0.1, 0.2].repeat(30),
            "base_height_command" => *numbers = vec![0.7; 30],
            "waist" => *numbers = [0.2, 0.0, 0.1].repeat(30),
            _ => assert_eq!(*width, 7),
        }
    }
    let rows = mapping.rows(&robot, &q, &chunk).unwrap();
    assert_eq!(rows.len(), 30);
    let row = &rows[0];
    assert_eq!((row.velocity, row.height), (Some([0.3, -0.1, 0.2]), Some(0.7)));
    let torso = row.torso.unwrap();
    assert!(torso.iter().zip([0.0, 0.1, 0.2]).all(|(found, expected)| (found - expected).abs() < 0.03), "{torso:?}");
    let joints: Vec<usize> = row.targets.iter().map(|target| target.0).collect();
    assert_eq!(joints, (15..53).collect::<Vec<_>>());
    assert!((row.targets[0].1 - 0.1).abs() < 1e-12);
    let mut bent = q.clone();
    bent[15] = 0.5;
    mapping.actions[0].representation = Representation::Relative;
    assert!((mapping.rows(&robot, &bent, &chunk).unwrap()[3].targets[0].1 - 0.6).abs() < 1e-12);
    mapping.actions[0].representation = Representation::Delta;
    assert!((mapping.rows(&robot, &bent, &chunk).unwrap()[3].targets[0].1 - 0.9).abs() < 1e-12);
}

/// Relative wrists: no change leaves the arm where it is, and 3 cm forwards are 3 cm forwards.
#[test]
fn relative_wrists_are_reached() {
    let robot = robot();
    let text = include_str!("../../mappings/real_g1.toml")
        .replacen("{ skip = 9 }", "{ wrist = \"left\" }", 1)
        .replace("parts = [{ group = \"left_arm\" }]\ndeclared", "parts = [{ skip = 7 }]\ndeclared");
    let mut mapping = Mapping::from_toml("test", &text, &robot).unwrap();
    mapping.actions[0].representation = Representation::Relative;
    let (_, mut chunk) = fitting(&mapping);
    let mut q = robot.q0().to_vec();
    // The forearm points forwards: a straight arm could not reach further.
    q[18] = 0.2;
    let still = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    chunk.parts[0].2 = still.repeat(40);
    let arm = |row: &crate::Row| {
        row.targets.iter().filter(|(joint, _)| (15..22).contains(joint)).copied().collect::<Vec<_>>()
    };
    let rows = mapping.rows(&robot, &q, &chunk).unwrap();
    assert!(arm(&rows[39]).iter().all(|(joint, angle)| (angle - q[*joint]).abs() < 1e-6));
    let ahead = [0.03, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    chunk.parts[0].2 = ahead.repeat(40);
    let rows = mapping.rows(&robot, &q, &chunk).unwrap();
    let before = crate::reach::wrist(&robot, Side::Left, &q).unwrap();
    for (joint, angle) in arm(&rows[39]) {
        q[joint] = angle;
    }
    let after = crate::reach::wrist(&robot, Side::Left, &q).unwrap();
    let moved = before.inverse() * after;
    assert!((moved.translation.vector - nalgebra::Vector3::new(0.03, 0.0, 0.0)).norm() < 2e-3, "{moved}");
}
