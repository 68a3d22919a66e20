//! A policy's command to the robot, and its check, which both ends of a session share.

use fiatlux_proto::BodyCommand;
use fiatlux_proto::limits::{MAX_CHUNK_KEYS, MAX_CHUNK_NUMBERS, MAX_CHUNK_PHASE, MAX_CHUNK_PROBLEM};
use fiatlux_proto::v3::{Action, Chunk, Joint, SessionInfo};
use thiserror::Error;

/// A command for one step. Lists have a number for each joint, in the order of `SessionInfo.joints`.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// In action units: joint target = q0 + action_scale * action.
    Action(Vec<f64>),
    /// Joint targets as angles, rad.
    JointTarget(Vec<f64>),
    /// Legs and waist follow the server's whole-body controller. The list has the angles at which arms and hands shall rest,
    /// rad; those of legs and waist are ignored. If it is empty, arms and hands keep their targets.
    WholeBody(BodyCommand, Vec<f64>),
}

/// Why a command is refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CommandError {
    #[error("{} filled", if *.both { "both action and joint_target are" } else { "neither action nor joint_target is" })]
    Form { both: bool },
    #[error("{field} has {found} numbers instead of {expected}")]
    Length { field: &'static str, found: usize, expected: usize },
    /// A number is NaN or infinite; without a bound in the session also a joint target that is infinite in action units.
    #[error("{field} of joint '{name}' is not finite")]
    NotFinite { field: &'static str, joint: usize, name: String, value: f64 },
    #[error("{field} of joint '{name}' is {value:?}; it must be from {low} to {high}")]
    Range { field: &'static str, joint: usize, name: String, value: f64, low: f64, high: f64 },
    #[error("both action and whole_body are filled")]
    Mixed,
    #[error("the session has no whole-body controller: it needs the G1's body, the gains 'fiatlux' and proprioception")]
    NoController,
    #[error("{field} is {value}; it must be from {low} to {high}")]
    WholeBody { field: &'static str, value: f64, low: f64, high: f64 },
    #[error("chunk {problem}")]
    Chunk { problem: &'static str },
}

impl CommandError {
    /// Name of the wrong field of the message.
    pub fn field(&self) -> &'static str {
        match self {
            Self::Form { .. } => "action",
            Self::Mixed | Self::NoController => "whole_body",
            Self::WholeBody { field, .. } => field,
            Self::Chunk { .. } => "chunk",
            Self::Length { field, .. } | Self::NotFinite { field, .. } | Self::Range { field, .. } => field,
        }
    }

    /// Remedy for the sender.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Range { field: "action", .. } => "clip the action, whose usual range is [-1, 1]",
            Self::Range { .. } => "clip joint targets to the limits of the joints",
            Self::Mixed => "send joint targets with whole_body, or none",
            Self::NoController => "send actions or joint targets",
            Self::WholeBody { .. } => "command something within SessionInfo.whole_body_range",
            Self::Chunk { .. } => "send the chunk as PROTOCOL.md describes it, or none",
            _ => "fill one of action and joint_target with a finite number for each joint, or whole_body",
        }
    }
}

impl Command {
    /// Reads the command of an action that arrived, and checks it against the session.
    ///
    /// # Errors
    /// [`CommandError`]: the form, the length, or a number that is not finite or out of range.
    pub fn of(action: &Action, info: &SessionInfo) -> Result<Self, CommandError> {
        let command = match (action.whole_body, action.action.is_empty(), action.joint_target.is_empty()) {
            (Some(command), true, _) => Self::WholeBody(command.into(), action.joint_target.clone()),
            (Some(_), false, _) => return Err(CommandError::Mixed),
            (None, false, true) => Self::Action(action.action.clone()),
            (None, true, false) => Self::JointTarget(action.joint_target.clone()),
            (None, neither, _) => return Err(CommandError::Form { both: !neither }),
        };
        command.check(info)?;
        action.chunk.as_ref().map_or(Ok(()), check_chunk)?;
        Ok(command)
    }

    /// Checks whether the session accepts the command.
    ///
    /// # Errors
    /// [`CommandError`]: the length, or a number that is not finite or out of range.
    pub fn check(&self, info: &SessionInfo) -> Result<(), CommandError> {
        let (field, numbers) = match self {
            Self::Action(numbers) => ("action", numbers),
            Self::JointTarget(numbers) => ("joint_target", numbers),
            Self::WholeBody(command, numbers) => {
                check_whole_body(command, info)?;
                if numbers.is_empty() {
                    return Ok(());
                }
                ("joint_target", numbers)
            }
        };
        let joints = &info.joints;
        if numbers.len() != joints.len() {
            return Err(CommandError::Length { field, found: numbers.len(), expected: joints.len() });
        }
        // Older servers set no bound; an action must still be finite.
        let limit = if info.action_limit > 0.0 { info.action_limit } else { f64::MAX };
        for (joint, (&value, Joint { name, q0, .. })) in numbers.iter().zip(joints).enumerate() {
            let (middle, unit) = match self {
                Self::Action(_) => (0.0, 1.0),
                Self::JointTarget(_) | Self::WholeBody(..) => (*q0, info.action_scale),
            };
            let is_within = ((value - middle) / unit).abs() <= limit;
            if !value.is_finite() || (!is_within && limit == f64::MAX) {
                return Err(CommandError::NotFinite { field, joint, name: name.clone(), value });
            }
            if !is_within {
                let (low, high) = (middle - unit * limit, middle + unit * limit);
                return Err(CommandError::Range { field, joint, name: name.clone(), value, low, high });
            }
        }
        Ok(())
    }

    /// The message that carries the command.
    pub fn into_action(self, episode: u64, step: u64) -> Action {
        let (action, joint_target, whole_body) = match self {
            Self::Action(numbers) => (numbers, Vec::new(), None),
            Self::JointTarget(numbers) => (Vec::new(), numbers, None),
            Self::WholeBody(command, numbers) => (Vec::new(), numbers, Some(command.into())),
        };
        Action { episode, step, action, joint_target, chunk: None, whole_body }
    }
}

/// Checks a whole-body command against the ranges that the session announces; NaN is within none.
fn check_whole_body(command: &BodyCommand, info: &SessionInfo) -> Result<(), CommandError> {
    let (ranges, rest) = info.whole_body_range.as_chunks::<2>();
    let (Ok(ranges), []) = (<&[[f64; 2]; 7]>::try_from(ranges), rest) else { return Err(CommandError::NoController) };
    let Some((index, value)) = command.outside(ranges) else { return Ok(()) };
    let [low, high] = ranges[index];
    Err(CommandError::WholeBody { field: BodyCommand::FIELDS[index], value, low, high })
}

/// Checks the bounds of a model's chunk.
pub(crate) fn check_chunk(chunk: &Chunk) -> Result<(), CommandError> {
    let is_time = |time: f64| time.is_finite() && time >= 0.0;
    let count = chunk.values.len();
    let width = chunk.width as usize;
    let [most_keys, longest_key] = MAX_CHUNK_KEYS;
    let checks = [
        (count <= MAX_CHUNK_NUMBERS, "has too many numbers"),
        (if width == 0 { count == 0 } else { count.is_multiple_of(width) }, "has numbers that do not fill its rows"),
        (chunk.values.iter().all(|number| number.is_finite()), "has a number that is not finite"),
        (is_time(chunk.age_s) && is_time(chunk.latency_s), "has a time that is negative or not finite"),
        (chunk.server_s.is_none_or(is_time), "has a time that is negative or not finite"),
        (chunk.keys.len() <= most_keys, "has too many keys"),
        (chunk.keys.iter().all(|key| key.len() <= longest_key), "has a key that is too long"),
        (chunk.problem.len() <= MAX_CHUNK_PROBLEM, "has a problem that is too long"),
        (chunk.phase.len() <= MAX_CHUNK_PHASE, "has a phase that is too long"),
    ];
    match checks.iter().find(|(holds, _)| !holds) {
        Some((_, problem)) => Err(CommandError::Chunk { problem }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards each bound: a chunk within it is accepted, one beyond it is refused by its field.
    #[test]
    fn chunks_are_bounded() {
        let good = Chunk {
            values: vec![0.5; 3300],
            width: 33,
            keys: vec!["k".repeat(64); 32],
            problem: "p".repeat(256),
            phase: "p".repeat(64),
            server_s: Some(0.1),
            ..Chunk::default()
        };
        assert_eq!(check_chunk(&good), Ok(()));
        assert_eq!(check_chunk(&Chunk::default()), Ok(()));
        let wrong: [fn(&mut Chunk); 10] = [
            |chunk| chunk.values.resize(3333, 0.0),
            |chunk| chunk.values.truncate(34),
            |chunk| chunk.width = 0,
            |chunk| chunk.values[7] = f32::NAN,
            |chunk| chunk.age_s = -1.0,
            |chunk| chunk.latency_s = f64::INFINITY,
            |chunk| chunk.server_s = Some(f64::NAN),
            |chunk| chunk.keys.push(String::new()),
            |chunk| chunk.problem.push('p'),
            |chunk| chunk.phase.push('p'),
        ];
        let info = SessionInfo { joints: vec![Joint::default()], action_scale: 1.0, ..SessionInfo::default() };
        for change in wrong {
            let mut chunk = good.clone();
            change(&mut chunk);
            let action = Action { action: vec![0.0], chunk: Some(chunk), ..Action::default() };
            assert_eq!(Command::of(&action, &info).map_err(|error| error.field()), Err("chunk"));
        }
    }
}
