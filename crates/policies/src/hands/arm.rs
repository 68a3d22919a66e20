//! An arm and its hand: brings the hand to poses in the room, and opens and closes the fingers.

use std::ops::Range;
use std::sync::Arc;

use fiatlux_client::PolicyError;
use fiatlux_dynamics::{BodyId, Mechanics, Model, ModelBuilder, ShapeId, Site, State};
use fiatlux_kinematics::{Clearance, InverseKinematics, Work, at_once};
use fiatlux_proto::v3::SessionInfo;
use fiatlux_robot::{BuildOptions, LinkIds, Robot, RobotSite};
use fiatlux_skills::grip::{FINGERS, Finger, Grip};
use fiatlux_skills::path::wrapped;
use fiatlux_skills::towards;
use fiatlux_wbc::{ARMS, BodyCommand, CONTROL_DT, LEGS, MOVED};
use nalgebra::{Isometry3, Quaternion, Unit, UnitQuaternion, Vector3};

use super::apart::{is_below, pairs};
use super::shape::Surroundings;
use super::side::{HAND, Side, hand_of};

/// Share of the difference by which the averages of the waist's and the arm's sensed angles follow in each control step.
const AVERAGE_GAIN: f64 = 0.15;
/// Largest difference between a joint's commanded and sensed angle, rad, with which the arm goes on along a way of postures. Held up
/// for so long, s, it is blocked.
const MAX_AHEAD: f64 = 0.25;
const BLOCKED: f64 = 0.4;
/// Joint of a leg, by its place in it, from which on what hangs on it is where the feet are; hips before it go with the pelvis.
const THIGH: usize = 2;
/// Turn of the hand that counts as long as a metre of its way, m/rad.
pub(super) const TURN_M: f64 = 0.3;

/// Where something that the hand holds, or is to hold, is wanted.
#[derive(Debug, Clone, Copy)]
pub(super) struct ToolGoal {
    pub hand_from_tool: Isometry3<f64>,
    pub world_from_tool: Isometry3<f64>,
    /// Axis of the world through the tool's origin about which its turn does not matter.
    pub free: Option<Unit<Vector3<f64>>>,
}

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

/// An arm of an episode.
#[derive(Clone)]
pub(super) struct Arm {
    pub side: Side,
    /// Its joints in the session's order.
    pub joints: Range<usize>,
    pub model: Arc<Model>,
    /// The robot as the arm is commanded: the pelvis as it is, other joints as sensed, averaged.
    pub state: State,
    pub mechanics: Mechanics,
    pub inverse: InverseKinematics,
    /// Keeps the arm clear of what surrounds it, too.
    pub careful: InverseKinematics,
    pub hand: Site,
    /// There is no room for a left arm that is held out.
    pub left_is_drawn_in: bool,
    root: BodyId,
    soles: Vec<Site>,
    /// `qpos` entry of each of the session's joints that the model has.
    pub qpos: Vec<usize>,
    q0: Vec<f64>,
    pub limits: Vec<[f64; 2]>,
    /// Shapes that are kept apart, in the order of [`Apart`].
    pub pairs: [Vec<(ShapeId, ShapeId)>; 3],
    /// Pairs of trunk, hips, head and other arm with what surrounds the robot.
    pub body_pairs: Vec<(ShapeId, ShapeId)>,
    /// Shapes of the hand and what it holds.
    of_hand: Vec<ShapeId>,
    /// Height of what the robot stands on, and the middle between its feet, m.
    pub floor: f64,
    pub middle: Vector3<f64>,
    /// Sensed angles, averaged, rad.
    sensed: Option<Vec<f64>>,
    /// The arm's angles as they are commanded, rad.
    angles: [f64; ARMS / 2],
    /// Where the arm's joints rest where the hand's pose leaves them free, rad.
    rest: [f64; ARMS / 2],
    /// Where the hand is on its way.
    way: Option<Isometry3<f64>>,
    /// For how long something has held up the arm, s.
    held_up: f64,
    /// Budget of its searches.
    pub work: Work,
}

/// Makes an arm with such surroundings, once. It takes as long as half a control step.
pub(super) type MakesArm = Box<dyn FnOnce(Surroundings) -> Result<Arm, PolicyError> + Send>;

impl Arm {
    /// An arm whose joints rest at these angles, from the shoulder down, where the hand's pose leaves them free, rad, and that can
    /// be kept clear of what surrounds it.
    pub fn new(
        side: Side,
        info: &SessionInfo,
        staged: &[f64],
        rest: [f64; ARMS / 2],
        surroundings: Surroundings,
    ) -> Result<Self, PolicyError> {
        let unfit = |reason: String| PolicyError::Unfit { policy: "hands", reason };
        let names = info.joints.iter().map(|joint| joint.name.as_str());
        let robot = Robot::of_session(&info.robot, names).map_err(|error| unfit(error.to_string()))?;
        let link = hand_of(&robot, side).ok_or_else(|| {
            unfit(format!("the robot has no {HAND} and no grasp of its own; use {}", Robot::NAMES[0]))
        })?;
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).map_err(PolicyError::of("hands"))?;
        let LinkIds { body, body_from_link } = placed.links[link];
        let (group, surrounded) = (placed.next_cull_group, !surroundings.in_world.is_empty());
        let in_world = surroundings.in_world.into_iter().map(|(shape, pose)| shape.on(BodyId::WORLD, &pose, group));
        let in_hand =
            surroundings.in_hand.into_iter().map(|(shape, pose)| shape.on(body, &(body_from_link * pose), group + 1));
        for shape in in_world.chain(in_hand) {
            builder.add_shape(shape).map_err(PolicyError::of("hands"))?;
        }
        let model = builder.build().map_err(PolicyError::of("hands"))?;
        let ids = placed.ids(&model).map_err(PolicyError::of("hands"))?;
        let site = RobotSite { name: HAND.into(), link, link_from_site: Isometry3::identity() };
        let joints = side.joints();
        let bodies: Vec<_> = ids.joints[joints.clone()].iter().map(|ids| ids.body).collect();
        let [all, carrying, apart, body_pairs] = pairs(
            &model,
            [THIGH, LEGS / 2 + THIGH].map(|joint| ids.joints[joint].body),
            ids.joints[joints.start].body,
            ids.joints[joints.end - 1].body,
        );
        let wrist = ids.joints[joints.end - 1].body;
        let shapes = model.shapes().iter().enumerate();
        let of_hand =
            shapes.filter(|(_, shape)| is_below(&model, shape.body, wrist)).map(|(id, _)| ShapeId(id)).collect();
        let mut inverse = InverseKinematics::new(&model, ids.root, &bodies, false).map_err(PolicyError::of("hands"))?;
        inverse.options.limit_margin = 0.03;
        inverse.options.rest_pull = REST_PULL;
        inverse.set_rest(&rest).map_err(PolicyError::of("hands"))?;
        let mut careful = inverse.clone();
        if surrounded {
            let apart = apart.iter().map(|&shapes| Clearance { shapes, margin: GAP });
            careful.set_clearances(&model, &apart.collect::<Vec<_>>()).map_err(PolicyError::of("hands"))?;
        }
        let mut angles = [0.0; ARMS / 2];
        angles.copy_from_slice(&staged[joints.clone()]);
        let soles = robot.soles().iter().map(|sole| ids.site(&sole.site)).collect();
        Ok(Self {
            side,
            joints,
            state: model.reference_state(),
            mechanics: Mechanics::new(&model),
            root: ids.root,
            soles,
            pairs: [all, carrying, apart],
            body_pairs,
            of_hand,
            floor: 0.0,
            middle: Vector3::zeros(),
            inverse,
            careful,
            hand: ids.site(&site),
            left_is_drawn_in: surroundings.left_is_drawn_in,
            qpos: ids.joints.iter().map(|joint| joint.qpos).collect(),
            q0: info.joints.iter().map(|joint| joint.q0).collect(),
            limits: robot.joints().iter().map(|joint| [joint.lower, joint.upper]).collect(),
            sensed: None,
            angles,
            rest,
            way: None,
            held_up: 0.0,
            work: Work::unlimited(),
            model: Arc::new(model),
        })
    }

    /// An arm with its own surroundings that goes on where another one is.
    pub fn going_on_from(self, other: &Self) -> Self {
        let (state, sensed) = (other.state.clone(), other.sensed.clone());
        let Self { floor, middle, angles, way, held_up, .. } = *other;
        Self { state, sensed, floor, middle, angles, way, held_up, ..self }
    }

    /// An arm whose searches are done in slices.
    pub fn searching(self, work: Work) -> Self {
        Self { work, ..self }
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
        self.set_pelvis(pelvis);
        if let Some(sensed) = &self.sensed {
            for (joint, angle) in sensed.iter().enumerate().filter(|(joint, _)| !self.joints.contains(joint)) {
                self.state.qpos[self.qpos[joint]] = *angle;
            }
        }
        self.mechanics.update(&self.model, &self.state);
        let soles = self.soles.iter().map(|sole| self.mechanics.world_from_site(sole).translation.vector);
        self.middle = soles.sum::<Vector3<f64>>() / self.soles.len() as f64;
        self.floor = self.middle.z;
    }

    pub fn set_pelvis(&mut self, pelvis: &Isometry3<f64>) {
        self.state.set_pose(&self.model, self.root, pelvis);
    }

    pub fn pelvis(&self) -> Isometry3<f64> {
        pose_of(&self.state.qpos[..7])
    }

    /// Of the robot in its present state, m.
    pub fn center_of_mass(&mut self) -> Vector3<f64> {
        self.mechanics.update(&self.model, &self.state);
        self.mechanics.center_of_mass(&self.model, self.root).1
    }

    /// Pose of the hand, as commanded.
    pub fn world_from_hand(&mut self) -> Isometry3<f64> {
        let angles = self.angles;
        self.place(&angles)
    }

    /// Pose of the hand, as sensed.
    pub fn sensed_hand(&mut self) -> Isometry3<f64> {
        let angles = self.sensed_angles();
        self.place(&angles)
    }

    /// Height of the hand's lowest point, as sensed, m.
    pub fn lowest(&mut self) -> f64 {
        // Puts the model there.
        self.sensed_hand();
        let heights = self.of_hand.iter().map(|shape| {
            let shape = &self.model.shapes()[shape.0];
            let pose = self.mechanics.world_from_body(shape.body) * shape.body_from_shape;
            pose.translation.z - shape.geometry.reach(&(pose.rotation.inverse() * -Vector3::z()))
        });
        heights.fold(f64::INFINITY, f64::min)
    }

    /// Goes on from the sensed angles: what was commanded last may have had the arm's weight in it.
    pub fn rest_where_it_is(&mut self) {
        (self.angles, self.way) = (self.sensed_angles(), None);
    }

    /// The command by which the robot stands now, as sensed.
    pub fn stands_by(&self, pelvis: &Isometry3<f64>) -> BodyCommand {
        let waist = self.sensed.as_ref().and_then(|sensed| sensed.get(LEGS..MOVED)).unwrap_or(&[0.0; MOVED - LEGS]);
        let turn = |axis: Unit<Vector3<f64>>, joint: usize| UnitQuaternion::from_axis_angle(&axis, waist[joint]);
        let torso =
            pelvis.rotation * turn(Vector3::z_axis(), 0) * turn(Vector3::x_axis(), 1) * turn(Vector3::y_axis(), 2);
        let ((roll, pitch, yaw), (_, _, ahead)) = (torso.euler_angles(), pelvis.rotation.euler_angles());
        let torso = [roll, pitch, wrapped(yaw - ahead)];
        BodyCommand { height: pelvis.translation.z - self.floor, torso, ..BodyCommand::default() }
    }

    /// Closure of each finger, as sensed.
    pub fn closure(&self, grip: &Grip) -> [f64; FINGERS.len()] {
        self.sensed.as_deref().map(|sensed| grip.closure(sensed)).unwrap_or_default()
    }

    /// A finger presses with all that its drive has.
    pub fn is_at_limit(&self, grip: &Grip, targets: &[f64]) -> bool {
        self.sensed.as_deref().is_some_and(|sensed| grip.is_at_limit(sensed, targets))
    }

    fn sensed_angles(&self) -> [f64; ARMS / 2] {
        let mut angles = self.angles;
        if let Some(sensed) = &self.sensed {
            angles.copy_from_slice(&sensed[self.joints.clone()]);
        }
        angles
    }

    /// Distance of the sensed hand from a pose, m, a turn counting as a way.
    pub fn distance_to(&mut self, goal: &Isometry3<f64>) -> f64 {
        let off = self.sensed_hand().inv_mul(goal);
        off.translation.vector.norm().max(TURN_M * off.rotation.angle())
    }

    /// Pose of the hand at some angles.
    pub fn place(&mut self, angles: &[f64; ARMS / 2]) -> Isometry3<f64> {
        self.set(angles);
        self.mechanics.update(&self.model, &self.state);
        self.mechanics.world_from_site(&self.hand)
    }

    pub fn set(&mut self, angles: &[f64; ARMS / 2]) {
        for (joint, angle) in self.joints.clone().zip(angles) {
            self.state.qpos[self.qpos[joint]] = *angle;
        }
    }

    /// The posture in which the hand has a pose, found from the posture of rest.
    pub async fn posture(&mut self, goal: &Isometry3<f64>) -> Result<Posture, PolicyError> {
        let rest = self.rest;
        let (angles, error) = self.solve(goal, &rest, TRIES).await?;
        let room = |(angle, [lower, upper]): (&f64, &[f64; 2])| (angle - lower).min(upper - angle);
        let margin = angles.iter().zip(&self.limits[self.joints.clone()]).map(room).fold(f64::INFINITY, f64::min);
        Ok(Posture { angles, error, margin: margin.min(STRAIGHT - angles[ELBOW]) })
    }

    async fn solve(
        &mut self,
        goal: &Isometry3<f64>,
        from: &[f64; ARMS / 2],
        tries: usize,
    ) -> Result<([f64; ARMS / 2], f64), PolicyError> {
        let whole = ToolGoal { hand_from_tool: Isometry3::identity(), world_from_tool: *goal, free: None };
        self.find(false, &whole, from, tries).await
    }

    /// Turns the joints towards angles at a rate, rad/s; the largest turn that is left, rad.
    pub fn turn_to(&mut self, angles: &[f64; ARMS / 2], rate: f64) -> f64 {
        self.way = None;
        self.follow(angles, rate)
    }

    /// Turns all joints towards angles so that they arrive together, the fastest at a rate, rad/s; true where they are there. On
    /// request it waits while something holds up the arm.
    pub fn go_to(&mut self, angles: &[f64; ARMS / 2], rate: f64, waits: bool) -> bool {
        self.way = None;
        let sensed = self.sensed_angles();
        let ahead = self.angles.iter().zip(&sensed).map(|(now, sensed)| (now - sensed).abs()).fold(0.0, f64::max);
        if waits && ahead > MAX_AHEAD {
            self.held_up += CONTROL_DT;
            return false;
        }
        self.held_up = 0.0;
        let left = self.angles.iter().zip(angles).map(|(now, wanted)| (wanted - now).abs()).fold(0.0, f64::max);
        let share = (rate * CONTROL_DT / left.max(1e-9)).min(1.0);
        self.angles.iter_mut().zip(angles).for_each(|(now, wanted)| *now += share * (wanted - *now));
        share >= 1.0
    }

    /// True once on its way something has held up the arm. It then stays where it is felt to be.
    pub fn gives_way(&mut self) -> bool {
        let is_blocked = self.held_up > BLOCKED;
        if is_blocked {
            (self.angles, self.way, self.held_up) = (self.sensed_angles(), None, 0.0);
        }
        is_blocked
    }

    fn follow(&mut self, angles: &[f64; ARMS / 2], rate: f64) -> f64 {
        let mut left = 0.0_f64;
        for (now, wanted) in self.angles.iter_mut().zip(angles) {
            *now = towards(*now, *wanted, rate);
            left = left.max((wanted - *now).abs());
        }
        left
    }

    /// Moves the hand on a straight line towards a pose, m/s; the way that is left, m, turns included. On request the arm keeps clear of
    /// what surrounds it.
    pub fn move_to(&mut self, is_careful: bool, goal: &Isometry3<f64>, speed: f64) -> Result<f64, PolicyError> {
        let from = match self.way {
            Some(way) => way,
            None => self.world_from_hand(),
        };
        let (next, left) = next_on_way(&from, goal, speed);
        self.way = Some(next);
        let from = self.angles;
        let whole = ToolGoal { hand_from_tool: Isometry3::identity(), world_from_tool: next, free: None };
        let (angles, _) = at_once(self.find(is_careful, &whole, &from, 1))?;
        self.follow(&angles, MAX_TURN_RATE);
        Ok(left)
    }

    /// The posture in which the hand would have a pose if pelvis and waist were elsewhere, near another posture or, without one, from
    /// the posture of rest; and how far the hand stays from there, m.
    pub async fn posture_of(
        &mut self,
        torso: &Torso,
        goal: &Isometry3<f64>,
        near: Option<[f64; ARMS / 2]>,
    ) -> Result<([f64; ARMS / 2], f64), PolicyError> {
        self.set_pelvis(&torso.world_from_pelvis);
        for (joint, angle) in (LEGS..MOVED).zip(torso.waist) {
            self.state.qpos[self.qpos[joint]] = angle;
        }
        let rest = self.rest;
        self.solve(goal, &near.unwrap_or(rest), if near.is_some() { 1 } else { TRIES }).await
    }

    /// Angles as they are commanded, rad.
    pub fn angles(&self) -> [f64; ARMS / 2] {
        self.angles
    }

    /// Angles of all joints in the standing posture, rad.
    pub fn q0(&self) -> &[f64] {
        &self.q0
    }

    /// Angles of the arm in the standing posture, rad.
    pub fn standing(&self) -> [f64; ARMS / 2] {
        let mut angles = [0.0; ARMS / 2];
        angles.copy_from_slice(&self.q0[self.joints.clone()]);
        angles
    }

    /// Sets where the joints go to where the hand's pose leaves them free, rad.
    pub fn rest_at(&mut self, angles: &[f64; ARMS / 2]) -> Result<(), PolicyError> {
        self.careful.set_rest(angles).map_err(PolicyError::of("hands"))?;
        self.inverse.set_rest(angles).map_err(PolicyError::of("hands"))
    }

    /// Moves what the hand holds, commanded, by a change of poses in the world, its turn about `free` left to the joints. It is not
    /// commanded farther from where it is felt than `lead`, m. On request the arm keeps clear of what surrounds it.
    pub fn nudge(
        &mut self,
        is_careful: bool,
        change: &Isometry3<f64>,
        hand_from_tool: Isometry3<f64>,
        free: Option<Unit<Vector3<f64>>>,
        lead: f64,
    ) -> Result<(), PolicyError> {
        let way = match self.way {
            Some(way) => way,
            None => self.world_from_hand(),
        };
        let sensed = (self.sensed_hand() * hand_from_tool).translation.vector;
        let mut wanted = change * way * hand_from_tool;
        let ahead = wanted.translation.vector - sensed;
        if ahead.norm() > lead {
            wanted.translation.vector = sensed + ahead * (lead / ahead.norm());
        }
        let from = self.angles;
        let goal = ToolGoal { hand_from_tool, world_from_tool: wanted, free };
        let (angles, _) = at_once(self.find(is_careful, &goal, &from, 1))?;
        // Where its turn was left free, it has another one.
        wanted.rotation = (self.place(&angles) * hand_from_tool).rotation;
        self.way = Some(wanted * hand_from_tool.inverse());
        self.follow(&angles, MAX_TURN_RATE);
        Ok(())
    }

    /// Writes the arm's angles into the targets of the session.
    pub fn write(&self, targets: &mut [f64]) {
        targets[self.joints.clone()].copy_from_slice(&self.angles);
    }

    /// Writes targets of the hand's joints.
    pub fn write_fingers(&self, grip: &Grip, fingers: &[Finger; FINGERS.len()], targets: &mut [f64]) {
        grip.write(fingers, self.sensed.as_deref(), targets);
    }
}

/// A pose from seven entries of `qpos`.
fn pose_of(qpos: &[f64]) -> Isometry3<f64> {
    let &[x, y, z, w, i, j, k] = qpos else { return Isometry3::identity() };
    let turned = UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Vector3::new(x, y, z).into(), turned)
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
/// Smallest gap between the arm and what surrounds it, m.
const GAP: f64 = 0.005;
/// Postures from which a search starts at most.
const TRIES: usize = 12;
/// Index of the elbow in the arm, and its angle where the arm is straight, rad.
pub(super) const ELBOW: usize = 3;
pub(super) const STRAIGHT: f64 = 1.57;
/// Strength with which joints are pulled to their rest angles.
const REST_PULL: f64 = 0.1;
