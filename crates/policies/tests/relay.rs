//! Relays: another policy for one subtask of the errand.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../examples/game/mod.rs"]
mod game;

use std::sync::{Arc, Mutex};

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_policies::{Expert, Policies};
use fiatlux_proto::v3::{Observation, ObservationTerm, Sensor, SessionInfo};
use fiatlux_rules::{Relay, Task};
use game::{Game, Start};

/// Sensors of the sessions here, and a field of each.
const FIELDS: [(&str, &str); 4] = [
    ("proprioception", "proprioception.base_height"),
    ("hand_contact", "hand_contact_force"),
    ("last_action", "last_action"),
    ("privileged", "privileged.robot.position"),
];

/// Plays the errand from the start of S07 on; the subtask of each step, and the pelvis at the end.
fn played(policy: &mut dyn Policy, steps: usize) -> (Vec<Option<Task>>, [f64; 3]) {
    let mut game = Game::start(Start { task: Task::Replace, ..Start::of(Task::S07, 1003).unwrap() }).unwrap();
    let mut seen = game.observe().unwrap();
    let term = |(sensor, field): &(&str, &str)| {
        let (sensor, field) = ((*sensor).to_owned(), (*field).to_owned());
        ObservationTerm { sensor, field, ..ObservationTerm::default() }
    };
    game.info.terms = FIELDS.iter().map(term).collect();
    policy.reset(&game.info, &seen).unwrap();
    let mut tasks = Vec::new();
    for _ in 0..steps {
        policy.look(&seen);
        seen = game.step(policy, &seen, None).unwrap();
        tasks.push(Relay::task_of(&policy.source().unwrap().phase));
    }
    (tasks, game.world().row().robot.pose.translation.vector.into())
}

/// The expert's own skill in another's place moves as the expert does, to the last bit, while its subtask lasts: it is given the state
/// that it would have had. When it ends is for the relay to see, so the next skill may begin later than in the expert's own errand.
#[test]
fn a_relay_of_the_experts_own_skill_changes_no_motion() {
    let long = std::env::var_os("FIATLUX_SLOW_TESTS").is_some();
    let steps = if long { 600 } else { 250 };
    let relay = || Policies::default().make("expert with S07=walk").unwrap();
    let (_, plain) = played(&mut Expert::new().unwrap(), steps);
    let (tasks, relayed) = played(relay().as_mut(), steps);
    assert!(tasks.iter().all(|task| *task == Some(Task::S07)));
    assert_eq!(plain, relayed);
    if long {
        let (tasks, _) = played(relay().as_mut(), 1000);
        assert_eq!(tasks[999], Some(Task::S08), "the next skill took over");
    }
}

/// Its name says who plays what, and it plays the errand alone.
#[test]
fn relays_are_made_by_name() {
    let make = |name: &str| Policies::default().make(name);
    let relay = make("expert with S07=walk with S03=hold").unwrap();
    assert_eq!((relay.name().as_str(), relay.tasks()), ("expert with S07=walk with S03=hold", &[Task::Replace][..]));
    for (name, reason) in [
        ("walk with S07=stand", "use expert"),
        ("expert with S07=walk with S07=stand", "two policies"),
        ("expert with S07=wlak", "did you mean 'walk'"),
    ] {
        let error = make(name).err().unwrap().to_string();
        assert!(error.contains(reason), "{name}: {error}");
    }
}

/// A policy that notes what it is given.
struct Notes {
    sensors: Vec<Sensor>,
    seen: Arc<Mutex<Vec<Observation>>>,
}

impl Policy for Notes {
    fn name(&self) -> String {
        "notes".into()
    }

    fn sensors(&self) -> Vec<Sensor> {
        self.sensors.clone()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.clone().unwrap();
        assert_eq!((task.task.as_str(), task.instruction.as_str()), ("S07", Task::S07.instruction()));
        assert!(info.terms.iter().all(|term| term.sensor != "privileged"));
        self.seen.lock().unwrap().push(first.clone());
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        self.seen.lock().unwrap().push(observation.clone());
        Ok(Command::Action(self.seen.lock().unwrap()[0].last_action.iter().map(|&angle| f64::from(angle)).collect()))
    }
}

/// Another's policy gets an episode of its own subtask, with the sensors that it asks for: the expert's exact poses are not shown.
#[test]
fn a_guest_sees_what_it_asks_for() {
    let own = ["proprioception", "hand_contact", "last_action"];
    for asked in [&own[..], &[], &["last_action"]] {
        let seen = Arc::default();
        let notes = Notes { sensors: asked.iter().map(|name| Sensor::from(*name)).collect(), seen: Arc::clone(&seen) };
        let mut relay = Expert::new().unwrap().with(vec![(Task::S07, Box::new(notes))]).unwrap();
        assert!(relay.sensors().contains(&Sensor::from("privileged")));
        let (tasks, _) = played(&mut relay, 20);
        assert!(tasks.iter().all(|task| *task == Some(Task::S07)));
        let seen: Vec<Observation> = std::mem::take(&mut seen.lock().unwrap());
        assert_eq!(seen.iter().map(|seen| seen.step).collect::<Vec<_>>(), [&[0][..], &Vec::from_iter(0..20)].concat());
        for seen in &seen {
            assert!(seen.privileged.is_none() && !seen.last_action.is_empty());
            assert_eq!(seen.proprioception.is_some(), asked.len() != 1);
        }
    }
    let sensors = vec![Sensor { rate_hz: 10.0, ..Sensor::from("privileged") }];
    let notes = Notes { sensors, seen: Arc::default() };
    let error = Expert::new().unwrap().with(vec![(Task::S07, Box::new(notes))]).err().unwrap().to_string();
    assert!(error.contains("sensor privileged in different forms"), "{error}");
}
