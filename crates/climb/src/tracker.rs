//! Observation and action of a policy that follows a plan, once a control step.

use std::sync::Arc;

use fiatlux_dynamics::{Mechanics, Site, State};
use fiatlux_robot::{BODY, MOVED};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::body::Body;
use crate::reference::{Pose, Reference};

/// Parts by which angles and speeds of the joints go to what is sensed in each control step: sensed speeds are noisy.
const SHARES: (f64, f64) = (0.2, 0.1);
/// Control step, s.
const DT: f64 = fiatlux_rules::CONTROL_DT;
/// Radians of joint target for an action of 1: of a leg's hip pitch, roll and yaw, knee, ankle pitch and roll, and of the waist.
const LEG_SCALES: [f64; 6] = [0.2, 0.2, 0.2, 0.15, 0.4, 0.4];
const WAIST_SCALE: f64 = 0.15;
/// Actions beyond it count as it.
pub const ACTION_CLAMP: f64 = 3.0;
/// Times ahead at which a policy sees the plan, s of the plan.
const AHEAD: [f64; 2] = [0.3, 1.0];
/// The unit in which a policy sees the plan's time, s, and waves of it, by their number in that.
const PHASE: f64 = 60.5;
const WAVES: [f64; 4] = [1.0, 2.0, 4.0, 8.0];

/// The parts of an observation: name, count.
pub const OBSERVATION: [(&str, usize); 17] = [
    ("reference", MOVED),
    ("reference_ahead", 2 * MOVED),
    ("lead", MOVED),
    ("bears", 2 * (1 + AHEAD.len())),
    ("rate", 1),
    ("phase", 1 + 2 * WAVES.len()),
    ("pelvis_error", 6),
    ("pelvis_velocity", 6),
    ("gravity", 3),
    ("com_error", 3),
    ("com_velocity", 3),
    ("sole_error", 12),
    ("joint_error", MOVED),
    ("joint_velocity", MOVED),
    ("sensed_joint_error", MOVED),
    ("last_action", MOVED),
    ("earlier_action", MOVED),
];

/// Numbers of an observation.
pub const OBSERVED: usize = {
    let (mut sum, mut index) = (0, 0);
    while index < OBSERVATION.len() {
        sum += OBSERVATION[index].1;
        index += 1;
    }
    sum
};

/// Follows a plan: averages what is sensed, compares it with the plan, and turns a policy's action into joint targets. Poses are in
/// the plan's frame.
#[derive(Debug, Clone)]
pub struct Tracker {
    body: Arc<Body>,
    reference: Arc<Reference>,
    mechanics: Mechanics,
    soles: [Site; 2],
    /// As averaged.
    state: State,
    pelvis: Option<Isometry3<f64>>,
    sensed: [f64; MOVED],
    velocity: [Vector3<f64>; 2],
    /// Of the plan, s.
    time: f64,
    /// Seconds of the plan in a second; less than 0 goes backwards.
    rate: f64,
    due: Pose,
    actions: [[f64; MOVED]; 2],
}

/// State of a tracker in its episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrackerMemory {
    time: f64,
    rate: f64,
    /// Place, then rotation, w first.
    pelvis: Option<[f64; 7]>,
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    sensed: [f64; MOVED],
    velocity: [[f64; 3]; 2],
    actions: [[f64; MOVED]; 2],
}

impl Tracker {
    /// At the start of a plan. The body is that of the reference.
    pub fn new(body: Arc<Body>, reference: Arc<Reference>) -> Self {
        let due = reference.at(0.0);
        let soles = [0, 1].map(|side| body.ids.site(&body.robot.soles()[side].site));
        Self {
            mechanics: Mechanics::new(&body.model),
            state: body.model.reference_state(),
            body,
            reference,
            soles,
            pelvis: None,
            sensed: [0.0; MOVED],
            velocity: [Vector3::zeros(); 2],
            time: 0.0,
            rate: 1.0,
            due,
            actions: [[0.0; MOVED]; 2],
        }
    }

    /// Forgets what it saw, and goes on from a time of the plan, s.
    pub fn restart(&mut self, time: f64, rate: f64) {
        (self.time, self.rate, self.pelvis) = (time, rate, None);
        self.velocity = [Vector3::zeros(); 2];
        self.due = self.reference.at(time);
        self.actions = [[0.0; MOVED]; 2];
    }

    /// Its state, for [`Tracker::restore`].
    pub fn memory(&self) -> TrackerMemory {
        TrackerMemory {
            time: self.time,
            rate: self.rate,
            pelvis: self.pelvis.map(|pelvis| {
                let (at, q) = (pelvis.translation, pelvis.rotation);
                [at.x, at.y, at.z, q.w, q.i, q.j, q.k]
            }),
            qpos: self.state.qpos.clone(),
            qvel: self.state.qvel.clone(),
            sensed: self.sensed,
            velocity: self.velocity.map(Into::into),
            actions: self.actions,
        }
    }

    /// Goes on from the state of a tracker of the same plan; `None`, and nothing changes, if it is of another robot.
    #[must_use]
    pub fn restore(&mut self, memory: TrackerMemory) -> Option<()> {
        let TrackerMemory { time, rate, pelvis, qpos, qvel, sensed, velocity, actions } = memory;
        let fits = qpos.len() == self.state.qpos.len() && qvel.len() == self.state.qvel.len() && time.is_finite();
        if !fits {
            return None;
        }
        (self.state.qpos, self.state.qvel) = (qpos, qvel);
        (self.time, self.rate, self.due) = (time, rate, self.reference.at(time));
        self.pelvis = pelvis.map(|[x, y, z, w, i, j, k]| {
            let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
            Isometry3::from_parts(Vector3::new(x, y, z).into(), rotation)
        });
        (self.sensed, self.actions, self.velocity) = (sensed, actions, velocity.map(Vector3::from));
        self.mechanics.update(&self.body.model, &self.state);
        Some(())
    }

    /// The plan.
    pub fn reference(&self) -> &Reference {
        &self.reference
    }

    /// Time of the plan, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Seconds of the plan in a second; 0 holds the pose, less than 0 goes backwards.
    pub fn set_rate(&mut self, rate: f64) {
        self.rate = rate;
    }

    /// The pose that is due.
    pub fn due(&self) -> &Pose {
        &self.due
    }

    /// The last two actions, the newest first.
    pub fn actions(&self) -> &[[f64; MOVED]; 2] {
        &self.actions
    }

    /// Takes the pose of the pelvis, and angles (rad) and speeds (rad/s) of all joints as they are sensed.
    pub fn see(&mut self, pelvis: &Isometry3<f64>, angles: &[f64], speeds: &[f64]) {
        let Self { body, state, .. } = self;
        let (ids, model) = (&body.ids, &body.model);
        let last = self.pelvis.replace(*pelvis);
        let is_first = last.is_none();
        let last = last.unwrap_or(*pelvis);
        state.set_pose(model, ids.root, pelvis);
        let velocity = (pelvis.translation.vector - last.translation.vector) / DT;
        let turn = (pelvis.rotation * last.rotation.inverse()).scaled_axis() / DT;
        self.velocity = [velocity, turn];
        state.qvel[ids.root_dof..][..3].copy_from_slice(velocity.as_slice());
        state.qvel[ids.root_dof + 3..][..3].copy_from_slice(turn.as_slice());
        for ((joint, angle), speed) in ids.joints.iter().zip(angles).zip(speeds).take(BODY) {
            let (q, v) = (&mut state.qpos[joint.qpos], &mut state.qvel[joint.dof]);
            if is_first {
                (*q, *v) = (*angle, 0.0);
            } else {
                *v += SHARES.1 * (speed - *v);
                *q += *v * DT;
                *q += SHARES.0 * (angle - *q);
            }
        }
        self.sensed.iter_mut().zip(angles).for_each(|(place, angle)| *place = *angle);
        self.mechanics.update(model, state);
    }

    /// Writes the observation, of [`OBSERVED`] numbers.
    pub fn observe(&mut self, observation: &mut [f32]) {
        let (due, ids) = (&self.due, &self.body.ids);
        let way = if self.rate < 0.0 { -1.0 } else { 1.0 };
        let [soon, later] = AHEAD.map(|ahead| self.reference.at(self.time + way * ahead));
        let part = self.time / PHASE;
        let pelvis = self.pelvis.unwrap_or(due.pelvis);
        let com = self.mechanics.center_of_mass(&self.body.model, ids.root).1;
        let com_velocity = self.mechanics.com_velocity(&self.body.model, ids.root);
        let soles = self.soles.map(|site| self.mechanics.world_from_site(&site));
        let gravity = pelvis.rotation.inverse_transform_vector(&-Vector3::z());
        let mut places = observation.iter_mut();
        let mut put = |number: f64| {
            if let Some(place) = places.next() {
                *place = number as f32;
            }
        };
        due.angles.iter().take(MOVED).for_each(|angle| put(*angle));
        for ahead in [&soon, &later] {
            ahead.angles.iter().zip(&due.angles).take(MOVED).for_each(|(ahead, now)| put(5.0 * (ahead - now)));
        }
        due.lead.iter().take(MOVED).for_each(|lead| put(5.0 * lead));
        for pose in [due, &soon, &later] {
            pose.bears.iter().for_each(|bears| put(*bears));
        }
        put(self.rate);
        put(part);
        for wave in WAVES {
            let angle = std::f64::consts::TAU * wave * part;
            put(libm::sin(angle));
            put(libm::cos(angle));
        }
        pose_error(&pelvis, &due.pelvis).iter().for_each(|number| put(*number));
        self.velocity.iter().flat_map(|vector| vector.iter()).for_each(|number| put(2.0 * number));
        gravity.iter().for_each(|number| put(*number));
        (com - due.com).iter().for_each(|number| put(20.0 * number));
        com_velocity.iter().for_each(|number| put(5.0 * number));
        for (sole, due) in soles.iter().zip(&due.soles) {
            pose_error(sole, due).iter().for_each(|number| put(*number));
        }
        let joints = || ids.joints.iter().zip(&due.angles).take(MOVED);
        joints().for_each(|(joint, due)| put(5.0 * (self.state.qpos[joint.qpos] - due)));
        joints().for_each(|(joint, _)| put(0.5 * self.state.qvel[joint.dof]));
        self.sensed.iter().zip(&due.angles).for_each(|(sensed, due)| put(5.0 * (sensed - due)));
        self.actions.iter().flatten().for_each(|number| put(*number));
    }

    /// Centre of mass, as averaged, off the one that is due, m.
    pub fn com_error(&mut self) -> Vector3<f64> {
        self.mechanics.center_of_mass(&self.body.model, self.body.ids.root).1 - self.due.com
    }

    /// Takes an action of [`MOVED`] numbers, and writes the targets of legs, waist and arms, rad; the plan goes on. They may lie beyond
    /// the joints' limits.
    pub fn act(&mut self, action: &[f64], targets: &mut [f64]) {
        self.actions.rotate_right(1);
        for (place, number) in self.actions[0].iter_mut().zip(action) {
            *place = number.clamp(-ACTION_CLAMP, ACTION_CLAMP);
        }
        for (joint, target) in targets.iter_mut().enumerate().take(BODY) {
            *target = self.due.angles[joint] + self.due.lead[joint];
            if joint < MOVED {
                *target += scale(joint) * self.actions[0][joint];
            }
        }
        self.time = (self.time + self.rate * DT).clamp(0.0, self.reference.seconds());
        self.due = self.reference.at(self.time);
    }
}

/// Radians of joint target for an action of 1.
fn scale(joint: usize) -> f64 {
    if joint < 12 { LEG_SCALES[joint % 6] } else { WAIST_SCALE }
}

/// In 5 cm and 0.2 rad.
fn pose_error(pose: &Isometry3<f64>, due: &Isometry3<f64>) -> [f64; 6] {
    let (way, turn) =
        (20.0 * (pose.translation.vector - due.translation.vector), 5.0 * turn(&pose.rotation, &due.rotation));
    [way.x, way.y, way.z, turn.x, turn.y, turn.z]
}

/// Turn from one rotation to another one, rad.
fn turn(to: &UnitQuaternion<f64>, from: &UnitQuaternion<f64>) -> Vector3<f64> {
    (to * from.inverse()).scaled_axis()
}
