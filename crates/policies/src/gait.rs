//! Walks on command with the whole-body controller: velocities set in gently, and free arms hang and swing while hands that hold keep the
//! staged posture; or arms and hands move as a policy says.

use std::sync::Arc;

use fiatlux_client::{Command, PolicyError};
use fiatlux_proto::v3::{Chunk, Observation, SessionInfo};
use fiatlux_rules::Thresholds;
use fiatlux_skills::grip::{Carrying, Hold};
use fiatlux_skills::{Slew, towards};
use fiatlux_wbc::{BODY, BodyCommand, MOVED, Network, Swing};

use crate::{WholeBody, body};

/// Sensors that it reads.
pub(crate) const SENSORS: [&str; 3] = ["proprioception", "hand_contact", "last_action"];
/// Largest changes of the velocity.
const SLEW: Slew = Slew { linear: 0.6, turn: 1.2 };
/// Largest rates of the targets that a policy gives to arms and to hands, rad/s.
const RATES: [f64; 2] = [1.2, 3.0];
/// Control steps for which the robot stands first, while the controller takes over the staged posture.
const SETTLES: u64 = 25;

/// A body that walks.
pub(crate) struct Gait {
    /// Name of the policy, for its errors.
    policy: &'static str,
    body: WholeBody,
    /// `None` where the policy moves the arms.
    swing: Option<Swing>,
    /// Hands that carry keep their grip.
    hold: Hold,
    q0: Vec<f64>,
    /// Where the policy wants arms and hands, rad, as far as it said.
    wanted: Vec<f64>,
    /// Least and greatest angles of all joints, rad.
    limits: Vec<[f64; 2]>,
    /// Hands that no bulb has touched yet, left first.
    is_free: [bool; 2],
    velocity: [f64; 3],
}

impl Gait {
    /// Starts an episode.
    ///
    /// # Errors
    /// As [`WholeBody::own`].
    pub fn new(
        policy: &'static str,
        network: Arc<Network>,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<Self, PolicyError> {
        let body = WholeBody::own(policy, network, info, first)?;
        let swing = Some(Swing::new(&body.targets));
        let carries = info.task.as_ref().and_then(|task| Carrying::of_task(&task.task));
        Ok(Self {
            policy,
            hold: carries.map(|carries| Hold::new(&info.joints, carries, &body.targets)).unwrap_or_default(),
            body,
            swing,
            q0: info.joints.iter().map(|joint| joint.q0).collect(),
            wanted: Vec::new(),
            limits: Vec::new(),
            is_free: [true; 2],
            velocity: [0.0; 3],
        })
    }

    /// Starts an episode in which the policy moves arms and hands, and the robot may bend low where it stands.
    ///
    /// # Errors
    /// As [`WholeBody::own`].
    pub fn with_hands(
        policy: &'static str,
        network: Arc<Network>,
        info: &SessionInfo,
        first: &Observation,
    ) -> Result<Self, PolicyError> {
        let body = WholeBody::own(policy, network, info, first)?.bending_low();
        let limits = info.joints.iter().map(|joint| [joint.lower, joint.upper]).collect();
        let (hold, q0) = (Hold::default(), Vec::new());
        Ok(Self {
            policy,
            body,
            swing: None,
            hold,
            q0,
            wanted: Vec::new(),
            limits,
            is_free: [true; 2],
            velocity: [0.0; 3],
        })
    }

    /// Wants other targets of arms and hands, rad, to which each step comes nearer.
    pub fn moves(&mut self, wanted: &[f32]) {
        let joints = self.limits.iter().skip(MOVED).zip(wanted);
        // Not clamp: limits come from the network, and need not be in order.
        self.wanted = joints.map(|([lower, upper], angle)| f64::from(*angle).max(*lower).min(*upper)).collect();
    }

    /// Answers an observation; the velocity comes nearer to the wanted one, but a stop is at once.
    ///
    /// # Errors
    /// As [`WholeBody::step`].
    pub fn step(&mut self, observation: &Observation, wanted: BodyCommand) -> Result<Command, PolicyError> {
        let goes = wanted.walks() && observation.step >= SETTLES;
        self.velocity = if goes { SLEW.step(self.velocity, wanted.velocity) } else { [0.0; 3] };
        let command = BodyCommand { velocity: self.velocity, ..wanted };
        if let Some(swing) = &mut self.swing {
            let touched = touched(&observation.hand_contact_force);
            self.is_free.iter_mut().zip(touched).for_each(|(is_free, touched)| *is_free &= !touched);
            swing.step(&command, self.body.stride(), self.is_free, &mut self.body.targets);
        }
        for (joint, (target, wanted)) in (MOVED..).zip(self.body.targets.iter_mut().skip(MOVED).zip(&self.wanted)) {
            *target = towards(*target, *wanted, RATES[usize::from(joint >= BODY)]);
        }
        if !self.hold.is_empty() {
            self.hold.write(&body::angles(body::sensed(self.policy, observation)?, &self.q0), &mut self.body.targets);
        }
        self.body.step(observation, &command)
    }

    /// As [`WholeBody::commanded`].
    pub fn commanded(&self) -> Option<BodyCommand> {
        self.body.commanded()
    }

    /// As [`WholeBody::record`].
    pub fn record(&mut self) -> Option<Chunk> {
        self.body.record()
    }
}

/// True for each hand that a bulb touches, left first, by the sensor `hand_contact`, which has the right hand first.
fn touched(forces: &[f32]) -> [bool; 2] {
    let (right, left) = forces.split_at(forces.len() / 2);
    let force = |body: &[f32; 3]| body.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
    [left, right].map(|hand| hand.as_chunks().0.iter().any(|body| force(body) > Thresholds::default().touch_n))
}

#[cfg(test)]
mod tests {
    use super::touched;

    #[test]
    fn a_hand_that_a_bulb_presses_is_told_from_the_other() {
        let mut forces = [0.0; 2 * 3 * 3];
        assert_eq!(touched(&forces), [false, false]);
        forces[4] = -1.2;
        assert_eq!(touched(&forces), [false, true]);
        forces[4] = 0.9;
        forces[17] = 5.0;
        assert_eq!(touched(&forces), [true, false]);
        assert_eq!(touched(&[]), [false, false]);
    }
}
