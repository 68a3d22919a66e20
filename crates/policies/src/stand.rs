//! The policy `stand`.

use std::sync::Arc;

use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::{Gains, JointGains, Robot};

use super::body;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;
use fiatlux_wbc::{Balance, Proprioception};

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "stand",
    does: "keeps the robot upright on level ground by closing a loop over its centre of mass",
    make: |_| Ok(Box::new(Stand::default())),
};

/// Keeps the robot upright on level ground; see [`fiatlux_wbc::balance`].
#[derive(Debug, Default)]
pub struct Stand {
    balance: Option<Balance>,
    sensed: Proprioception,
    /// Targets that the episode starts with, rad.
    staged: Vec<f64>,
}

impl Policy for Stand {
    fn name(&self) -> String {
        "stand".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let staged = body::staged("stand", info, first)?;
        let unfit = |reason: String| PolicyError::Unfit { policy: "stand", reason };
        let joints = info.joints.iter().map(|joint| joint.name.as_str());
        let robot =
            Robot::of_session(&info.robot, joints).map_err(|error| unfit(format!("{error}; use another policy")))?;
        let gain = |(joint, own): (&fiatlux_proto::v3::Joint, &JointGains)| JointGains {
            stiffness: joint.stiffness,
            damping: joint.damping,
            effort_limit: joint.effort_limit,
            ..*own
        };
        let own = robot.gains(Default::default());
        let gains = Gains(info.joints.iter().zip(&own.0).map(gain).collect());
        let q0: Vec<f64> = info.joints.iter().map(|joint| joint.q0).collect();
        self.balance = Some(Balance::new(Arc::new(robot), gains, &q0).map_err(PolicyError::of("stand"))?);
        self.staged = staged;
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let missing = PolicyError::Sensor { policy: "stand", sensor: "proprioception" };
        let sensed = self.sensed.read(observation.proprioception.as_ref().ok_or(missing)?);
        let Some(balance) = &mut self.balance else { return Err(PolicyError::not_reset("stand")) };
        Ok(Command::JointTarget(balance.step(&sensed, &self.staged).map_err(PolicyError::of("stand"))?.to_vec()))
    }
}
