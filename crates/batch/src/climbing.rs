//! Following the plan of the ladder: a task outside the rulebook.
//!
//! The policy corrects the plan's targets at legs and waist; the arms follow the plan. Episodes begin anywhere on the plan, and
//! end where pelvis or feet leave it.

mod rewards;
mod state;

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_climb::{Body, OBSERVATION, OBSERVED, Reference, Tracker};
use fiatlux_robot::{ARMS, BODY, GainSet, MOVED, Robot};
use fiatlux_rules::{CONTROL_DT, Limb, Row, errand};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_world::{ACTION_LIMIT, ACTION_SCALE, Light, Random, Scene, World};
use nalgebra::{Isometry3, Vector3};

use self::rewards::{TERMS, View};
use crate::task::check_weights;
use crate::{Control, Field, Outcome, Spec, Task, TaskError};

/// Half-widths of the start's noise: joints, rad; place of the robot, m; velocity of the pelvis, m/s.
const START_NOISE: (f64, f64, f64) = (0.015, 0.015, 0.08);
/// Half-widths of the robot's place, m, and heading, rad, where both feet are on the floor or on the platform: there a robot stands
/// otherwise than the plan says.
const LEVEL_NOISE: (f64, f64) = (0.025, 0.06);
/// Heights of a sole that is on the floor or on the platform, m.
const LEVEL: [f64; 2] = [0.01, 1.17];
/// The episode ends where the pelvis is so far from the plan, m and rad.
const PELVIS_ENDS: (f64, f64) = (0.18, 0.6);
/// The same for a foot that bears and for one in the air, m, and for both, rad.
const FOOT_ENDS: (f64, f64, f64) = (0.07, 0.15, 0.8);
/// Way of the ladder that ends the episode, m.
const LADDER_ENDS: f64 = 0.05;
/// Robot of the reference.
const ROBOT: &str = "g1_bare";

/// Terms for a critic alone, without noise: name, count.
const PRIVILEGED: [(&str, usize); 6] = [
    ("joint_error", MOVED),
    ("joint_velocity", MOVED),
    ("sole_error", 12),
    ("foot_force", 6),
    ("ladder_velocity", 6),
    ("touch", 1),
];

/// Settings of following the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct ClimbingOptions {
    /// The benchmark's noise in the observation.
    pub noise: bool,
    /// Control steps until time-out.
    pub horizon_steps: u64,
    /// End of the part of the plan that is followed, s.
    pub until: f64,
    /// Ranges of the plan's times at which episodes begin, s, each as likely as the others; beyond the plan's end counts as its end.
    pub starts: Vec<[f64; 2]>,
    /// Range of the plan's seconds in a second.
    pub rates: [f64; 2],
    /// Part of the episodes that go backwards.
    pub backwards: f64,
    /// Part of the episodes that hold the pose at which they begin.
    pub holds: f64,
    /// Postures of the arms in place of the plan's, and part of the episodes that have one of them.
    pub arms: Vec<[f64; ARMS]>,
    /// See `arms`.
    pub carries: f64,
    /// Weights of the reward's terms, a second, where they are not the usual ones.
    pub reward_weights: BTreeMap<String, f64>,
}

impl Default for ClimbingOptions {
    fn default() -> Self {
        Self {
            noise: true,
            horizon_steps: 500,
            until: 1e3,
            starts: vec![[0.0, 1e3]],
            rates: [0.8, 2.2],
            backwards: 0.5,
            holds: 0.2,
            arms: Vec::new(),
            carries: 0.0,
            reward_weights: BTreeMap::new(),
        }
    }
}

impl ClimbingOptions {
    /// The usual weight of each term of the reward, a second.
    pub fn usual_reward_weights() -> impl Iterator<Item = (&'static str, f64)> {
        TERMS.iter().map(|(name, weight, _)| (*name, *weight))
    }

    fn check(&self) -> Result<(), TaskError> {
        let starts = self.starts.iter().map(|range| ("starts", *range));
        for (name, [low, high]) in starts.chain([("rates", self.rates)]) {
            if !(0.0 <= low && low <= high && high <= 1e3) {
                return Err(format!("{name} is {low} to {high}; give a range from 0 to 1000, least first").into());
            }
        }
        for (name, part) in [("holds", self.holds), ("backwards", self.backwards), ("carries", self.carries)] {
            if !(0.0..=1.0).contains(&part) {
                return Err(format!("{name} is {part}; give 0 to 1").into());
            }
        }
        if self.starts.is_empty() {
            return Err("starts has no range; give one".into());
        }
        if !self.arms.iter().flatten().all(|angle| angle.is_finite()) || (self.arms.is_empty() && self.carries > 0.0) {
            return Err("arms needs postures with finite angles; give one, or carries as 0".into());
        }
        if !(1.0..=1e3).contains(&self.until) {
            return Err(format!("until is {}; give 1 to 1000 s", self.until).into());
        }
        check_weights(&self.reward_weights, TERMS.iter().map(|(name, ..)| *name))
    }
}

/// Following the plan of the ladder. Fields of the observation whose names begin with `privileged.` are for a critic.
#[derive(Debug, Clone)]
pub struct Climbing {
    options: Arc<ClimbingOptions>,
    spec: Arc<Spec>,
    /// Link and site of each sole.
    soles: [(usize, Isometry3<f64>); 2],
    observer: Observer,
    noise: Option<NoiseSeed>,
    sensed: Proprioception,
    angles: Vec<f64>,
    tracker: Tracker,
    start: (f64, f64),
    /// Posture of the arms in place of the plan's, rad.
    arms: Option<[f64; ARMS]>,
    ladder: Isometry3<f64>,
    world_from_plan: Isometry3<f64>,
    weights: [f64; TERMS.len()],
}

impl Climbing {
    /// With the robot of a scene that has a ladder.
    ///
    /// # Errors
    /// A scene without ladder, a robot whose joints do not begin as the G1's do, or options out of range.
    pub fn new(scene: &Arc<Scene>, options: ClimbingOptions) -> Result<Self, TaskError> {
        options.check()?;
        if scene.body(errand::LADDER).is_none() {
            return Err("climbing needs a scene with a ladder that can move".into());
        }
        let robot = Robot::by_name(ROBOT)?;
        let names = scene.robot.joints().iter().map(|joint| &joint.name);
        if !robot.joints().iter().map(|joint| &joint.name).zip(names).all(|(a, b)| a == b) {
            return Err("climbing needs a robot whose joints begin with those of the G1".into());
        }
        let gains = robot.gains(GainSet::default());
        let body = Body::new(robot, gains).ok_or("climbing needs drives that fit the G1")?;
        let reference = Reference::new(&body, &fiatlux_climb::ladder()?, options.until)?;
        let soles = scene.robot.soles();
        let [left, right] = soles.as_slice() else { return Err("climbing needs a robot with two soles".into()) };
        let weights = TERMS.map(|(name, weight, _)| options.reward_weights.get(name).copied().unwrap_or(weight));
        let own = OBSERVATION.iter().map(|(name, count)| Field::new(*name, &[*count]));
        let privileged = PRIVILEGED.iter().map(|(name, count)| Field::new(format!("privileged.{name}"), &[*count]));
        let spec = Spec {
            actions: scene.robot.joints()[..MOVED].iter().map(|joint| joint.name.clone()).collect(),
            horizon_steps: options.horizon_steps,
            action_limit: ACTION_LIMIT,
            action_range: vec![[-1.0, 1.0]; MOVED],
            observation: own.chain(privileged).collect(),
            rewards: TERMS.iter().map(|(name, ..)| (*name).to_owned()).collect(),
            reward_weights: weights.to_vec(),
        };
        let joints = scene.robot.joints().len();
        Ok(Self {
            spec: Arc::new(spec),
            soles: [left, right].map(|sole| (sole.site.link, sole.site.link_from_site)),
            observer: Observer::new(scene.robot.q0().to_vec(), None),
            noise: None,
            sensed: Proprioception::zeros(joints),
            angles: vec![0.0; joints],
            tracker: Tracker::new(Arc::new(body), Arc::new(reference)),
            start: (0.0, 1.0),
            arms: None,
            ladder: Isometry3::identity(),
            world_from_plan: Isometry3::identity(),
            weights,
            options: Arc::new(options),
        })
    }

    /// The pose of each sole in the plan's frame.
    fn soles(&self, world: &World) -> [Isometry3<f64>; 2] {
        let plan_from_world = self.world_from_plan.inverse();
        self.soles.map(|(link, site)| plan_from_world * world.world_from_link(link) * site)
    }

    fn see(&mut self, world: &World) {
        let row = world.row();
        self.observer.observe(row, &mut self.sensed);
        let angles = self.angles.iter_mut().zip(&self.sensed.joint_position).zip(world.scene().robot.q0());
        angles.for_each(|((angle, sensed), q0)| *angle = sensed + q0);
        let pelvis = self.world_from_plan.inverse() * row.robot.pose;
        self.tracker.see(&pelvis, &self.angles, &self.sensed.joint_velocity);
    }

    fn is_lost(&self, view: &View<'_>) -> bool {
        let due = self.tracker.due();
        let away = |pose: &Isometry3<f64>, due: &Isometry3<f64>| {
            let way = (pose.translation.vector - due.translation.vector).norm();
            (way, pose.rotation.angle_to(&due.rotation))
        };
        let (way, turn) = away(&view.pelvis, &due.pelvis);
        let feet = (0..2).any(|side| {
            let (way, turn) = away(&view.soles[side], &due.soles[side]);
            let most = if due.bears[side] > 0.0 { FOOT_ENDS.0 } else { FOOT_ENDS.1 };
            way > most || turn > FOOT_ENDS.2
        });
        let ladder = away(&view.row.things[errand::LADDER].pose, &self.ladder).0;
        way > PELVIS_ENDS.0 || turn > PELVIS_ENDS.1 || feet || ladder > LADDER_ENDS
    }
}

/// From the frame of the plan, whose x leads from the steps into the ladder.
fn world_from_plan(ladder: &Isometry3<f64>) -> Isometry3<f64> {
    ladder * Isometry3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2)
}

impl Task for Climbing {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn place(&mut self, scene: &Scene, row: &mut Row, random: &mut Random) -> Result<(), TaskError> {
        let end = self.tracker.reference().seconds();
        let starts = &self.options.starts;
        let [first, last] = starts[random.index(starts.len())].map(|time| time.min(end));
        let time = random.uniform(first, last);
        let way = if random.unit() < self.options.backwards { -1.0 } else { 1.0 };
        let rate = way * random.uniform(self.options.rates[0], self.options.rates[1]);
        self.arms = None;
        if random.unit() < self.options.carries {
            self.arms = Some(self.options.arms[random.index(self.options.arms.len())]);
        }
        let holds = random.unit() < self.options.holds;
        self.start = (time, if holds { 0.0 } else { rate });
        let mut due = self.tracker.reference().at(time);
        if let Some(arms) = self.arms {
            due.angles[MOVED..].copy_from_slice(&arms);
            due.lead[MOVED..].fill(0.0);
        }
        self.ladder = row.things[errand::LADDER].pose;
        let (joint, place, velocity) = START_NOISE;
        let is_level = (0..2).all(|side| {
            let height = due.soles[side].translation.z;
            due.bears[side] > 0.5 && !(LEVEL[0]..LEVEL[1]).contains(&height)
        });
        let (place, heading) = if is_level { LEVEL_NOISE } else { (place, 0.0) };
        let [x, y, turn] = [place, place, heading].map(|most| random.uniform(-most, most));
        let turned = Isometry3::new(due.pelvis.translation.vector, Vector3::z() * turn);
        let away = Isometry3::translation(x, y, 0.0) * turned * due.pelvis.translation.inverse();
        row.robot.pose = world_from_plan(&self.ladder) * away * due.pelvis;
        for (index, limits) in scene.robot.joints().iter().enumerate() {
            let (q, lead) = due.angles.get(index).zip(due.lead.get(index)).map_or((0.0, 0.0), |(q, lead)| (*q, *lead));
            let noise = if index < due.angles.len() { random.uniform(-joint, joint) } else { 0.0 };
            row.joint_position[index] = (q + noise).clamp(limits.lower, limits.upper);
            row.joint_target[index] = (q + lead).clamp(limits.lower, limits.upper);
            row.joint_velocity[index] = 0.0;
        }
        row.robot.linear_velocity = Vector3::from_fn(|_, _| random.uniform(-velocity, velocity));
        row.robot.angular_velocity = Vector3::from_fn(|_, _| random.uniform(-velocity, velocity));
        Ok(())
    }

    fn begin(&mut self, world: &World, _: &Light, random: &mut Random) -> Result<(), TaskError> {
        let seed = (random.unit() * (1_u64 << 53) as f64) as u64;
        self.noise = self.options.noise.then_some(NoiseSeed { seed, episode: 0 });
        self.observer.restart(self.noise);
        self.world_from_plan = world_from_plan(&self.ladder);
        let (time, rate) = self.start;
        self.tracker.restart(time, rate);
        self.see(world);
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _: &Row, action: &[f64], _: &mut Random, control: &mut Control) {
        control.joint_target.copy_from_slice(scene.robot.q0());
        self.tracker.act(action, &mut control.joint_target);
        if let Some(arms) = &self.arms {
            control.joint_target[MOVED..BODY].copy_from_slice(arms);
        }
        let targets = control.joint_target.iter_mut().zip(scene.robot.joints());
        targets.for_each(|(target, joint)| *target = target.clamp(joint.lower, joint.upper));
        let record = control.action.iter_mut().zip(&control.joint_target).zip(scene.robot.q0());
        record.for_each(|((action, target), q0)| *action = (target - q0) / ACTION_SCALE);
    }

    fn judge(&mut self, world: &World, _: &mut Random, reward_terms: &mut [f32]) -> Outcome {
        let row = world.row();
        let pelvis = self.world_from_plan.inverse() * row.robot.pose;
        self.see(world);
        let (soles, touch) = (self.soles(world), rewards::touch(world));
        let com_error = self.tracker.com_error() - rewards::support_error(self.tracker.due(), &soles);
        let mut view = View { climbing: self, row, pelvis, soles, com_error, touch, is_lost: false };
        view.is_lost = self.is_lost(&view);
        for ((place, weight), (.., value)) in reward_terms.iter_mut().zip(&self.weights).zip(TERMS) {
            *place = (weight * value(&view) * CONTROL_DT) as f32;
        }
        match view.is_lost {
            true => Outcome::Failure,
            false if row.step >= self.options.horizon_steps => Outcome::TimeOut,
            false => Outcome::Continues,
        }
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        let row = world.row();
        let plan_from_world = self.world_from_plan.inverse();
        let (own, privileged) = observation.split_at_mut(OBSERVED);
        self.tracker.observe(own);
        let due = self.tracker.due();
        let joints = row.joint_position.iter().zip(&due.angles).take(MOVED).map(|(q, due)| 5.0 * (q - due));
        let soles = self.soles(world);
        let errors = soles.iter().zip(&due.soles).flat_map(|(sole, due)| {
            let way = 20.0 * (sole.translation.vector - due.translation.vector);
            let turn = 5.0 * (sole.rotation * due.rotation.inverse()).scaled_axis();
            [way.x, way.y, way.z, turn.x, turn.y, turn.z]
        });
        let forces = [Limb::LeftFoot, Limb::RightFoot].into_iter().flat_map(|foot| {
            let force = row.force(errand::FLOOR_FORCE)[foot as usize] + row.force(errand::LADDER_FORCE)[foot as usize];
            let force = plan_from_world.rotation * force * 0.005;
            [force.x, force.y, force.z]
        });
        let ladder = &row.things[errand::LADDER];
        let numbers = joints
            .chain(row.joint_velocity.iter().take(MOVED).map(|speed| 0.5 * speed))
            .chain(errors)
            .chain(forces)
            .chain(ladder.linear_velocity.iter().chain(ladder.angular_velocity.iter()).map(|speed| 5.0 * speed))
            // Before the first step the contacts are those of another world.
            .chain([if row.step > 0 { 0.02 * rewards::touch(world) } else { 0.0 }]);
        privileged.iter_mut().zip(numbers).for_each(|(place, number)| *place = number as f32);
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "climbing".to_owned()), ("options", format!("{:?}", self.options))]
    }

    fn save(&self) -> Result<Vec<u8>, TaskError> {
        self.state()
    }

    fn load(&mut self, saved: &[u8], _: &Row, _: &Light) -> Result<(), TaskError> {
        self.set_state(saved)
    }
}
