use fiatlux_bag::BagWriter;
use fiatlux_proto::v3::{
    Action, ActionRecord, EpisodeHeader, EpisodeResult, Joint, Observation, Proprioception, SessionInfo,
};
use fiatlux_proto::{Message, PROTOCOL};

use super::*;
use crate::Command;

fn session(seed: u64) -> SessionInfo {
    SessionInfo { seed, joints: vec![Joint::default(); 4], ..SessionInfo::default() }
}

/// The first commands of an episode.
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
    let mut zero = by_name("zero").expect("known");
    assert_eq!(commands(zero.as_mut(), 0, 0, &[]), vec![Command::Action(vec![0.0; 4]); 3]);
    let mut hold = by_name("hold").expect("known");
    let staged = [0.25, -0.5, 1.5, 0.0];
    let expected = Command::Action(staged.map(f64::from).to_vec());
    assert_eq!(commands(hold.as_mut(), 0, 0, &staged), vec![expected; 3]);
    let error = hold.reset(&session(0), &Observation::default()).expect_err("refused").to_string();
    assert!(error.contains("needs the sensor last_action"), "{error}");
}

/// The draws depend on seed and episode, and on nothing that came before.
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
fn an_unknown_name_is_answered_with_the_known_ones() {
    for name in ["walk", "", "replay:", "replay"] {
        let message = by_name(name).err().expect("refused").to_string();
        assert!(message.contains("zero, random, hold, stand, replay:BAG"), "{message}");
    }
    assert!(matches!(by_name("replay:/nowhere.mcap"), Err(PolicyError::Bag(_))));
}

/// What was received is sent again, actions as actions and targets as targets, bit for bit; then the policy says that
/// there is no more.
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

    let mut replay = by_name(&format!("replay:{}", path.display())).expect("opens");
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

/// In the standing posture at rest the controller is content: no target is far from the posture.
#[test]
fn stand_answers_with_targets_of_all_joints() {
    let robot = fiatlux_robot::Robot::g1_inspire().expect("loads");
    let joint = |(joint, q0): (&fiatlux_robot::Joint, &f64)| Joint {
        name: joint.name.clone(),
        q0: *q0,
        stiffness: joint.gains.stiffness,
        damping: joint.gains.damping,
        effort_limit: joint.gains.effort_limit,
        ..Joint::default()
    };
    let joints: Vec<Joint> = robot.joints().iter().zip(robot.q0()).map(joint).collect();
    let count = joints.len();
    let info = SessionInfo { joints, action_scale: 0.5, ..SessionInfo::default() };
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
    let mut stand = by_name("stand").expect("known");
    stand.reset(&info, &first).expect("resets");
    let Command::JointTarget(targets) = stand.act(&first).expect("acts") else { panic!("actions") };
    assert_eq!(targets.len(), count);
    let farthest = targets.iter().zip(robot.q0()).map(|(target, q0)| (target - q0).abs()).fold(0.0, f64::max);
    assert!(farthest < 0.5, "{farthest}");

    let blind = Observation { proprioception: None, ..first.clone() };
    assert!(matches!(stand.reset(&info, &blind), Err(PolicyError::Sensor { sensor: "proprioception", .. })));
    assert!(matches!(stand.reset(&session(0), &first), Err(PolicyError::Unfit { .. })));
}
