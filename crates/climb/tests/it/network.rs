//! The file of a network, and what a follower makes of it.

use std::sync::Arc;

use fiatlux_climb::{Body, Contract, Follower, Network, NetworkError, OBSERVED, Reference, Tracker};
use fiatlux_robot::{GainSet, MOVED, Robot};

/// A file whose network gives the same action for every observation.
fn file(contract: &str, action: f32) -> Vec<u8> {
    let (weight, bias, example) = (vec![0.0; MOVED * OBSERVED], vec![action; MOVED], vec![0.5; OBSERVED]);
    let tensors = [
        ("layer0.weight".to_owned(), vec![MOVED, OBSERVED], weight.as_slice()),
        ("layer0.bias".to_owned(), vec![MOVED], bias.as_slice()),
        ("check.observation".to_owned(), vec![OBSERVED], example.as_slice()),
        ("check.action".to_owned(), vec![MOVED], bias.as_slice()),
    ];
    let bytes = fiatlux_safetensors::write(tensors.into_iter());
    // The writer knows no metadata.
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header = String::from_utf8(bytes[8..8 + length].to_vec()).unwrap();
    let contract = serde_json::json!(contract);
    let header = format!("{{\"__metadata__\":{{\"contract\":{contract}}},{}", &header.trim_end()[1..]);
    let mut whole = (header.len() as u64).to_le_bytes().to_vec();
    whole.extend(header.as_bytes());
    whole.extend(&bytes[8 + length..]);
    whole
}

fn contract() -> Contract {
    Contract::of_this_version(&[], 60.0, [3, 1000], 1.5, "a processor".into()).unwrap()
}

#[test]
fn a_follower_adds_the_networks_action_to_the_plan() {
    let network = Arc::new(Network::from_bytes(&file(&contract().to_json(), 0.5)).unwrap());
    assert_eq!(*network.contract(), contract());
    let robot = Robot::by_name("g1_bare").unwrap();
    let gains = robot.gains(GainSet::default());
    let body = Body::new(robot, gains).unwrap();
    let reference = Reference::new(&body, &fiatlux_climb::ladder().unwrap(), 60.0).unwrap();
    assert!((60.0..62.0).contains(&reference.seconds()), "{}", reference.seconds());
    let due = reference.at(30.0);
    let mut follower = Follower::new(network, Tracker::new(Arc::new(body), Arc::new(reference)));
    follower.tracker.restart(30.0, -2.0);
    let mut targets = vec![9.0; 30];
    follower.step(&due.pelvis, &due.angles, &[0.0; 29], &mut targets);
    let knee = due.angles[3] + due.lead[3] + 0.15 * 0.5;
    assert!((targets[3] - knee).abs() < 1e-6, "{} {knee}", targets[3]);
    assert!((targets[20] - due.angles[20] - due.lead[20]).abs() < 1e-9 && targets[29] == 9.0);
    assert!((follower.tracker.time() - 29.96).abs() < 1e-9);
    // Where the plan has the robot, it sees no error.
    assert!(follower.tracker.com_error().norm() < 0.01);
}

#[test]
fn files_that_do_not_fit_are_refused() {
    let with = |change: &dyn Fn(&mut Contract)| {
        let mut contract = contract();
        change(&mut contract);
        Network::from_bytes(&file(&contract.to_json(), 0.5)).unwrap_err().to_string()
    };
    assert!(with(&|contract| contract.plan = "another".into()).contains("plan another"));
    assert!(with(&|contract| contract.engine = "benchmark 0".into()).contains("engine benchmark 0"));
    assert!(with(&|contract| contract.robots.truncate(1)).contains("robots"));
    assert!(with(&|contract| contract.layers = vec![3, 15]).contains("network of [3, 15]"));
    assert!(with(&|contract| contract.layers.clear()).contains("network of []"));
    assert!(with(&|contract| contract.layers = vec![OBSERVED, 1 << 20, MOVED]).contains("hidden layer of 1048576"));
    let fine = file(&contract().to_json(), 0.5);
    assert!(matches!(Network::from_bytes(&file("{}", 0.5)), Err(NetworkError::Contract(Some(_)))));
    assert!(matches!(Network::from_bytes(&fine[..fine.len() / 2]), Err(NetworkError::File(_))));
    assert!(matches!(Network::from_bytes(&file(&contract().to_json(), f32::NAN)), Err(NetworkError::Weights(_))));
}
