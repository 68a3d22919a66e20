use fiatlux_proto::v1::{Joint, Observation, SessionInfo};

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
