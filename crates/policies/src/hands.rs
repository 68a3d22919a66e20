//! The policy `hands`: takes the spent bulb out of the socket (S03) and puts it into the crate (S06), takes the fresh one from the
//! bench (S08), and puts it into the socket (S11). The whole-body controller moves legs and waist, an expert for
//! each task the right arm and its hand. A bulb in the left hand is put into the crate with the left one.

mod apart;
mod arm;
mod grab;
mod insert;
mod judge;
mod lean;
mod parameters;
mod place;
mod plan;
mod remove;
mod retries;
mod room;
mod shape;
mod side;
mod skill;
mod socket;
mod stance;

use std::sync::Arc;

use fiatlux_proto::v3::{Chunk, Observation, Sensor, SessionInfo};
use fiatlux_rules::Task;
use fiatlux_skills::grip::HandBodies;
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{BODY, BodyCommand, CONTROL_DT, MOVED, Network};

use self::arm::{Arm, MakesArm};
use self::grab::Grab;
use self::insert::Insert;
pub(crate) use self::parameters::of_robot;
use self::place::Place;
use self::remove::Remove;
pub(crate) use self::room::AT_THE_PLATFORM;
use self::room::Walls;
use self::shape::Surroundings;
use self::side::Side;
pub(crate) use self::side::hand_link;
use self::skill::{Expert, Seen, TOUCHED};
use self::stance::REST;
use super::body;
use super::whole_body::WholeBody;
use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "hands",
    does: "changes the bulb by exact poses: S03, S06, S08 and S11",
    make: |_| Ok(Box::new(Hands::new()?)),
};

/// Plays the tasks that are done by hand while the robot stands.
pub struct Hands {
    network: Arc<Network>,
    parameters: Option<String>,
    /// It does not look where in its task the robot is.
    pub(crate) at_start: bool,
    episode: Option<Played>,
}

/// State of an episode.
struct Played {
    body: WholeBody,
    arm: Arm,
    skill: Box<dyn Expert>,
    bodies: HandBodies,
}

impl Hands {
    /// Played by hand while the robot stands.
    pub(crate) const TASKS: &[Task] = &[Task::S03, Task::S06, Task::S08, Task::S11];

    /// With the whole-body controller that comes with this version.
    ///
    /// # Errors
    /// Its weights cannot be read.
    pub fn new() -> Result<Self, PolicyError> {
        let (_, network) = body::network("hands", "", "")?;
        Ok(Self { network, parameters: None, at_start: false, episode: None })
    }

    /// With other parameters: TOML of the form of the task's file, with those values alone that differ. `base = "NAME"` begins from
    /// another file of `src/hands` than the robot's own, and `without` names what is left out of it.
    #[must_use]
    pub fn with_parameters(self, parameters: Option<String>) -> Self {
        Self { parameters, ..self }
    }

    /// Goes on with the arm that works where it is, and the other one as it stands at the start of a task. The last targets of whoever played
    /// before may have had the weight of the arms in them, which each step adds; the left thumb then meets the bench in S08.
    pub(crate) fn rest_arms(&mut self, first: &Observation) {
        let Some(Played { body, arm, .. }) = &mut self.episode else { return };
        arm.sense(&arm.pelvis(), joints(first));
        arm.rest_where_it_is();
        let standing = body.targets.iter_mut().zip(arm.q0()).take(BODY).skip(MOVED);
        standing.for_each(|(target, q0)| *target = *q0);
        arm.write(&mut body.targets);
    }

    /// Name of the phase that an episode is in, and how far the hand is from where it is wanted, m.
    pub fn progress(&mut self) -> Option<(String, f64)> {
        let Played { arm, skill, .. } = self.episode.as_mut()?;
        Some((skill.phase(), arm.lag()))
    }
}

impl Skill for Hands {
    fn is_over(&self) -> bool {
        self.episode.as_ref().is_some_and(|played| played.skill.is_over())
    }

    fn phase(&self) -> String {
        self.episode.as_ref().map(|played| played.skill.phase()).unwrap_or_default()
    }

    fn body_command(&self) -> Option<BodyCommand> {
        self.episode.as_ref()?.body.commanded()
    }
}

impl Policy for Hands {
    fn name(&self) -> String {
        "hands".into()
    }

    fn tasks(&self) -> &'static [Task] {
        Self::TASKS
    }

    fn sensors(&self) -> Vec<Sensor> {
        ["proprioception", "hand_contact", "last_action", "privileged"].map(Sensor::from).into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let task = info.task.as_ref().map(|task| task.task.as_str()).unwrap_or_default();
        let refused = || {
            let reason = format!("it plays S03, S06, S08 and S11, but this is {task}; use another policy");
            PolicyError::Unfit { policy: "hands", reason }
        };
        if !self.tasks().iter().any(|known| known.short_id() == task) {
            return Err(refused());
        }
        let is_up = matches!(task, "S03" | "S11");
        let body = WholeBody::own("hands", Arc::clone(&self.network), info, first)?.holding_arms(info)?;
        let mut body = if is_up { body.without_steps() } else { body.bending_low() };
        let bodies = HandBodies::new(&info.hand_bodies);
        let side = if task == "S06" { holding(first, &bodies) } else { Side::Right };
        let seen = seen(first, &bodies, side, false)?;
        let arm = |rest, surroundings| Arm::new(side, info, &body.targets, rest, surroundings);
        let walls = if is_up { Walls::of(info, &seen) } else { Walls::default() };
        let (own, targets, around_it) = (info.clone(), body.targets.clone(), walls.clone());
        let later: MakesArm = Box::new(move |around| Arm::new(side, &own, &targets, REST, around_it.and(around)));
        let mut skill: Box<dyn Expert> = match task {
            "S03" => Box::new(Remove::new(self.parameters.as_deref(), info, later)?),
            "S06" => Box::new(Place::new(self.parameters.as_deref(), side, info)?),
            "S08" => Box::new(Grab::new(self.parameters.as_deref(), info)?),
            "S11" => Box::new(Insert::new(self.parameters.as_deref(), info, later)?),
            _ => return Err(refused()),
        };
        let surroundings = match task {
            "S03" => walls.and(room::with_bulb_in_socket(&seen)),
            "S11" => {
                let hand = room::world_from_hand(info, first, &seen)?;
                walls.and(room::with_bulb_in_hand(&seen, hand.inv_mul(&seen.fresh_bulb)))
            }
            _ => Surroundings::default(),
        };
        let mut arm = arm(skill.rest(), surroundings)?;
        if !self.at_start {
            // A look changes nothing where the task begins at its start.
            let mut looking = arm.clone();
            looking.sense(&seen.pelvis, joints(first));
            if let Some(command) = skill.take_up(&seen, &mut looking)? {
                body.stand_by(command);
                arm = looking;
            }
        }
        self.episode = Some(Played { body, arm, skill, bodies });
        Ok(())
    }

    fn act(&mut self, observation: &Observation) -> Result<Command, PolicyError> {
        let Some(Played { body, arm, skill, bodies }) = &mut self.episode else {
            return Err(PolicyError::not_reset("hands"));
        };
        let seen = seen(observation, bodies, arm.side, body.is_standing())?;
        arm.sense(&seen.pelvis, joints(observation));
        let command = skill.step(&seen, arm, &mut body.targets)?;
        body.step(observation, &command)
    }

    fn source(&mut self) -> Option<Chunk> {
        self.episode.as_mut()?.body.record()
    }
}

/// Angles of all joints relative to the standing posture, rad.
fn joints(observation: &Observation) -> &[f32] {
    observation.proprioception.as_ref().map(|body| body.joint_position.as_slice()).unwrap_or_default()
}

/// The hand that a bulb touches; the right one where neither feels it, or both.
fn holding(observation: &Observation, bodies: &HandBodies) -> Side {
    let [left, right] = bodies.touch(&observation.hand_contact_force).map(|touch| touch.largest() > TOUCHED);
    if left && !right { Side::Left } else { Side::Right }
}

fn seen(observation: &Observation, bodies: &HandBodies, side: Side, stands: bool) -> Result<Seen, PolicyError> {
    let poses = observation.privileged.as_ref();
    let poses = poses.ok_or(PolicyError::Sensor { policy: "hands", sensor: "privileged" })?;
    let touch = bodies.touch(&observation.hand_contact_force)[side as usize];
    Ok(Seen {
        stands,
        time: observation.step as f64 * CONTROL_DT,
        pelvis: body::pose("hands", poses.robot.as_ref())?,
        ladder: body::pose("hands", poses.ladder.as_ref())?,
        socket: body::pose("hands", poses.socket.as_ref())?,
        fresh_bulb: body::pose("hands", poses.fresh_bulb.as_ref())?,
        old_bulb: body::pose("hands", poses.old_bulb.as_ref())?,
        crate_: body::pose("hands", poses.crate_.as_ref())?,
        seated: [0, 1].map(|bulb| poses.seated.get(bulb).copied().unwrap_or_default()),
        touch,
    })
}
