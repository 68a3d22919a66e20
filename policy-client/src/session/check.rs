//! What a session takes in and gives out has the right lengths and finite numbers.

use fiatlux_proto::v1::Observation;

use crate::{Command, PolicyError};

/// Passes an observation on whose terms are empty or of the right length.
pub fn observation(observation: Observation, joints: usize, hand_bodies: usize) -> Result<Observation, String> {
    let none = Default::default();
    let sensed = observation.proprioception.as_ref();
    let own = sensed.unwrap_or(&none);
    let in_proprioception = [
        ("base_angular_velocity", &own.base_angular_velocity, 3),
        ("projected_gravity", &own.projected_gravity, 3),
        ("base_linear_velocity", &own.base_linear_velocity, 3),
        ("joint_position", &own.joint_position, joints),
        ("joint_velocity", &own.joint_velocity, joints),
    ];
    let others = [
        ("hand_contact_force", &observation.hand_contact_force, 3 * hand_bodies),
        ("last_action", &observation.last_action, joints),
    ];
    for (index, (name, term, length)) in in_proprioception.into_iter().chain(others).enumerate() {
        let may_be_empty = index >= in_proprioception.len() || sensed.is_none();
        if term.len() != length && !(term.is_empty() && may_be_empty) {
            return Err(format!("{name} has {} numbers, not {length}", term.len()));
        }
    }
    Ok(observation)
}

/// Refuses a command that a server would refuse.
pub fn command(policy: &str, command: &Command, joints: usize, step: u64) -> Result<(), PolicyError> {
    let (field, numbers) = match command {
        Command::Action(numbers) => ("action", numbers),
        Command::JointTarget(numbers) => ("joint_target", numbers),
    };
    let problem = if numbers.len() != joints {
        format!("of {} numbers, not {joints},", numbers.len())
    } else if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
        format!("{} for joint {index}", numbers[index])
    } else {
        return Ok(());
    };
    Err(PolicyError::Command { policy: policy.into(), field, problem, step })
}
