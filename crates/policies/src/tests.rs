use std::sync::Arc;

use fiatlux_bag::BagWriter;
use fiatlux_proto::v3::{
    Action, ActionRecord, EpisodeHeader, EpisodeResult, Joint, Observation, Proprioception, SessionInfo,
};
use fiatlux_proto::{Message, PROTOCOL};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_wbc::{BODY, MOVED, Network};
use fiatlux_wire::joint_messages;

use super::whole_body::WholeBody;
use super::*;
use fiatlux_client::{Command, Policy, PolicyError};

fn session(seed: u64) -> SessionInfo {
    SessionInfo { seed, joints: vec![Joint::default(); 4], ..SessionInfo::default() }
}

fn commands(policy: &mut dyn Policy, seed: u64, episode: u64, last_action: &[f32]) -> Vec<Command> {
    let mut observation = Observation { episode, last_action: last_action.to_vec(), ..Observation::default() };
    policy.reset(&session(seed), &observation).expect("resets");
    let act = |step| {
        observation.step = step;
        observation.last_action = vec![9.0; 4];
        policy.act(&observation).expect("acts")
    };
    (0..3).map(act).collect()
}

#[test]
fn zero_and_hold() {
    let mut zero = Policies::default().make("zero").expect("known");
    assert_eq!(commands(zero.as_mut(), 0, 0, &[]), vec![Command::Action(vec![0.0; 4]); 3]);
    let mut hold = Policies::default().make("hold").expect("known");
    let staged = [0.25, -0.5, 1.5, 0.0];
    let expected = Command::Action(staged.map(f64::from).to_vec());
    assert_eq!(commands(hold.as_mut(), 0, 0, &staged), vec![expected; 3]);
    let error = hold.reset(&session(0), &Observation::default()).expect_err("refused").to_string();
    assert!(error.contains("needs the sensor last_action"), "{error}");
}

/// The draws depend only on seed and episode, not on earlier episodes.
#[test]
fn random_is_drawn_from_seed_and_episode() {
    let mut random = Random::default();
    let mut draw = |seed, episode| commands(&mut random, seed, episode, &[]);
    let first = draw(1, 0);
    let others = [draw(1, 1), draw(2, 0), draw(0, 1)];
    assert_eq!(first, draw(1, 0));
    assert!(others.iter().all(|other| *other != first) && others[0] != others[2]);
}

#[test]
fn random_is_uniform_in_the_box() {
    let mut random = Random::default();
    random.reset(&session(0), &Observation::default()).expect("resets");
    let mut numbers = Vec::new();
    for _ in 0..5000 {
        let Command::Action(action) = random.act(&Observation::default()).expect("acts") else { panic!("targets") };
        numbers.extend(action);
    }
    let mean = |power: i32| numbers.iter().map(|number| number.powi(power)).sum::<f64>() / numbers.len() as f64;
    assert!(numbers.iter().all(|number| (-1.0..1.0).contains(number)));
    // Moments of the uniform distribution: 0, 1/3, 0, 1/5; 20,000 draws leave some 0.005 of noise.
    for (power, moment) in [(1, 0.0), (2, 1.0 / 3.0), (3, 0.0), (4, 0.2)] {
        assert!((mean(power) - moment).abs() < 0.02, "moment {power} is {}", mean(power));
    }
}

#[test]
fn a_program_adds_policies_and_may_hide_built_in_ones() {
    let entry = |name| Entry { name, does: "", make: |_| Ok(Box::new(Hold::default())) };
    let policies = Policies::default().with(entry("mine:DIR")).with(entry("zero"));
    assert_eq!(policies.entries().len(), Policies::default().entries().len() + 1);
    assert_eq!(policies.make("zero").expect("known").name(), "hold");
    assert_eq!(policies.make("mine:here").expect("known").name(), "hold");
    for slip in ["mine", "mine:", "zero:", "zero:fast", "walk:", "replay:"] {
        assert!(matches!(policies.make(slip), Err(PolicyError::Unknown { .. })), "{slip}");
    }
}

#[test]
fn an_unknown_name_is_answered_with_the_known_ones() {
    for name in ["waddle", "", "replay:", "replay", "gear", "gear:", "sonic:"] {
        let message = Policies::default().make(name).err().expect("refused").to_string();
        assert!(
            message.contains(
                "zero, random, hold, stand, wbc[:COMMAND], walk[:FILE], hands, ladder[:FILE], climb[:FILE], expert, see[:FILE], carry[:FILE], vla, \
                 gear:DIR, sonic:DIR, replay:BAG"
            ),
            "{message}"
        );
    }
    assert!(matches!(
        Policies::default().make("replay:/nowhere.mcap"),
        Err(PolicyError::Failed { policy: "replay", .. })
    ));
}

/// Other weights under the same file name are another policy; a checkpoint is distinguished from an exported file.
#[test]
fn the_name_says_which_weights_and_which_command() {
    let name = |text: &str| {
        Policies::default().make(text).map(|policy| policy.name()).map_err(|error| fiatlux_cli::in_full(&error))
    };
    assert_eq!(name("wbc").as_deref(), Ok("wbc"));
    assert_eq!(name("walk").as_deref(), Ok("walk"));
    assert_eq!(name("wbc:vx=0.4,wz=0.2").as_deref(), Ok("wbc:vx=0.4,wz=0.2"));
    let shipped = include_bytes!("../../../crates/wbc/weights/wbc.safetensors");
    let path = std::env::temp_dir().join(format!("fiatlux-weights-{}.safetensors", std::process::id()));
    std::fs::write(&path, shipped).expect("writes");
    let file = path.file_name().expect("a name").display().to_string();
    let digest = Network::shipped().expect("weights").digest()[..8].to_owned();
    let (found, walks) = (name(&format!("wbc:{},vx=0.4", path.display())), name(&format!("walk:{}", path.display())));
    std::fs::write(&path, b"PK\x03\x04 and more").expect("writes");
    let refused = name(&format!("walk:{}", path.display())).expect_err("a checkpoint");
    std::fs::remove_file(&path).expect("removes");
    assert_eq!(found, Ok(format!("wbc:{file}@{digest},vx=0.4")));
    assert_eq!(walks, Ok(format!("walk:{file}@{digest}")));
    assert!(refused.contains("is a checkpoint") && refused.contains("fiatlux.train export"), "{refused}");
    let refused = name("wbc:vx=3").expect_err("too fast");
    assert!(refused.contains("command vx is 3, outside of -0.5 to 1"), "{refused}");
}

/// Received actions and targets are sent again, bit for bit; then the policy reports that none is left.
#[test]
fn replay_sends_what_was_recorded_and_no_more() {
    let path = std::env::temp_dir().join(format!("fiatlux-replay-{}.mcap", std::process::id()));
    let joint_names = vec![String::new(); 4];
    let header =
        EpisodeHeader { protocol: Some(PROTOCOL), policy: "old".into(), joint_names, ..EpisodeHeader::default() };
    let numbers = vec![0.1 + 0.2, -7.5, f64::MIN_POSITIVE, 1.0 / 3.0];
    let mut bag = BagWriter::create(&path, &header).expect("creates");
    bag.message("/state", 0, &[]).expect("writes");
    for step in 0..200 {
        let mut action = Action { step, ..Action::default() };
        *if step % 2 == 0 { &mut action.action } else { &mut action.joint_target } = numbers.clone();
        let record = ActionRecord { action: Some(action), ..ActionRecord::default() };
        bag.message("/action", step + 1, &record.encode_to_vec()).expect("writes");
        bag.message("/state", step + 1, &[]).expect("writes");
    }
    bag.finish(&EpisodeResult::default()).expect("finishes");

    let mut replay = Policies::default().make(&format!("replay:{}", path.display())).expect("opens");
    std::fs::remove_file(path).expect("removes");
    assert_eq!(replay.name(), "replay:old");
    replay.reset(&session(0), &Observation::default()).expect("resets");
    for step in 0..200 {
        let command = replay.act(&Observation { step, ..Observation::default() }).expect("acts");
        let recorded = numbers.clone();
        assert_eq!(command, if step % 2 == 0 { Command::Action(recorded) } else { Command::JointTarget(recorded) });
    }
    let message = replay.act(&Observation { step: 200, ..Observation::default() }).expect_err("no more").to_string();
    assert!(message.contains("actions for the steps before 200 and none for step 200"), "{message}");
    let other = SessionInfo { joints: vec![Joint::default(); 3], ..session(0) };
    assert!(matches!(replay.reset(&other, &Observation::default()), Err(PolicyError::Unfit { .. })));
}

/// A session with the robot at rest in its posture, and the first observation.
pub(crate) fn standing(robot: &Robot, gains: GainSet) -> (SessionInfo, Observation) {
    let joints = joint_messages(robot, &robot.gains(gains));
    let count = joints.len();
    let first = Observation {
        proprioception: Some(Proprioception {
            base_angular_velocity: vec![0.0; 3],
            projected_gravity: vec![0.0, 0.0, -1.0],
            base_linear_velocity: vec![0.0; 3],
            base_height: 0.79,
            joint_position: vec![0.0; count],
            joint_velocity: vec![0.0; count],
        }),
        last_action: vec![0.0; count],
        ..Observation::default()
    };
    (SessionInfo { joints, action_scale: 0.5, control_dt: 0.02, ..SessionInfo::default() }, first)
}

/// In the standing posture at rest, no target is far from the posture.
#[test]
fn stand_answers_with_targets_of_all_joints() {
    let robot = Robot::benchmark().expect("loads");
    let (info, first) = standing(&robot, GainSet::default());
    let count = info.joints.len();
    let mut stand = Policies::default().make("stand").expect("known");
    stand.reset(&info, &first).expect("resets");
    let Command::JointTarget(targets) = stand.act(&first).expect("acts") else { panic!("actions") };
    assert_eq!(targets.len(), count);
    let farthest = targets.iter().zip(robot.q0()).map(|(target, q0)| (target - q0).abs()).fold(0.0, f64::max);
    assert!(farthest < 0.5, "{farthest}");

    let blind = Observation { proprioception: None, ..first.clone() };
    assert!(matches!(stand.reset(&info, &blind), Err(PolicyError::Sensor { sensor: "proprioception", .. })));
    assert!(matches!(stand.reset(&session(0), &first), Err(PolicyError::Unfit { .. })));
}

/// Small networks written by Python.
const NETWORKS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../foreign/tests/fixtures");

/// A foreign controller's command in its first step: targets of all joints.
fn foreign_targets(words: &str, robot: &Robot, gains: GainSet) -> Result<Vec<f64>, String> {
    let (kind, words) = words.split_once(',').unwrap_or((words, ""));
    let said = |error: PolicyError| match std::error::Error::source(&error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    };
    let mut policy = Policies::default().make(&format!("{kind}:{NETWORKS},{words}")).map_err(said)?;
    let (info, mut first) = standing(robot, gains);
    first.last_action.fill(0.5);
    policy.reset(&info, &first).map_err(said)?;
    match policy.act(&first).map_err(said)? {
        Command::JointTarget(targets) => Ok(targets),
        other => Err(format!("{other:?}")),
    }
}

/// Each controller moves its joints and keeps the others in the staged posture, here 0.25 rad from the standing one.
#[test]
fn foreign_controllers_move_their_own_joints() {
    for name in Robot::NAMES {
        let robot = Robot::by_name(name).expect("loads");
        for (words, gains, moved) in [
            ("gear,vx=0.3", GainSet::Gear, 15),
            // On legs and waist the benchmark's gains are those of GEAR's makers.
            ("gear,height=0.7", GainSet::Fiatlux, 15),
            ("gear,reading=lerobot", GainSet::GearLerobot, 15),
            ("gear,reading=lerobot,gains=any", GainSet::Fiatlux, 15),
            ("sonic", GainSet::Sonic, 29),
            ("sonic,gains=any", GainSet::Fiatlux, 29),
        ] {
            let targets = foreign_targets(words, &robot, gains).expect(words);
            assert_eq!(targets.len(), robot.q0().len());
            for (joint, (target, q0)) in targets.iter().zip(robot.q0()).enumerate() {
                assert_eq!((target - q0 - 0.25).abs() < 1e-9, joint >= moved, "{words} joint {joint}");
            }
        }
    }
}

/// Every action's record has the policy's command to its whole-body controller.
#[test]
fn commands_are_recorded() {
    let robot = Robot::benchmark().expect("loads");
    let (info, first) = standing(&robot, GainSet::Fiatlux);
    for (name, height) in [("wbc:vx=0.25,wz=-0.5".to_owned(), 0.75), (format!("gear:{NETWORKS},vx=0.25,wz=-0.5"), 0.74)]
    {
        let mut policy = Policies::default().make(&name).expect("known");
        policy.reset(&info, &first).expect("resets");
        assert_eq!(policy.source(), None, "nothing is commanded yet");
        for index in 0..2 {
            policy.act(&first).expect("acts");
            let chunk = policy.source().expect("a command");
            assert_eq!((chunk.index, chunk.width, chunk.row), (index, 7, 0));
            assert_eq!(chunk.keys, ["navigate:3", "height:1", "torso:3"]);
            assert_eq!(chunk.values, [0.25, 0.0, -0.5, height, 0.0, 0.0, 0.0]);
        }
    }
}

/// The targets that are sent hold the arms' weight, and those of the policy stay what it asked for.
#[test]
fn a_body_can_hold_its_arms() {
    let robot = Robot::benchmark().expect("loads");
    let (info, observation) = standing(&robot, GainSet::Fiatlux);
    let sent = |mut body: WholeBody| {
        let (asked, command) = (body.targets.clone(), body.upright());
        let Ok(Command::JointTarget(sent)) = body.step(&observation, &command) else { panic!("no targets") };
        assert_eq!(body.targets[MOVED..], asked[MOVED..]);
        let added = sent.iter().zip(&body.targets).map(|(sent, asked)| (sent - asked).abs());
        added.collect::<Vec<f64>>()
    };
    let body =
        || WholeBody::own("test", Arc::new(Network::shipped().expect("weights")), &info, &observation).expect("a body");
    assert!(sent(body()).iter().all(|added| *added == 0.0));
    let added = sent(body().holding_arms(&info).expect("a G1"));
    let arms = &added[MOVED..BODY];
    assert!(arms.iter().any(|added| *added > 0.02) && arms.iter().all(|added| *added < 0.5), "{arms:?}");
    assert!(added[..MOVED].iter().chain(&added[BODY..]).all(|added| *added == 0.0));
    let mut short = body();
    let command = short.upright();
    short.targets.truncate(BODY - 1);
    let error = short.step(&observation, &command).expect_err("too few").to_string();
    assert!(error.contains("28 targets"), "{error}");
}

#[test]
fn foreign_controllers_refuse_what_does_not_fit() {
    let robot = Robot::benchmark().expect("loads");
    for (words, gains, said) in [
        ("sonic", GainSet::Fiatlux, "open the session with --gains sonic"),
        ("gear,reading=lerobot", GainSet::Gear, "--gains gear-lerobot"),
        ("gear,reading=mine", GainSet::Gear, "'reading=mine'"),
        ("gear,speed=1", GainSet::Gear, "use names of reading, gains, vx"),
        ("gear,vx=inf", GainSet::Gear, "'vx=inf'"),
        ("sonic,vx=1", GainSet::Sonic, "use names of token, stream, gains"),
        ("sonic,gains=soft", GainSet::Sonic, "'gains=soft'"),
        ("sonic,token=/nowhere.txt", GainSet::Sonic, "/nowhere.txt"),
    ] {
        let message = foreign_targets(words, &robot, gains).expect_err(words);
        assert!(message.contains(said), "{words}: {message}");
    }
    let error = Policies::default().make("gear:/nowhere").err().expect("refused");
    let source = std::error::Error::source(&error).expect("a cause").to_string();
    assert!(source.contains("/nowhere/Balance.onnx") && source.contains("weights are not shipped"), "{source}");
}
