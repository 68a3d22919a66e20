//! Walking by velocity command: a task outside the rulebook, and the example of one.
//!
//! Legs and waist are the policy's; the arms are driven from outside, to be walked with whatever they do. Observation,
//! rewards and ranges are those with which a policy learned to stand in 5 million steps and to walk in 8 million.

mod arms;
mod draw;
mod hands;
mod knees;
mod rewards;
mod state;

use std::collections::BTreeMap;
use std::sync::Arc;

use fiatlux_rules::{CONTROL_DT, Row, Support, errand};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wbc::{ACTION_CLAMP, ARMS, BodyCommand, Clock, FRAME, History, LEGS, MOVED, Setpoint, scale};
use fiatlux_world::{ACTION_LIMIT, ACTION_SCALE, Light, Random, Scene, World};
use nalgebra::{UnitQuaternion, Vector3};

use self::arms::Arms;
use self::draw::draw_command;
use self::hands::Hands;
use self::knees::Knees;
use self::rewards::{TERMS, View};
use crate::task::check_weights;
use crate::{Control, Field, Outcome, Spec, Task, TaskError};

/// Below this height of the pelvis, m, or beyond this tilt, rad, the robot has fallen.
const FALL: (f64, f64) = (0.40, std::f64::consts::FRAC_PI_3);
/// Half-widths of the start's noise: joints and tilt, rad; velocity, m/s and rad/s.
const START_NOISE: (f64, f64, f64) = (0.08, 0.06, 0.3);
/// Time constant of the slow velocity, by which tracking is also judged, s: the instantaneous one sways with each step.
const SLOW_S: f64 = 0.3;
/// Most frames in an observation, 20 s.
const MAX_FRAMES: usize = 1_000;
/// Distance of the robot from the room's middle, where there is a room, m: inside, 20 s at 1 m/s would end at a wall.
const OUTSIDE_M: f64 = 50.0;

/// Terms that only a critic should see, without noise: name, count.
const PRIVILEGED: [(&str, usize); 11] = [
    ("velocity", 6),
    ("slow_velocity", 3),
    ("foot_position", 6),
    ("foot_velocity", 6),
    ("foot_load", 2),
    ("upright", 3),
    ("height", 1),
    ("torso", 3),
    ("joint_position", MOVED + ARMS),
    ("joint_velocity", MOVED + ARMS),
    ("hand_force", 6),
];

/// Options of walking.
#[derive(Debug, Clone, PartialEq)]
pub struct WalkingOptions {
    /// Frames in an observation, the newest last.
    pub frames: usize,
    /// The benchmark's noise in the observation.
    pub noise: bool,
    /// Control steps until time-out.
    pub horizon_steps: u64,
    /// Ranges of the commanded velocities: forwards and left, m/s, and about the vertical, rad/s.
    pub command: [[f64; 2]; 3],
    /// Range of the pelvis's commanded height while walking, m.
    pub height: [f64; 2],
    /// Range of the pelvis's commanded height while standing, m.
    pub stand_height: [f64; 2],
    /// Ranges of the torso's commanded roll, pitch and yaw, rad.
    pub torso: [[f64; 2]; 3],
    /// The arms go through this part of their joints' ranges.
    pub arm_range: f64,
    /// Largest load in a hand, kg.
    pub load_kg: f64,
    /// Largest force that pulls at a hand along each of the world's axes, N.
    pub hand_force_n: f64,
    /// Weights of the reward's terms, a second, where they are not [the usual ones](WalkingOptions::usual_reward_weights).
    pub reward_weights: BTreeMap<String, f64>,
}

impl Default for WalkingOptions {
    fn default() -> Self {
        Self {
            frames: 4,
            noise: true,
            horizon_steps: 1_000,
            command: [[-0.5, 1.0], [-0.4, 0.4], [-1.0, 1.0]],
            height: [0.65, 0.79],
            stand_height: [0.55, 0.79],
            torso: [[-0.3, 0.3], [-0.1, 0.6], [-0.5, 0.5]],
            arm_range: 1.0,
            load_kg: 1.0,
            hand_force_n: 20.0,
            reward_weights: BTreeMap::new(),
        }
    }
}

impl WalkingOptions {
    /// The usual weight of each term of the reward, a second.
    pub fn usual_reward_weights() -> impl Iterator<Item = (&'static str, f64)> {
        TERMS.iter().map(|(name, weight, _)| (*name, *weight))
    }

    /// Name and value of each.
    fn listed(&self) -> [(&'static str, String); 11] {
        [
            ("frames", self.frames.to_string()),
            ("noise", self.noise.to_string()),
            ("horizon_steps", self.horizon_steps.to_string()),
            ("command", format!("{:?}", self.command)),
            ("height", format!("{:?}", self.height)),
            ("stand_height", format!("{:?}", self.stand_height)),
            ("torso", format!("{:?}", self.torso)),
            ("arm_range", self.arm_range.to_string()),
            ("load_kg", self.load_kg.to_string()),
            ("hand_force_n", self.hand_force_n.to_string()),
            ("reward_weights", format!("{:?}", self.reward_weights)),
        ]
    }

    fn check(&self) -> Result<(), TaskError> {
        if !(1..=MAX_FRAMES).contains(&self.frames) {
            return Err(format!("frames is {}; give 1 to {MAX_FRAMES}", self.frames).into());
        }
        if !(0.0..=1.0).contains(&self.arm_range) {
            return Err(format!("arm_range is {}; give 0 to 1", self.arm_range).into());
        }
        let ranges = [self.height, self.stand_height].into_iter().chain(self.command).chain(self.torso);
        if !ranges.into_iter().all(|[low, high]| low <= high && low.is_finite() && high.is_finite()) {
            return Err("walking takes ranges of commands as [least, most], finite".into());
        }
        let sizes = [self.load_kg, self.hand_force_n];
        if !sizes.iter().all(|size| (0.0..1e3).contains(size)) {
            return Err("walking takes a load and a force at the hands from 0 to below 1000".into());
        }
        check_weights(&self.reward_weights, TERMS.iter().map(|(name, ..)| *name))
    }
}

/// Walking by velocity command. Its observation has the fields of a frame, each with a leading axis of frames, then those for
/// a critic, whose names begin with `privileged.`.
#[derive(Debug, Clone)]
pub struct Walking {
    options: Arc<WalkingOptions>,
    spec: Arc<Spec>,
    feet: [usize; 2],
    palms: [usize; 2],
    torso: usize,
    /// Height of a foot's link above the floor when its sole is flat on it, m.
    sole_m: f64,
    observer: Observer,
    noise: Option<NoiseSeed>,
    sensed: Proprioception,
    history: History,
    command: BodyCommand,
    command_left: u32,
    setpoint: Setpoint,
    clock: Clock,
    arms: Arms,
    hands: Hands,
    knees: Knees,
    weights: [f64; TERMS.len()],
    /// The last three actions, the newest first.
    actions: [[f64; MOVED]; 3],
    slow_velocity: Vector3<f64>,
    foot_position: [Vector3<f64>; 2],
    foot_velocity: [Vector3<f64>; 2],
    joint_velocity: Vec<f64>,
}

impl Walking {
    /// Walking with the robot of a scene.
    ///
    /// # Errors
    /// A robot that is not built as a G1: its legs, waist and arms come first in the joint order.
    pub fn new(scene: &Arc<Scene>, options: WalkingOptions) -> Result<Self, TaskError> {
        let robot = &scene.robot;
        let ([left, right], [left_palm, right_palm]) = (robot.feet(), robot.palms()) else {
            return Err("walking needs a robot with two feet and two palms".into());
        };
        let names: Vec<_> = robot.joints().iter().map(|joint| joint.name.clone()).collect();
        let in_place = |index: usize, part: &str| names.get(index).is_some_and(|name| name.contains(part));
        if !(in_place(0, "left_hip") && in_place(LEGS, "waist") && in_place(MOVED + ARMS - 1, "right_wrist")) {
            return Err("walking needs a robot whose joints begin with legs, waist and arms, as the G1's do".into());
        }
        let torso = robot.link_index("torso_link").ok_or("walking needs a robot with a link 'torso_link'")?;
        options.check()?;
        let world = World::new(Arc::clone(scene));
        let knees = Knees::of(&world).ok_or("walking needs a robot with the G1's hip, knee and ankle links")?;
        let pelvis = world.row().robot.pose.translation.z;
        let sole_m = world.world_from_link(*left).translation.z - (pelvis - robot.standing_height());
        let weights = TERMS.map(|(name, weight, _)| options.reward_weights.get(name).copied().unwrap_or(weight));
        let frames = options.frames;
        let stacked = FRAME.iter().map(|(name, count)| Field::new(*name, &[frames, *count]));
        let privileged = PRIVILEGED.iter().map(|(name, count)| Field::new(format!("privileged.{name}"), &[*count]));
        let spec = Spec {
            actions: names[..MOVED].to_vec(),
            horizon_steps: options.horizon_steps,
            action_limit: ACTION_LIMIT,
            action_range: vec![[-ACTION_CLAMP as f32, ACTION_CLAMP as f32]; MOVED],
            observation: stacked.chain(privileged).collect(),
            rewards: TERMS.iter().map(|(name, ..)| (*name).to_owned()).collect(),
            reward_weights: weights.to_vec(),
        };
        Ok(Self {
            spec: Arc::new(spec),
            feet: [*left, *right],
            palms: [*left_palm, *right_palm],
            torso,
            sole_m,
            observer: Observer::new(robot.q0().to_vec(), None),
            noise: None,
            sensed: Proprioception::zeros(names.len()),
            history: History::new(frames),
            command: BodyCommand::default(),
            command_left: 0,
            setpoint: Setpoint::default(),
            clock: Clock::default(),
            arms: Arms::default(),
            hands: Hands::default(),
            knees,
            weights,
            actions: [[0.0; MOVED]; 3],
            slow_velocity: Vector3::zeros(),
            foot_position: [Vector3::zeros(); 2],
            foot_velocity: [Vector3::zeros(); 2],
            joint_velocity: vec![0.0; names.len()],
            options: Arc::new(options),
        })
    }

    fn read_feet(&mut self, world: &World) {
        for (foot, link) in self.feet.into_iter().enumerate() {
            let mut position = world.world_from_link(link).translation.vector;
            position.z -= self.sole_m;
            self.foot_velocity[foot] = (position - self.foot_position[foot]) / CONTROL_DT;
            self.foot_position[foot] = position;
        }
    }

    fn remember(&mut self, row: &Row) {
        self.observer.observe(row, &mut self.sensed);
        let (command, clock) = (self.setpoint.now(), self.clock.signal());
        self.history.push(&self.sensed.view(), command, clock, &self.actions[0], row.step == 0);
    }
}

impl Task for Walking {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn place(&mut self, scene: &Scene, row: &mut Row, random: &mut Random) -> Result<(), TaskError> {
        let (joint, tilt, velocity) = START_NOISE;
        for (q, limits) in row.joint_position.iter_mut().zip(scene.robot.joints()).take(MOVED) {
            *q = (*q + random.uniform(-joint, joint)).clamp(limits.lower, limits.upper);
        }
        let [roll, pitch] = [(); 2].map(|()| random.uniform(-tilt, tilt));
        let yaw = random.uniform(-std::f64::consts::PI, std::f64::consts::PI);
        let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        row.robot.pose.rotation = rotation;
        if scene.spec.parts.room {
            row.robot.pose.translation.x = OUTSIDE_M;
        }
        row.robot.pose.translation.z = scene.robot.height_on_soles(&row.joint_position, &rotation)?;
        row.robot.linear_velocity.x = random.uniform(-velocity, velocity);
        row.robot.linear_velocity.y = random.uniform(-velocity, velocity);
        row.robot.angular_velocity.z = random.uniform(-velocity, velocity);
        Ok(())
    }

    fn begin(&mut self, world: &World, _: &Light, random: &mut Random) -> Result<(), TaskError> {
        let seed = (random.unit() * (1_u64 << 53) as f64) as u64;
        self.noise = self.options.noise.then_some(NoiseSeed { seed, episode: 0 });
        self.observer.restart(self.noise);
        self.history.clear();
        (self.command, self.command_left) = draw_command(&self.options, random);
        // The robot starts upright, at the height that is reached from there.
        let height = world.row().robot.pose.translation.z;
        self.setpoint = Setpoint::at(BodyCommand { height, torso: [0.0; 3], ..self.command });
        self.clock = Clock::at(random.unit());
        let (row, robot) = (world.row(), &world.scene().robot);
        self.arms.begin(robot, &row.joint_position[MOVED..MOVED + ARMS], self.options.arm_range, random);
        self.hands.begin(self.options.load_kg, random);
        self.actions = [[0.0; MOVED]; 3];
        self.slow_velocity = rewards::velocity(row);
        self.read_feet(world);
        self.foot_velocity = [Vector3::zeros(); 2];
        self.joint_velocity.copy_from_slice(&row.joint_velocity);
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _row: &Row, action: &[f64], random: &mut Random, control: &mut Control) {
        self.clock.advance(self.setpoint.now().walks());
        self.actions.rotate_right(1);
        for (place, number) in self.actions[0].iter_mut().zip(action) {
            *place = number.clamp(-ACTION_CLAMP, ACTION_CLAMP);
        }
        let q0 = scene.robot.q0();
        control.joint_target.copy_from_slice(q0);
        for (joint, action) in self.actions[0].iter().enumerate() {
            control.joint_target[joint] += scale(joint) * action;
        }
        self.arms.advance(&scene.robot, self.options.arm_range, random, &mut control.joint_target[MOVED..MOVED + ARMS]);
        self.hands.advance(self.options.hand_force_n, random);
        self.hands.act(self.palms, &mut control.wrenches);
        let record = control.action.iter_mut().zip(&control.joint_target).zip(q0);
        record.for_each(|((action, target), q0)| *action = (target - q0) / ACTION_SCALE);
    }

    fn judge(&mut self, world: &World, random: &mut Random, reward_terms: &mut [f32]) -> Outcome {
        let row = world.row();
        self.read_feet(world);
        let velocity = rewards::velocity(row);
        self.slow_velocity += (velocity - self.slow_velocity) * (CONTROL_DT / SLOW_S);
        let up = row.robot.pose.rotation * Vector3::z();
        let fell = row.robot.pose.translation.z < FALL.0 || up.z < libm::cos(FALL.1);
        let view = View { walking: self, world, row, velocity, fell };
        for ((place, weight), (.., value)) in reward_terms.iter_mut().zip(&self.weights).zip(TERMS) {
            *place = (weight * value(&view) * CONTROL_DT) as f32;
        }
        self.joint_velocity.copy_from_slice(&row.joint_velocity);
        self.command_left = self.command_left.saturating_sub(1);
        if self.command_left == 0 {
            (self.command, self.command_left) = draw_command(&self.options, random);
        }
        self.setpoint.advance(&self.command);
        match fell {
            true => Outcome::Failure,
            false if row.step >= self.options.horizon_steps => Outcome::TimeOut,
            false => Outcome::Continues,
        }
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        let row = world.row();
        self.remember(row);
        let written = self.history.write(observation);
        let places = observation[written..].iter_mut();
        let world_from_heading = rewards::heading(row);
        let local = |vector: &Vector3<f64>| world_from_heading.inverse_transform_vector(vector);
        let pelvis = row.robot.pose.translation.vector;
        let bodies = [local(&row.robot.linear_velocity), local(&row.robot.angular_velocity), self.slow_velocity];
        let feet = self.foot_position.map(|position| local(&(position - Vector3::new(pelvis.x, pelvis.y, 0.0))));
        let speeds = self.foot_velocity.map(|velocity| local(&velocity));
        let loads = [Support::LeftFoot, Support::RightFoot].map(|foot| row.load(errand::FLOOR_LOAD)[foot as usize]);
        let upright = [row.robot.pose.rotation.inverse_transform_vector(&Vector3::z())];
        let torso = rewards::torso(world, self.torso);
        let forces = [0, 1].map(|hand| local(&self.hands.force(hand)));
        let q0 = world.scene().robot.q0();
        let numbers = (bodies.iter().chain(&feet).chain(&speeds).flat_map(|vector| vector.iter().copied()))
            .chain(loads)
            .chain(upright.iter().flat_map(|vector| vector.iter().copied()))
            .chain([pelvis.z])
            .chain(torso)
            .chain(row.joint_position.iter().zip(q0).take(MOVED + ARMS).map(|(q, q0)| q - q0))
            .chain(row.joint_velocity.iter().take(MOVED + ARMS).copied())
            .chain(forces.iter().flat_map(|vector| vector.iter().copied()));
        places.zip(numbers).for_each(|(place, number)| *place = number as f32);
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        let mut settings = vec![("task", "walking".to_owned())];
        settings.extend(self.options.listed());
        settings
    }

    fn save(&self) -> Result<Vec<u8>, TaskError> {
        self.state()
    }

    fn load(&mut self, saved: &[u8], _: &Row, _: &Light) -> Result<(), TaskError> {
        self.set_state(saved)
    }
}
