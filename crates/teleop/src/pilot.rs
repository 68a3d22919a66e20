//! Turns what an operator asks for into commands of the robot. It reads no clock: a frame is either fresh or missing.
//!
//! A hand follows its device only while the operator holds the clutch, and begins where the hand is: whatever happens to the
//! device in between, nothing jumps. Without a frame the robot stands upright, its
//! hands stay where they are on it, and its fingers close or open as far as they were told.

use fiatlux_client::PolicyError;
use fiatlux_kinematics::SearchOptions;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::Robot;
use fiatlux_session::Command;
use fiatlux_skills::{HandGoal, Reach, ReachOptions};
use fiatlux_wbc::{ARMS, BODY, BodyCommand, CONTROL_DT, MOVED, NOMINAL_HEIGHT, Sensed};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::NAME;
use crate::frame::{Fingers, Frame, Motion};
use crate::grip::Grips;

/// Largest velocities: forwards and to the left, m/s, about the vertical, rad/s; and how fast they grow, per s.
const WALK: [f64; 3] = [0.5, 0.3, 0.7];
const GAIN: [f64; 3] = [0.6, 0.6, 1.2];
/// Speed at which the pelvis rises, m/s, and rate at which the torso turns, rad/s.
const RISE: f64 = 0.1;
const TORSO: f64 = 0.3;
/// Speed of a hand by keys and sticks, m/s and rad/s, and the lead that its goal may have, m.
const HAND: [f64; 2] = [0.2, 0.8];
const AHEAD_M: f64 = 0.08;
/// Where the joints of the right arm rest, from the shoulder down, rad, and how strongly they are pulled there: those of the policy
/// `hands`. They keep the elbows out where a pose leaves that free, so that the next pose can be reached, too.
const REST: [f64; ARMS / 2] = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5];
const REST_PULL: f64 = 0.1;
/// Room to the limits of a joint, rad.
const LIMIT_MARGIN: f64 = 0.03;
/// Most that a joint is commanded ahead of what is sensed, rad: a hand that is blocked presses with what this bends its drives by.
const LEAD: f64 = 0.25;
/// A device that moves farther between two control steps has lost its tracking, m.
const MAX_JUMP_M: f64 = 0.2;
/// Share of the way to a device's pose that its filtered pose goes in a control step.
const FOLLOWS: f64 = 0.5;

/// The state of what the operator drives, for the page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Driven {
    /// No fresh input: the robot stands.
    pub is_frozen: bool,
    /// Hands that follow their device, left first.
    pub follows: [bool; 2],
    /// The hand that keys move, and hands that were told to close.
    pub chosen: Option<usize>,
    pub closes: [bool; 2],
    /// Where the hands are wanted, from the pelvis; `None` where they were never moved.
    pub goals: [Option<Isometry3<f64>>; 2],
    pub command: BodyCommand,
}

/// A hand that follows its device.
#[derive(Debug, Clone, Copy)]
struct Held {
    space: u64,
    /// Poses at the start: of the device, and of the hand.
    device: Isometry3<f64>,
    palm: Isometry3<f64>,
    /// The device's pose in the last step, and its average.
    last: Isometry3<f64>,
    filtered: Isometry3<f64>,
}

/// Drives the robot of a session.
pub struct Pilot {
    robot: Robot,
    /// `None` until the operator moves a hand, so that the staged posture stays what it is.
    arms: Option<Reach>,
    grips: Grips,
    /// Least and greatest of each number of a command.
    range: [[f64; 2]; 7],
    /// Targets of all joints, rad.
    targets: Vec<f64>,
    held: [Option<Held>; 2],
    /// Of the last frame: fingers go on to where they were wanted while input is late.
    fingers: [Option<Fingers>; 2],
    driven: Driven,
}

impl Pilot {
    /// Takes over the staged posture.
    ///
    /// # Errors
    /// The session has another robot or lacks a sensor.
    pub fn new(info: &SessionInfo, first: &Observation) -> Result<Self, PolicyError> {
        let unfit = |reason: String| PolicyError::Unfit { policy: NAME, reason };
        let (ranges, []) = info.whole_body_range.as_chunks::<2>() else {
            return Err(unfit("its ranges of commands are not pairs; use a server of this version".into()));
        };
        let range = <[[f64; 2]; 7]>::try_from(ranges).map_err(|_| {
            unfit("the server has no whole-body controller for this robot and its gains; leave both out".into())
        })?;
        if first.last_action.len() != info.joints.len() {
            return Err(PolicyError::Sensor { policy: NAME, sensor: "last_action" });
        }
        let names = info.joints.iter().map(|joint| joint.name.as_str());
        let robot = Robot::of_session(&info.robot, names).map_err(PolicyError::of(NAME))?;
        let staged = info.joints.iter().zip(&first.last_action);
        Ok(Self {
            robot,
            arms: None,
            grips: Grips::new(info).map_err(PolicyError::of(NAME))?,
            range,
            targets: staged.map(|(joint, action)| joint.q0 + info.action_scale * f64::from(*action)).collect(),
            held: [None; 2],
            fingers: [None; 2],
            driven: Driven::default(),
        })
    }

    /// Driven state after the last step.
    pub fn driven(&self) -> &Driven {
        &self.driven
    }

    /// The command of a control step. `frame` is `None` where no input is fresh.
    ///
    /// # Errors
    /// The observation lacks a sensor, or the arms' kinematics fail.
    pub fn step(&mut self, frame: Option<&Frame>, observation: &Observation) -> Result<Command, PolicyError> {
        let body = observation.proprioception.as_ref();
        let body = body.ok_or(PolicyError::Sensor { policy: NAME, sensor: "proprioception" })?;
        self.driven.is_frozen = frame.is_none();
        let idle = Frame::default();
        self.walk(frame);
        if let Some(frame) = frame {
            self.fingers = [0, 1].map(|side: usize| frame.hands[side].fingers);
            self.driven.chosen = frame.chosen;
            self.driven.closes =
                self.fingers.map(|fingers| matches!(fingers, Some(Fingers::Close(share)) if share > 0.5));
        }
        let frame = frame.unwrap_or(&idle);
        let moves = |hand: &crate::frame::Hand| hand.motion != Motion::Still || hand.fingers.is_some();
        let turned: Vec<f64> = body.joint_position.iter().map(|turned| f64::from(*turned)).collect();
        if turned.len() != self.targets.len() || !turned.iter().all(|angle| angle.is_finite()) {
            return Err(PolicyError::Sensor { policy: NAME, sensor: "proprioception" });
        }
        let sensed = Sensed::upright(&turned, &[]);
        let mut arms = match self.arms.take() {
            None if frame.hands.iter().any(moves) => Some(arms(&self.robot)?),
            arms => arms,
        };
        if let Some(arms) = &mut arms {
            let failed = PolicyError::of(NAME);
            let wanted = arms.wanted_palms(&sensed).map_err(&failed)?;
            let palms = arms.palms(&sensed).map_err(&failed)?;
            for side in 0..2 {
                self.hand(side, frame, &wanted[side], &palms[side]);
            }
            let goals = self
                .driven
                .goals
                .map(|goal| goal.map(|pelvis_from_palm| HandGoal { pelvis_from_palm, firmness: None }));
            self.targets[MOVED..BODY].copy_from_slice(&arms.angles(&sensed, &goals).map_err(&failed)?);
            self.grips.step(self.fingers, &body.joint_position, &observation.hand_contact_force, &mut self.targets);
        }
        self.arms = arms;
        let named = if self.arms.is_some() { self.targets.clone() } else { Vec::new() };
        Ok(Command::WholeBody(self.driven.command, named))
    }

    /// Moves the command to legs and waist. It stops at once, and starts gently. Without a frame the robot stands upright.
    fn walk(&mut self, frame: Option<&Frame>) {
        let command = &mut self.driven.command;
        let Some(frame) = frame else {
            // Upright: it would not stand for long at the ends of its range.
            let towards = |from: f64, to: f64, rate: f64| from + (to - from).clamp(-rate, rate);
            command.velocity = [0.0; 3];
            command.height = towards(command.height, NOMINAL_HEIGHT, RISE * CONTROL_DT);
            command.torso = command.torso.map(|angle| towards(angle, 0.0, TORSO * CONTROL_DT));
            return;
        };
        for axis in 0..3 {
            let wanted = WALK[axis] * frame.walk[axis].clamp(-1.0, 1.0);
            let step = GAIN[axis] * CONTROL_DT;
            let velocity = &mut command.velocity[axis];
            *velocity = if wanted == 0.0 { 0.0 } else { *velocity + (wanted - *velocity).clamp(-step, step) };
        }
        command.height += RISE * CONTROL_DT * frame.rise.clamp(-1.0, 1.0);
        command.torso[1] += TORSO * CONTROL_DT * frame.torso[0].clamp(-1.0, 1.0);
        command.torso[2] += TORSO * CONTROL_DT * frame.torso[1].clamp(-1.0, 1.0);
        let mut numbers = command.numbers();
        numbers.iter_mut().zip(&self.range).for_each(|(number, [low, high])| *number = number.clamp(*low, *high));
        *command = numbers.into();
    }

    /// Moves the goal of a hand, which is at `palm` and commanded to `wanted`.
    fn hand(&mut self, side: usize, frame: &Frame, wanted: &Isometry3<f64>, palm: &Isometry3<f64>) {
        let goal = &mut self.driven.goals[side];
        let held = self.held[side].take();
        match frame.hands[side].motion {
            Motion::Still => {}
            Motion::Rate { linear, angular } => {
                let from = goal.unwrap_or(*wanted);
                let step = Vector3::from(linear.map(|share| share.clamp(-1.0, 1.0))) * (HAND[0] * CONTROL_DT);
                let turn = Vector3::from(angular.map(|share| share.clamp(-1.0, 1.0))) * (HAND[1] * CONTROL_DT);
                let ahead = from.translation.vector + step - palm.translation.vector;
                let most = (from.translation.vector - palm.translation.vector).norm().max(AHEAD_M);
                let ahead = ahead * (most / ahead.norm().max(1e-9)).min(1.0);
                *goal = Some(Isometry3::from_parts(
                    (palm.translation.vector + ahead).into(),
                    UnitQuaternion::from_scaled_axis(turn) * from.rotation,
                ));
            }
            Motion::Follow(device) => {
                // A device that jumped, or whose space moved, starts anew from where it is.
                let goes_on = held.filter(|held| {
                    let way = device.translation.vector - held.last.translation.vector;
                    held.space == frame.space && way.norm() < MAX_JUMP_M
                });
                let start = Held { space: frame.space, device, palm: *wanted, last: device, filtered: device };
                let mut held = goes_on.unwrap_or(start);
                held.last = device;
                // Turns of 180 degrees have no shortest way between them.
                let turn = held.filtered.rotation.try_slerp(&device.rotation, FOLLOWS, 1e-6);
                held.filtered = Isometry3::from_parts(
                    held.filtered.translation.vector.lerp(&device.translation.vector, FOLLOWS).into(),
                    turn.unwrap_or(device.rotation),
                );
                let way = held.filtered.translation.vector - held.device.translation.vector;
                let turn = held.filtered.rotation * held.device.rotation.inverse();
                *goal =
                    Some(Isometry3::from_parts((held.palm.translation.vector + way).into(), turn * held.palm.rotation));
                self.held[side] = Some(held);
            }
        }
        self.driven.follows[side] = self.held[side].is_some();
    }
}

/// Arms that take over where they are.
fn arms(robot: &Robot) -> Result<Reach, PolicyError> {
    let search =
        SearchOptions { tries: 1, limit_margin: LIMIT_MARGIN, rest_pull: REST_PULL, ..SearchOptions::default() };
    Reach::of(robot, ReachOptions { search, rest: Some(REST), lead: LEAD }).map_err(PolicyError::of(NAME))
}
