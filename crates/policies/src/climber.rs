//! The climb as a controller: a policy says how fast and how upright, and balance stays with the plan's player.

use std::f64::consts::FRAC_PI_2;

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_proto::v3::{Observation, Privileged, SessionInfo, TaskInfo};
use fiatlux_rules::Task;
use fiatlux_skills::heading;
use fiatlux_skills::phases::Skill;
use nalgebra::{Isometry3, Vector3};

use crate::Climb;
use crate::body::message;

/// A command to a [`Climber`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClimbCommand {
    /// Part of the plan's own speed, from 0, which waits, to [`ClimbCommand::MAX_RATE`].
    pub rate: f64,
    /// By how much farther ahead and to the left the centre of mass is wanted than the plan has it, m, at most
    /// [`ClimbCommand::MAX_LEAN`] each way.
    pub lean: [f64; 2],
}

impl Default for ClimbCommand {
    fn default() -> Self {
        Self { rate: 1.0, lean: [0.0; 2] }
    }
}

impl ClimbCommand {
    /// Fastest, in parts of the plan's speed.
    pub const MAX_RATE: f64 = 1.25;
    /// Farthest lean each way, m.
    pub const MAX_LEAN: f64 = 0.03;

    /// Refuses what is not finite or out of range.
    ///
    /// # Errors
    /// [`PolicyError::Unfit`] with the field's name.
    pub fn check(&self) -> Result<(), PolicyError> {
        let range = |least: f64, most: f64| move |value: f64| (least..=most).contains(&value);
        let wrong = |field: &'static str, least: f64, most: f64| PolicyError::Unfit {
            policy: "climber",
            reason: format!("{field} is outside {least} to {most}"),
        };
        if !range(0.0, Self::MAX_RATE)(self.rate) {
            return Err(wrong("rate", 0.0, Self::MAX_RATE));
        }
        if !self.lean.iter().all(|lean| range(-Self::MAX_LEAN, Self::MAX_LEAN)(*lean)) {
            return Err(wrong("lean", -Self::MAX_LEAN, Self::MAX_LEAN));
        }
        Ok(())
    }
}

/// Climbs the step ladder on command. The robot may begin a few steps before the ladder, which it then walks, or anywhere in the climb.
pub struct Climber {
    climb: Climb,
    info: SessionInfo,
    has_begun: bool,
}

impl Climber {
    /// For one of the climbs, in a session of any task: `S02` up, `S10` up with a bulb in the right hand, `S12` down, `S04` down with a bulb.
    ///
    /// # Errors
    /// Another task, or weights that cannot be read.
    pub fn new(task: Task, info: &SessionInfo) -> Result<Self, PolicyError> {
        let climb = Climb::new()?;
        if !climb.tasks().contains(&task) {
            let reason = format!("it plays S02, S04, S10 and S12, but this is {task}");
            return Err(PolicyError::Unfit { policy: "climber", reason });
        }
        let task = Some(TaskInfo { task: task.short_id().into(), ..TaskInfo::default() });
        // Footprints are in the world's frame, poses here in the ladder's.
        let info = SessionInfo { task, footprints: Vec::new(), ..info.clone() };
        Ok(Self { climb, info, has_begun: false })
    }

    /// Begins another episode with the next observation.
    pub fn restart(&mut self) {
        self.has_begun = false;
    }

    /// Targets of all joints, rad, by proprioception and last action of an observation and by where the ladder is. What else the
    /// observation has is not read.
    ///
    /// # Errors
    /// The command is out of range, the observation lacks a term, or the climb cannot be played from where the robot is.
    pub fn step(
        &mut self,
        observation: &Observation,
        pelvis_from_ladder: &Isometry3<f64>,
        command: &ClimbCommand,
    ) -> Result<Vec<f64>, PolicyError> {
        command.check()?;
        let ladder_from_pelvis = pelvis_from_ladder.inverse();
        let privileged = Privileged {
            robot: Some(message(&ladder_from_pelvis)),
            ladder: Some(message(&Isometry3::identity())),
            ..Privileged::default()
        };
        let seen = Observation {
            step: observation.step,
            proprioception: observation.proprioception.clone(),
            last_action: observation.last_action.clone(),
            privileged: Some(privileged),
            ..Observation::default()
        };
        if !self.has_begun {
            self.climb.reset(&self.info, &seen)?;
            self.has_begun = true;
        }
        // From the robot's axes to the plan's, which stands across the ladder's.
        let [ahead, left] = command.lean;
        let turn = heading(&ladder_from_pelvis) - FRAC_PI_2;
        let (sin, cos) = (libm::sin(turn), libm::cos(turn));
        self.climb.set_pace(command.rate, Vector3::new(cos * ahead - sin * left, sin * ahead + cos * left, 0.0));
        match self.climb.act(&seen)? {
            Command::JointTarget(targets) => Ok(targets),
            _ => Err(PolicyError::Unfit { policy: "climber", reason: "the climb gave no joint targets".into() }),
        }
    }

    /// Name of what it does now, and the part of the climb that is done, from 0 to 1; `None` before it begins.
    pub fn progress(&self) -> (String, Option<f64>) {
        (self.climb.phase(), self.climb.part_done())
    }
}
