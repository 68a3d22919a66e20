//! The right arm and its hand: brings the hand to poses in the room, and opens and closes the fingers.

use std::collections::BTreeMap;

use fiatlux_client::PolicyError;
use fiatlux_dynamics::{Mechanics, Model, ModelBuilder, Site, State};
use fiatlux_kinematics::{Goal, InverseKinematics};
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::{BuildOptions, Robot, RobotSite};
use fiatlux_wbc::{ARMS, BODY, CONTROL_DT, LEGS, MOVED};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// The hand's frame: its x axis comes out of the back of the hand, the fingers point along -y, the thumb is on the side of -z.
const HAND: &str = "right_hand_base_link";
/// Joints of the right arm in the session's order.
const ARM: std::ops::Range<usize> = MOVED + ARMS / 2..BODY;
/// Share of the difference by which the averages of the waist's and the arm's sensed angles follow in each control step.
const AVERAGE_GAIN: f64 = 0.15;
/// Turn of the hand that counts as long as a metre of its way, m/rad.
const TURN_M: f64 = 0.3;

/// Fingers of a hand, as the names of its bodies and joints have them.
pub(super) const FINGERS: [&str; 5] = ["thumb", "index", "middle", "ring", "pinky"];

/// Angles or targets of joints by name, rad.
pub(super) type Angles = BTreeMap<String, f64>;

/// A posture of the arm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Posture {
    /// Angles from the shoulder down, rad.
    pub angles: [f64; ARMS / 2],
    /// Distance of the hand from its goal, m; a turn counts as a distance.
    pub error: f64,
    /// Least room of a joint to its limits, and of the elbow until the arm is straight, rad.
    pub margin: f64,
}

/// Where the torso is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Torso {
    pub world_from_pelvis: Isometry3<f64>,
    /// Yaw, roll and pitch of the waist, rad.
    pub waist: [f64; 3],
}

/// The right arm of an episode.
pub(super) struct RightArm {
    model: Model,
    /// The robot as the arm is commanded: base and waist as sensed, averaged.
    state: State,
    mechanics: Mechanics,
    inverse: InverseKinematics,
    hand: Site,
    /// `qpos` entry of each of the session's joints that the model has.
    qpos: Vec<usize>,
    q0: Vec<f64>,
    limits: Vec<[f64; 2]>,
    /// Sensed angles, averaged, rad.
    sensed: Option<Vec<f64>>,
    /// The arm's angles as they are commanded, rad.
    angles: [f64; ARMS / 2],
    /// Where the arm's joints rest where the hand's pose leaves them free, rad.
    rest: [f64; ARMS / 2],
    /// Where the hand is on its way.
    way: Option<Isometry3<f64>>,
    names: Vec<String>,
    /// Of the drives, N m/rad.
    stiffness: Vec<f64>,
}

impl RightArm {
    /// An arm whose joints rest at these angles, from the shoulder down, where the hand's pose leaves them free, rad.
    pub fn new(info: &SessionInfo, staged: &[f64], rest: [f64; ARMS / 2]) -> Result<Self, PolicyError> {
        let unfit = |reason: String| PolicyError::Unfit { policy: "hands", reason };
        let names: Vec<String> = info.joints.iter().map(|joint| joint.name.clone()).collect();
        let robot = Robot::with_joints(names.iter().map(String::as_str)).map_err(|error| unfit(error.to_string()))?;
        let link = robot.link_index(HAND).ok_or_else(|| unfit(format!("the robot has no {HAND}; use g1_inspire")))?;
        let failed = PolicyError::of("hands");
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).map_err(&failed)?;
        let model = builder.build().map_err(PolicyError::of("hands"))?;
        let ids = placed.ids(&model).map_err(PolicyError::of("hands"))?;
        let site = RobotSite { name: HAND.into(), link, link_from_site: Isometry3::identity() };
        let bodies: Vec<_> = ids.joints[ARM].iter().map(|ids| ids.body).collect();
        let mut inverse = InverseKinematics::new(&model, ids.root, &bodies, false).map_err(PolicyError::of("hands"))?;
        inverse.options.limit_margin = 0.03;
        inverse.options.rest_pull = REST_PULL;
        inverse.set_rest(&rest).map_err(PolicyError::of("hands"))?;
        let mut angles = [0.0; ARMS / 2];
        angles.copy_from_slice(&staged[ARM]);
        Ok(Self {
            state: model.reference_state(),
            mechanics: Mechanics::new(&model),
            inverse,
            hand: ids.site(&site),
            qpos: ids.joints.iter().map(|joint| joint.qpos).collect(),
            q0: info.joints.iter().map(|joint| joint.q0).collect(),
            limits: robot.joints().iter().map(|joint| [joint.lower, joint.upper]).collect(),
            sensed: None,
            angles,
            rest,
            way: None,
            names,
            stiffness: info.joints.iter().map(|joint| joint.stiffness.max(1e-3)).collect(),
            model,
        })
    }

    /// Takes the pose of the pelvis and the joints' angles relative to the standing posture, rad.
    pub fn sense(&mut self, pelvis: &Isometry3<f64>, joint_position: &[f32]) {
        let now = || joint_position.iter().zip(&self.q0).map(|(turned, q0)| f64::from(*turned) + q0);
        match &mut self.sensed {
            None => self.sensed = Some(now().collect()),
            Some(average) => {
                average.iter_mut().zip(now()).for_each(|(average, now)| *average += AVERAGE_GAIN * (now - *average));
            }
        }
        self.place_base(pelvis);
        if let Some(sensed) = &self.sensed {
            for joint in LEGS..MOVED {
                self.state.qpos[self.qpos[joint]] = sensed[joint];
            }
        }
    }

    fn place_base(&mut self, pelvis: &Isometry3<f64>) {
        let base = &mut self.state.qpos[..7];
        base[..3].copy_from_slice(pelvis.translation.vector.as_slice());
        let turned = pelvis.rotation;
        base[3..].copy_from_slice(&[turned.w, turned.i, turned.j, turned.k]);
    }

    /// Pose of the hand, as commanded.
    pub fn world_from_hand(&mut self) -> Isometry3<f64> {
        let angles = self.angles;
        self.place(&angles)
    }

    /// Pose of the hand, as sensed.
    pub fn sensed_hand(&mut self) -> Isometry3<f64> {
        let mut angles = self.angles;
        if let Some(sensed) = &self.sensed {
            angles.copy_from_slice(&sensed[ARM]);
        }
        self.place(&angles)
    }

    /// Distance of the sensed hand from a pose, m, a turn counting as a way.
    pub fn distance_to(&mut self, goal: &Isometry3<f64>) -> f64 {
        let off = self.sensed_hand().inv_mul(goal);
        off.translation.vector.norm().max(TURN_M * off.rotation.angle())
    }

    fn place(&mut self, angles: &[f64; ARMS / 2]) -> Isometry3<f64> {
        self.set(angles);
        self.mechanics.update(&self.model, &self.state);
        self.mechanics.world_from_site(&self.hand)
    }

    fn set(&mut self, angles: &[f64; ARMS / 2]) {
        for (joint, angle) in ARM.zip(angles) {
            self.state.qpos[self.qpos[joint]] = *angle;
        }
    }

    /// The posture in which the hand has a pose, found from the posture of rest.
    pub fn posture(&mut self, goal: &Isometry3<f64>) -> Result<Posture, PolicyError> {
        let rest = self.rest;
        let (angles, error) = self.solve(goal, &rest, TRIES)?;
        let room = |(angle, [lower, upper]): (&f64, &[f64; 2])| (angle - lower).min(upper - angle);
        let margin = angles.iter().zip(&self.limits[ARM]).map(room).fold(f64::INFINITY, f64::min);
        Ok(Posture { angles, error, margin: margin.min(STRAIGHT - angles[ELBOW]) })
    }

    fn solve(
        &mut self,
        goal: &Isometry3<f64>,
        from: &[f64; ARMS / 2],
        tries: usize,
    ) -> Result<([f64; ARMS / 2], f64), PolicyError> {
        self.set(from);
        self.inverse.options.tries = tries;
        let goals = [Goal::pose(self.hand, *goal)];
        let found = self.inverse.solve(&self.model, &mut self.state, &goals).map_err(PolicyError::of("hands"))?;
        let mut solved = *from;
        for (joint, angle) in ARM.zip(&mut solved) {
            *angle = self.state.qpos[self.qpos[joint]];
        }
        Ok((solved, found.position_error.max(TURN_M * found.rotation_error)))
    }

    /// Turns the joints towards angles at a rate, rad/s; the largest turn that is left, rad.
    pub fn turn_to(&mut self, angles: &[f64; ARMS / 2], rate: f64) -> f64 {
        self.way = None;
        self.follow(angles, rate)
    }

    fn follow(&mut self, angles: &[f64; ARMS / 2], rate: f64) -> f64 {
        let mut left = 0.0_f64;
        for (now, wanted) in self.angles.iter_mut().zip(angles) {
            *now += (wanted - *now).clamp(-rate * CONTROL_DT, rate * CONTROL_DT);
            left = left.max((wanted - *now).abs());
        }
        left
    }

    /// Moves the hand on a straight line towards a pose, m/s; the way that is left, m, turns included.
    pub fn move_to(&mut self, goal: &Isometry3<f64>, speed: f64) -> Result<f64, PolicyError> {
        let from = match self.way {
            Some(way) => way,
            None => self.world_from_hand(),
        };
        let (next, left) = next_on_way(&from, goal, speed);
        self.way = Some(next);
        let from = self.angles;
        let (angles, _) = self.solve(&next, &from, 1)?;
        self.follow(&angles, MAX_TURN_RATE);
        Ok(left)
    }

    /// The posture in which the hand would have a pose if pelvis and waist were elsewhere, near another posture or, without one, from
    /// the posture of rest; and how far the hand stays from there, m.
    pub fn posture_of(
        &mut self,
        torso: &Torso,
        goal: &Isometry3<f64>,
        near: Option<[f64; ARMS / 2]>,
    ) -> Result<([f64; ARMS / 2], f64), PolicyError> {
        self.place_base(&torso.world_from_pelvis);
        for (joint, angle) in (LEGS..MOVED).zip(torso.waist) {
            self.state.qpos[self.qpos[joint]] = angle;
        }
        let rest = self.rest;
        self.solve(goal, &near.unwrap_or(rest), if near.is_some() { 1 } else { TRIES })
    }

    /// Writes the arm's angles into the targets of the session.
    pub fn write(&self, targets: &mut [f64]) {
        targets[ARM].copy_from_slice(&self.angles);
    }

    /// Writes targets of the hand's joints: for each finger of [`FINGERS`] its share of the way from open to closed. Fingers with
    /// a torque, N m, do not press harder than that.
    pub fn write_fingers(
        &self,
        open: &Angles,
        closed: &Angles,
        fingers: &[Finger; FINGERS.len()],
        targets: &mut [f64],
    ) {
        for (joint, name) in self.names.iter().enumerate().skip(BODY) {
            let Some(closed) = closed.get(name) else { continue };
            let Some(finger) = FINGERS.iter().position(|finger| name.contains(finger)) else { continue };
            let open = open.get(name).copied().unwrap_or_default();
            let [lower, upper] = self.limits[joint];
            let mut target = (open + fingers[finger].share * (closed - open)).clamp(lower, upper);
            if let (Some(torque), Some(sensed)) = (fingers[finger].torque, &self.sensed) {
                let bend = torque / self.stiffness[joint];
                let most = sensed[joint] + bend;
                target = if *closed > open { target.min(most) } else { target.max(sensed[joint] - bend) };
            }
            targets[joint] = target;
        }
    }
}

/// Closure of a finger.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Finger {
    /// From 0, open, to 1, closed.
    pub share: f64,
    /// Most that its joints press with, N m; `None`: what their drives can.
    pub torque: Option<f64>,
}

/// The pose on a straight way after a control step, m/s, and the way that is left then, m, turns included.
fn next_on_way(from: &Isometry3<f64>, goal: &Isometry3<f64>, speed: f64) -> (Isometry3<f64>, f64) {
    let off = goal.translation.vector - from.translation.vector;
    let turn = (goal.rotation * from.rotation.inverse()).scaled_axis();
    let left = off.norm().max(TURN_M * turn.norm());
    let share = (speed * CONTROL_DT / left.max(1e-9)).min(1.0);
    let next = Isometry3::from_parts(
        (from.translation.vector + share * off).into(),
        UnitQuaternion::from_scaled_axis(share * turn) * from.rotation,
    );
    (next, (1.0 - share) * left)
}

/// Fastest turn of a joint on a straight way of the hand, rad/s.
const MAX_TURN_RATE: f64 = 1.0;
/// Postures from which a search starts at most.
const TRIES: usize = 12;
/// Index of the elbow in the arm, and its angle where the arm is straight, rad.
const ELBOW: usize = 3;
const STRAIGHT: f64 = 1.57;
/// Strength with which joints are pulled to their rest angles.
const REST_PULL: f64 = 0.1;

/// Turn about the vertical of a pose's x axis, rad.
pub(super) fn heading(pose: &Isometry3<f64>) -> f64 {
    let ahead = pose.rotation * Vector3::x();
    libm::atan2(ahead.y, ahead.x)
}
