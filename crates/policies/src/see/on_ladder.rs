//! Tasks on the ladder: where the robot is by its own senses, and what to do there by the experts for exact poses.

use std::f64::consts::{FRAC_PI_2, PI};

use fiatlux_client::{Command, Policy, PolicyError};
use fiatlux_climb::Body;
use fiatlux_dynamics::Site;
use fiatlux_proto::v3::{Chunk, Observation, Privileged, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_room::{fixture, ladder, start};
use fiatlux_rules::Task;
use fiatlux_skills::grip::HandBodies;
use fiatlux_skills::phases::Skill;
use fiatlux_wbc::{BODY, LEGS};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::bulb::{Bulb, Fresh, Old};
use super::finds::Found;
use super::posture::Posture;
use super::reckoning::{EVERY, FOUND, Goes, Reckoning};
use crate::Climb;
use crate::body::{angles, message, sensed};
use crate::hands::{Hands, hand_link};

/// Tasks that are played so, in which a network says where the robot is.
pub(super) const TASKS: [Task; 6] = [Task::S02, Task::S03, Task::S04, Task::S10, Task::S11, Task::S12];
/// Height of the pelvis from which a task begins on the platform, m, and from which pictures say where the robot is.
const UP_M: f64 = 1.6;
const PICTURES_M: f64 = 1.55;
/// Standard deviations of where on the platform it begins, from the middle, m and rad.
const SPREAD: [f64; 2] = [0.02, 0.05];
/// The least that pictures err by: x and y, m, and heading, rad.
const ERRS: [f64; 3] = [0.008, 0.006, 0.02];
/// Pictures err alike for a while: so much more than the network says of each.
const ALIKE: f64 = 4.0;
/// Control steps for which a robot stands before it plans how its hand puts the bulb in: by then it knows better where it is. Of 24 S11
/// that were planned at once 11 failed, most of them as the bulb struck the guard rail; of the same 24 planned then, 3.
const STANDS: u64 = 50;
/// The most that a picture is sure of where the socket is.
const SURE: f64 = 4.0;

/// A policy for exact poses, and the bulb that it works at.
enum Plays {
    Climb(Box<Climb>),
    TakesOut(Box<Hands>, Old),
    PutsIn(Box<Hands>, Fresh),
}

impl Plays {
    fn new(task: Task) -> Result<Self, PolicyError> {
        Ok(match task {
            Task::S03 => Self::TakesOut(Box::new(Hands::new()?), Old::default()),
            Task::S11 => Self::PutsIn(Box::new(Hands::new()?), Fresh::new()),
            _ => Self::Climb(Box::new(Climb::new()?.with_arms_ahead())),
        })
    }

    fn policy(&mut self) -> &mut dyn Policy {
        match self {
            Self::Climb(climb) => climb.as_mut(),
            Self::TakesOut(hands, _) | Self::PutsIn(hands, _) => hands.as_mut(),
        }
    }
}

/// A task by the robot's own senses.
pub(super) struct OnLadder {
    info: SessionInfo,
    plays: Plays,
    /// Control step of the first command.
    began: Option<u64>,
    /// Where joints are at 0, rad.
    q0: Vec<f64>,
    reckoning: Reckoning,
    /// Sum of what pictures say for a socket at a wall.
    wall: f64,
    /// Pictures so far.
    looks: f64,
    posture: Posture,
    bodies: HandBodies,
    hand: Site,
}

impl OnLadder {
    /// Begins an episode of one of the tasks that [`Plays::new`] knows.
    ///
    /// # Errors
    /// The robot lacks what it plays with, or its LiDAR does not see the ladder.
    pub fn new(task: Task, info: &SessionInfo, first: &Observation) -> Result<Self, PolicyError> {
        let unfit = |reason: &str| PolicyError::Unfit { policy: "see", reason: reason.into() };
        let robot = Robot::of_session(&info.robot, info.joints.iter().map(|joint| joint.name.as_str()));
        let robot = robot.map_err(|error| unfit(&error.to_string()))?;
        let hand = hand_link(&robot).ok_or_else(|| unfit("the robot has no right hand; use another robot"))?;
        let gains = robot.gains(Default::default());
        let body =
            Body::new(robot, gains).ok_or_else(|| unfit("its drives do not fit the robot; use another robot"))?;
        let link = &body.ids.links[hand];
        let hand = Site { body: link.body, body_from_site: link.body_from_link };
        let q0: Vec<f64> = info.joints.iter().map(|joint| joint.q0).collect();
        let [x, y, z] = ladder::TOP_POINT;
        let up = Isometry3::from_parts(
            Vector3::new(x, y, z + start::PLATFORM_PELVIS).into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2),
        );
        let reckoning = Reckoning::new(body, up, SPREAD);
        let mut reckoning = reckoning.ok_or_else(|| unfit("the robot has no LiDAR; use another robot"))?;
        let sensed = sensed("see", first)?;
        if f64::from(sensed.base_height) < UP_M {
            let seen = reckoning.search(sensed, &angles(sensed, &q0), &first.lidar, EVERY);
            let seen = seen.filter(|seen| seen.cost.is_finite());
            let seen = seen.ok_or_else(|| unfit("the LiDAR does not see the ladder; begin before it or on it"))?;
            reckoning.begin(seen.ladder_from_pelvis, FOUND);
        }
        Ok(Self {
            // Footprints are in the world's frame, poses here in the ladder's.
            info: SessionInfo { footprints: Vec::new(), ..info.clone() },
            plays: Plays::new(task)?,
            began: None,
            q0,
            reckoning,
            wall: 0.0,
            looks: 0.0,
            posture: Posture::default(),
            bodies: HandBodies::new(&info.hand_bodies),
            hand,
        })
    }

    /// The next command. `find` says what is found in pictures, where there are any; it is asked where that counts.
    ///
    /// # Errors
    /// An observation without what the robot senses, or the policy that plays refuses.
    pub fn act(
        &mut self,
        observation: &Observation,
        find: impl FnOnce() -> Option<Found>,
    ) -> Result<Command, PolicyError> {
        let sensed = sensed("see", observation)?;
        let angles = angles(sensed, &self.q0);
        let scan = (!observation.lidar.is_empty()).then_some(observation.lidar.as_slice());
        let (goes, rests) = match &self.plays {
            Plays::Climb(climb) => (climb.acceleration().map_or(Goes::Walks, Goes::ByPlan), climb.rests()),
            _ => (Goes::Stands, [true; 2]),
        };
        self.reckoning.step(sensed, &angles, goes, rests, scan);
        let is_up = self.reckoning.ladder_from_pelvis().translation.z > PICTURES_M;
        if is_up && let Some(found) = find() {
            self.look(&found);
        }
        if !matches!(self.plays, Plays::Climb(_)) {
            let target = |(q0, action): (&f64, &f32)| q0 + self.info.action_scale * f64::from(*action);
            let targets: Vec<f64> = self.q0.iter().zip(&observation.last_action).map(target).collect();
            self.posture.step(&angles, &targets);
        }
        let seen = self.seen(observation);
        let steps = observation.step.saturating_sub(*self.began.get_or_insert(observation.step));
        if steps == 0 || steps == STANDS && matches!(self.plays, Plays::PutsIn(..)) {
            self.plays.policy().reset(&self.info, &seen)?;
        }
        if let Plays::Climb(climb) = &mut self.plays {
            climb.set_moves(self.reckoning.moves());
        }
        self.plays.policy().act(&seen)
    }

    /// Takes in what was found in pictures.
    fn look(&mut self, found: &Found) {
        self.looks += 1.0;
        // Of a robot that stands they err alike as long as it does: all of them together say little more than one.
        let alike = match &self.plays {
            Plays::Climb(_) => ALIKE,
            _ => ALIKE * libm::sqrt(self.looks),
        };
        self.reckoning.find(found.place, std::array::from_fn(|index| ERRS[index].max(alike * found.spread[index])));
        self.wall += found.wall.clamp(-SURE, SURE);
    }

    /// As [`Policy::source`].
    pub fn source(&mut self) -> Option<Chunk> {
        self.plays.policy().source()
    }

    /// The observation as a policy for exact poses reads it, with the poses as they are reckoned, and waist and arms without most of their
    /// noise where the hand works. Of both bulbs it works at one alone.
    fn seen(&mut self, observation: &Observation) -> Observation {
        let socket = socket(self.wall > 0.0);
        let mut hand = || self.reckoning.ladder_from(&self.hand, self.posture.angles());
        let (bulb, is_fresh) = match &mut self.plays {
            Plays::Climb(_) => (Bulb { pose: socket, is_seated: true }, false),
            Plays::TakesOut(hands, old) => {
                let [_, touch] = self.bodies.touch(&observation.hand_contact_force);
                (old.step(pulls(&hands.phase()), touch.largest(), &hand(), &socket), false)
            }
            Plays::PutsIn(hands, fresh) => {
                let inserts = hands.phase() == "Insert";
                (fresh.step(observation.step, inserts, &hand(), &socket), true)
            }
        };
        let mut proprioception = observation.proprioception.clone();
        if let (Some(body), Plays::TakesOut(..) | Plays::PutsIn(..)) = (&mut proprioception, &self.plays) {
            let steadied = self.posture.angles().iter().zip(&self.q0).map(|(angle, q0)| (angle - q0) as f32);
            for (position, steadied) in body.joint_position.iter_mut().zip(steadied).take(BODY).skip(LEGS) {
                *position = steadied;
            }
        }
        let privileged = Privileged {
            robot: Some(message(self.reckoning.ladder_from_pelvis())),
            ladder: Some(message(&Isometry3::identity())),
            socket: Some(message(&socket)),
            old_bulb: Some(message(&bulb.pose)),
            fresh_bulb: Some(message(&bulb.pose)),
            crate_: Some(message(&Isometry3::identity())),
            seated: [false, true].map(|fresh| bulb.is_seated && fresh == is_fresh).into(),
            ..Privileged::default()
        };
        Observation {
            episode: observation.episode,
            step: observation.step,
            privileged: Some(privileged),
            proprioception,
            hand_contact_force: observation.hand_contact_force.clone(),
            last_action: observation.last_action.clone(),
            ..Observation::default()
        }
    }
}

/// True if the hand has begun to pull in this phase of taking the bulb out.
fn pulls(phase: &str) -> bool {
    matches!(phase, "Pull" | "Hold" | "Done") || phase.starts_with("Leave")
}

/// The socket over a ladder that stands where the room has it, at a wall or at the ceiling.
fn socket(at_wall: bool) -> Isometry3<f64> {
    let (turn, distance) = if at_wall {
        let axes = Matrix3::from_columns(&[-Vector3::z(), Vector3::x(), -Vector3::y()]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        (turn, fixture::STANDOFF_WALL)
    } else {
        (UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI), fixture::STANDOFF_CEILING)
    };
    Isometry3::from_parts(Vector3::new(0.0, distance, fixture::HEIGHT).into(), turn)
}
