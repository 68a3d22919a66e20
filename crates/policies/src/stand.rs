//! The policy `stand`.

use std::sync::Arc;

use fiatlux_proto::v3::{Observation, Proprioception, SessionInfo};
use fiatlux_robot::{Gains, JointGains, Robot};

use super::body;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;
use fiatlux_wbc::{Balance, Sensed};

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
        let robot = Robot::with_joints(joints).map_err(|error| unfit(format!("{error}; use another policy")))?;
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
        let (Some(balance), sensed) = (&mut self.balance, proprioception(observation)?) else {
            return Err(PolicyError::not_reset("stand"));
        };
        let joint_position: Vec<f64> = sensed.joint_position.iter().map(|&angle| f64::from(angle)).collect();
        let sensed = Sensed {
            base_angular_velocity: vector(&sensed.base_angular_velocity),
            projected_gravity: vector(&sensed.projected_gravity),
            base_linear_velocity: vector(&sensed.base_linear_velocity),
            base_height: f64::from(sensed.base_height),
            joint_position: &joint_position,
            joint_velocity: &[],
        };
        Ok(Command::JointTarget(balance.step(&sensed, &self.staged).map_err(PolicyError::of("stand"))?.to_vec()))
    }
}

fn proprioception(observation: &Observation) -> Result<&Proprioception, PolicyError> {
    observation.proprioception.as_ref().ok_or(PolicyError::Sensor { policy: "stand", sensor: "proprioception" })
}

fn vector(term: &[f32]) -> [f64; 3] {
    [0, 1, 2].map(|axis| term.get(axis).map_or(f64::NAN, |&value| f64::from(value)))
}
