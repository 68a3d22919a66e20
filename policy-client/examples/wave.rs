//! A policy in twenty lines: stands, and waves with its left arm.

use std::error::Error;
use std::sync::atomic::AtomicBool;

use fiatlux_client::{Client, Command, Policy, PolicyError};
use fiatlux_link::{CarrierArgs, Role};
use fiatlux_policies::Stand;
use fiatlux_proto::v3::{Observation, OpenRequest, SessionInfo};

#[derive(Default)]
struct Wave {
    stand: Stand,
    elbow: usize,
}

impl Policy for Wave {
    fn name(&self) -> String {
        "wave".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        self.elbow = info.joints.iter().position(|joint| joint.name == "left_elbow_joint").unwrap_or(0);
        self.stand.reset(info, first)
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let mut command = self.stand.act(observation)?;
        if let Command::JointTarget(target) = &mut command {
            target[self.elbow] = 0.5 * (0.1 * observation.step as f64).sin();
        }
        Ok(command)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let link = CarrierArgs::default().open(Role::Client)?;
    let request = OpenRequest { task: "S01".into(), policy: "wave".into(), ..OpenRequest::default() };
    let mut client = Client::open(&link.carrier(), None, request)?;
    let end = client.run_episode(0, &mut Wave::default(), &mut |_| (), &AtomicBool::new(false))?;
    println!("{} after {} steps", end.cause, end.steps);
    Ok(client.close()?)
}
