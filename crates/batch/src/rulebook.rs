//! The benchmark's tasks.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use fiatlux_features::ResNet18;
use fiatlux_render::{HEAD_PIXELS, Lighting, Visuals};
use fiatlux_rules::{
    CONTROL_DT, Causes, JudgeOptions, Judges, JudgesState, Protocol, Rewards, RewardsState, Row, Thresholds, Variant,
};
use fiatlux_sensing::{NoiseSeed, Sampler, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_wire::{read_row, state_message};
use fiatlux_world::{
    ACTION_LIMIT, ACTION_SCALE, CameraVariation, Delay, EpisodeRanges, Light, Random, Scene, Varied, World,
    camera_ranges,
};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use prost::Message;
use serde::{Deserialize, Serialize};

use crate::task::check_weights;
use crate::{Control, Field, Outcome, Spec, Task, TaskError};

/// Largest factor of the noise's width.
const MAX_NOISE_SCALE: f64 = 100.0;

/// Meaning of the numbers of an action; there is one for each joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ActionForm {
    /// Joint target = q0 + 0.5 action, as in the benchmark.
    #[default]
    Action,
    /// The joint targets themselves, rad.
    JointTarget,
}

/// Options of a batch that plays a task of the benchmark.
#[derive(Debug, Clone)]
pub struct RulebookOptions {
    /// Which judge ends an episode and pays rewards.
    pub protocol: Protocol,
    /// Thresholds that the judges use.
    pub thresholds: Thresholds,
    /// Causes that end an episode, in place of the task's own.
    pub end_on: Option<Causes>,
    /// Control steps until time-out; the task's own if there are more.
    pub horizon_steps: u64,
    /// Which reward it pays.
    pub variant: Variant,
    /// Weights of the reward's terms where they are not the usual ones. A term pays its value times its weight times 0.02 s, gate
    /// progress its value times its weight.
    pub reward_weights: BTreeMap<String, f64>,
    /// Sensors of the observation with the rate of each, in the order of [`Sensor::ALL`](fiatlux_sensing::Sensor::ALL). Each
    /// world has its own devices: a camera takes a few hundred kilobytes in each.
    pub sensors: Sampler,
    /// Sensors have noise, from the world's random stream; the benchmark's own episodes draw it by seed and episode.
    pub noise: bool,
    /// Factor of the noise's width: least and most, drawn for each episode; above 0.
    pub noise_scale: [f64; 2],
    /// Ranges of what varies in pictures, by names that begin with [`CAMERA`](fiatlux_rules::CAMERA); drawn for each episode.
    pub camera: EpisodeRanges,
    /// Width and height of the cameras' images, pixels.
    pub image_size: [usize; 2],
    /// Meaning of the numbers of an action.
    pub action_form: ActionForm,
    /// Control steps from an action's arrival to its effect: least and most, drawn for each episode.
    pub action_delay: [usize; 2],
}

impl RulebookOptions {
    /// A task as the benchmark plays it, with proprioception, contact forces and the last action as its observation.
    pub fn new(task: fiatlux_rules::Task) -> Self {
        Self {
            protocol: Protocol::default(),
            thresholds: Thresholds::default(),
            end_on: None,
            horizon_steps: task.horizon_steps(),
            variant: Variant::Benchmark,
            reward_weights: BTreeMap::new(),
            sensors: Sampler::new(Sensors::of_body(task)),
            noise: true,
            noise_scale: [1.0; 2],
            camera: EpisodeRanges::default(),
            image_size: [HEAD_PIXELS; 2],
            action_form: ActionForm::Action,
            action_delay: [0; 2],
        }
    }
}

/// A task of the benchmark, with the same judges, rewards and sensors as an [`Episode`](fiatlux_world::Episode): the
/// same actions from the same start give the same rows, rewards and end.
#[derive(Debug, Clone)]
pub struct Rulebook {
    task: fiatlux_rules::Task,
    options: Arc<RulebookOptions>,
    spec: Arc<Spec>,
    visuals: SharedVisuals,
    suite: SensorSuite,
    sampler: Sampler,
    /// `None` before the first episode.
    referee: Option<Referee>,
    episode: u64,
    noise: Option<NoiseSeed>,
    /// Label of the network's weights.
    weights: String,
    /// Factors of the reward's terms.
    factors: Arc<[f64]>,
    delay: Delay,
    /// Pose of the pelvis in row 0 of the episode.
    start: Isometry3<f64>,
    /// Factor of the noise in the present episode.
    noise_scale: f64,
    /// Seed of what varies in the pictures of the present episode.
    camera: Option<u64>,
}

/// State of an episode in one world.
#[derive(Serialize, Deserialize)]
struct State {
    judges: JudgesState,
    rewards: RewardsState,
    episode: u64,
    /// Seed and episode.
    noise: Option<(u64, u64)>,
    noise_scale: f64,
    camera: Option<u64>,
    /// Rows that delayed pictures may still show, as messages.
    past: Vec<Vec<u8>>,
    delay: Delay,
    /// Of sensors that are not computed in every step; their numbers are in the observation.
    taken_at: Vec<u64>,
    /// Pose of the pelvis in row 0: position, then the quaternion's i, j, k, w.
    start: [f64; 7],
}

/// The meshes of each scene, for its cameras; worlds of one scene share them.
type SharedVisuals = Arc<Mutex<Vec<(Arc<Scene>, Arc<Visuals>)>>>;

#[derive(Debug, Clone)]
struct Referee {
    judges: Judges,
    rewards: Rewards,
}

impl Rulebook {
    /// A task with the robot of a scene. `network` computes the features of camera images, if they are among the
    /// sensors.
    ///
    /// # Errors
    /// A weight for a term that the reward does not have, or one that is not finite.
    pub fn new(
        task: fiatlux_rules::Task,
        scene: &Scene,
        options: RulebookOptions,
        network: Option<ResNet18>,
    ) -> Result<Self, TaskError> {
        let protocol = options.protocol;
        let setup = Setup { protocol, image_size: options.image_size, ..Setup::new(scene, task) };
        let referee = Referee::new(task, scene, &options);
        let usual: Vec<_> = referee.rewards.terms().iter().map(|term| (term.name, term.weight)).collect();
        let [least, most] = options.noise_scale;
        if !(0.0 <= least && least <= most && most <= MAX_NOISE_SCALE) {
            return Err(format!("ranges: noise must be [least, most], from 0 to {MAX_NOISE_SCALE}").into());
        }
        check_weights(&options.reward_weights, usual.iter().map(|(name, _)| *name))?;
        let given = |name: &str| options.reward_weights.get(name).copied();
        let joints = scene.robot.joints();
        let (action_limit, action_range) = match options.action_form {
            ActionForm::Action => (ACTION_LIMIT, vec![[-1.0, 1.0]; joints.len()]),
            ActionForm::JointTarget => {
                // The largest target whose action is still within its limit.
                let offset = scene.robot.q0().iter().fold(0.0, |most: f64, q0| most.max(q0.abs()));
                let range = joints.iter().map(|joint| [joint.lower as f32, joint.upper as f32]).collect();
                ((ACTION_LIMIT * ACTION_SCALE - offset).floor(), range)
            }
        };
        let fields = |sensor: Sensor| {
            let terms = sensor.terms(&setup).into_iter().map(move |term| {
                Field::of_sensor(sensor.name(), term.name, &term.shape, term.range, most * term.noise, term.scale)
            });
            terms.chain(options.sensors.oldest(sensor).map(|oldest| Field::of_age(sensor.name(), oldest)))
        };
        let spec = Spec {
            actions: joints.iter().map(|joint| joint.name.clone()).collect(),
            horizon_steps: options.horizon_steps.min(task.horizon_steps()),
            action_limit,
            action_range,
            observation: options.sensors.sensors().iter().flat_map(fields).collect(),
            rewards: usual.iter().map(|(name, _)| (*name).to_owned()).collect(),
            reward_weights: usual.iter().map(|(name, weight)| given(name).unwrap_or(*weight)).collect(),
        };
        let weights = network.as_ref().map_or_else(|| "none".into(), |network| network.label().to_owned());
        let factors = usual.iter().map(|(name, weight)| given(name).map_or(1.0, |given| given / weight)).collect();
        Ok(Self {
            task,
            suite: SensorSuite::new(options.sensors.sensors(), setup)
                .with_sight(options.sensors.sight())
                .with_network(network),
            sampler: options.sensors.clone(),
            options: Arc::new(options),
            spec: Arc::new(spec),
            visuals: Arc::default(),
            referee: None,
            episode: 0,
            noise: None,
            weights,
            factors,
            delay: Delay::default(),
            start: Isometry3::identity(),
            noise_scale: 1.0,
            camera: None,
        })
    }

    /// Values drawn for the pictures of the present episode.
    fn of_cameras(&self) -> Varied {
        self.camera.map(|seed| self.options.camera.draw(seed, 0)).unwrap_or_default()
    }

    /// Lets the pictures of the present episode vary as its seed says.
    fn vary_cameras(&mut self) {
        let varied = self.of_cameras();
        self.suite.vary_cameras(self.camera.and_then(|seed| CameraVariation::of(&varied, seed, 0)));
    }

    /// The observer of a row; `None` before the first episode.
    fn sampled<'a>(
        &'a mut self,
        scene: &'a Scene,
        row: &'a Row,
    ) -> Option<(&'a mut Sampler, &'a mut SensorSuite, View<'a>)> {
        let Referee { judges, rewards } = self.referee.as_ref()?;
        let (judge, reward) = (judges.in_force(), rewards.reward());
        let view = View { scene, episode: self.episode, row, start: &self.start, task: self.task, judge, reward };
        Some((&mut self.sampler, &mut self.suite, view))
    }

    fn visuals_of(&self, scene: &Arc<Scene>) -> Arc<Visuals> {
        let mut visuals = self.visuals.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = visuals.iter().find(|(of, _)| Arc::ptr_eq(of, scene)) {
            return Arc::clone(found);
        }
        let made = Arc::new(Visuals::new(scene));
        visuals.push((Arc::clone(scene), Arc::clone(&made)));
        made
    }
}

impl Referee {
    fn new(task: fiatlux_rules::Task, scene: &Scene, options: &RulebookOptions) -> Self {
        let RulebookOptions { protocol, thresholds, end_on, variant, .. } = options;
        let judging = JudgeOptions { end_on: *end_on, ..JudgeOptions::default() };
        let judges = Judges::new(*protocol, task, thresholds, &scene.geometry(), judging);
        let rewards = Rewards::new(judges.in_force(), *variant, scene.joint_groups());
        Self { judges, rewards }
    }
}

impl Task for Rulebook {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&mut self, world: &World, light: &Light, random: &mut Random) -> Result<(), TaskError> {
        self.episode += 1;
        let seed = (random.unit() * (1_u64 << 53) as f64) as u64;
        let (noise, lighting) = (self.options.noise.then_some(NoiseSeed { seed, episode: 0 }), Lighting::of(light));
        self.noise = noise;
        let [least, most] = self.options.action_delay;
        let delay = if most > least { least + random.index(most - least + 1) } else { least };
        let [least, most] = self.options.noise_scale;
        self.noise_scale = if most > least { random.uniform(least, most) } else { least };
        self.suite.scale_noise(self.noise_scale);
        // Nothing is drawn where nothing varies: other numbers stay as they are.
        self.camera = None;
        if self.options.camera != EpisodeRanges::default() {
            self.camera = Some((random.unit() * (1_u64 << 53) as f64) as u64);
        }
        self.vary_cameras();
        self.delay.restart(&world.row().action, delay);
        self.start = world.row().robot.pose;
        if self.referee.is_none() {
            let scene = world.scene();
            self.referee = Some(Referee::new(self.task, scene, &self.options));
            let visuals = self.options.sensors.sensors().meets(Sensors::WITH_IMAGE).then(|| self.visuals_of(scene));
            self.suite.begin(scene, noise, || visuals.unwrap_or_else(|| Arc::new(Visuals::new(scene))), lighting)?;
        } else {
            self.suite.restart(noise, lighting);
        }
        self.suite.remember(world.row());
        if let Some(Referee { judges, rewards }) = &mut self.referee {
            judges.start(world.row());
            rewards.start(judges.in_force(), world.row());
        }
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _row: &Row, action: &[f64], _random: &mut Random, control: &mut Control) {
        let places = control.action.iter_mut().zip(&mut control.joint_target);
        for (((to, target), q0), number) in places.zip(scene.robot.q0()).zip(action) {
            // A row records commands as actions: joint targets are converted first, as in an episode.
            *to = match self.options.action_form {
                ActionForm::Action => *number,
                ActionForm::JointTarget => (number - q0) / ACTION_SCALE,
            };
            *target = q0 + ACTION_SCALE * *to;
        }
        if !self.delay.is_none() {
            self.delay.swap(&mut control.action);
            let targets = control.joint_target.iter_mut().zip(scene.robot.q0()).zip(&control.action);
            targets.for_each(|((target, q0), action)| *target = q0 + ACTION_SCALE * action);
        }
    }

    fn judge(&mut self, world: &World, _random: &mut Random, reward_terms: &mut [f32]) -> Outcome {
        self.suite.remember(world.row());
        let Some(Referee { judges, rewards }) = &mut self.referee else { return Outcome::Continues };
        judges.advance(world.row());
        let terms = rewards.advance(judges.in_force(), world.row());
        for ((place, term), factor) in reward_terms.iter_mut().zip(terms).zip(&*self.factors) {
            *place = (term.reward * factor) as f32;
        }
        let verdict = judges.in_force().verdict();
        match verdict.end {
            None => Outcome::Continues,
            Some(end) if end.is_truncated() => Outcome::TimeOut,
            Some(_) if verdict.success => Outcome::Success,
            Some(_) => Outcome::Failure,
        }
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        let Some((sampler, suite, view)) = self.sampled(world.scene(), world.row()) else { return Ok(()) };
        let sampled = sampler.sample(suite, &view, observation);
        suite.release();
        Ok(sampled?)
    }

    fn look(&mut self, scene: &Scene, row: &Row, sensors: &[String], observation: &mut [f32]) -> Result<(), TaskError> {
        let asked = self.sampler.named(sensors)?;
        let Some((sampler, suite, view)) = self.sampled(scene, row) else { return Ok(()) };
        let looked = sampler.look(suite, asked, &view, observation);
        suite.release();
        Ok(looked?)
    }

    fn senses<'a>(&'a mut self, scene: &'a Scene, row: &'a Row) -> Option<(&'a mut SensorSuite, View<'a>)> {
        self.sampled(scene, row).map(|(_, suite, view)| (suite, view))
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        let RulebookOptions {
            protocol,
            thresholds,
            end_on,
            horizon_steps: _,
            variant,
            reward_weights,
            sensors,
            noise,
            noise_scale,
            camera,
            image_size,
            action_form,
            action_delay,
        } = &*self.options;
        vec![
            ("task", self.task.to_string()),
            ("horizon_steps", self.spec.horizon_steps.to_string()),
            ("protocol", protocol.to_string()),
            ("reward", format!("{variant:?}")),
            ("reward_weights", format!("{reward_weights:?}")),
            ("sensors", sensors.names().join(", ")),
            ("noise", noise.to_string()),
            ("noise_scale", format!("{noise_scale:?}")),
            ("camera", format!("{camera:?}")),
            ("image_size", format!("{image_size:?}")),
            ("weights", self.weights.clone()),
            ("action_form", format!("{action_form:?}")),
            ("action_delay", format!("{action_delay:?} steps")),
            ("end_on", end_on.map_or_else(|| "the task's own".into(), |causes| causes.to_string())),
            ("thresholds", format!("{thresholds:?}")),
        ]
    }

    fn judges(&self) -> Option<&Judges> {
        self.referee.as_ref().map(|referee| &referee.judges)
    }

    fn drawn(&self) -> Vec<(&'static str, f64)> {
        let steps = self.delay.steps(self.spec.actions.len()).unwrap_or_default();
        let noise = if self.noise.is_some() { self.noise_scale } else { 0.0 };
        let cameras = self.of_cameras();
        let cameras = camera_ranges().filter_map(|name| Some((name, *cameras.get(name)?)));
        [("action_delay", steps as f64 * CONTROL_DT * 1e3), ("noise", noise)].into_iter().chain(cameras).collect()
    }

    fn save(&self) -> Result<Vec<u8>, TaskError> {
        let Referee { judges, rewards } = self.referee.as_ref().ok_or("no episode has begun")?;
        let noise = self.noise.map(|noise| (noise.seed, noise.episode));
        let (judges, rewards, episode) = (judges.state(), rewards.state(), self.episode);
        let (noise_scale, delay, taken_at) = (self.noise_scale, self.delay.clone(), self.sampler.taken_at());
        let ([x, y, z], [i, j, k, w]) = (self.start.translation.vector.into(), self.start.rotation.coords.into());
        let start = [x, y, z, i, j, k, w];
        let camera = self.camera;
        let past = self.suite.past().map(|row| state_message(row).encode_to_vec()).collect();
        let state = State { judges, rewards, episode, noise, noise_scale, camera, past, delay, taken_at, start };
        Ok(postcard::to_allocvec(&state)?)
    }

    fn copy_from(&mut self, other: &dyn Task, saved: &[u8], row: &Row, light: &Light) -> Result<(), TaskError> {
        let Some(other) = other.as_any().downcast_ref::<Self>() else { return self.load(saved, row, light) };
        let (Some(own), Some(theirs)) = (&mut self.referee, &other.referee) else {
            return Err("no episode has begun".into());
        };
        own.judges.set_state(theirs.judges.state());
        if !own.rewards.set_state(theirs.rewards.state(), row) {
            return Err("the other world has another number of reward terms".into());
        }
        self.delay.clone_from(&other.delay);
        self.sampler.clone_from(&other.sampler);
        self.start = other.start;
        (self.episode, self.noise, self.noise_scale) = (other.episode, other.noise, other.noise_scale);
        self.suite.scale_noise(self.noise_scale);
        self.camera = other.camera;
        self.vary_cameras();
        other.suite.past().for_each(|row| self.suite.remember(row));
        self.suite.restart(self.noise, Lighting::of(light));
        Ok(())
    }

    fn load(&mut self, saved: &[u8], row: &Row, light: &Light) -> Result<(), TaskError> {
        let Referee { judges, rewards } = self.referee.as_mut().ok_or("no episode has begun")?;
        let state: State = postcard::from_bytes(saved)?;
        if state.delay.steps(row.action.len()).is_none() {
            return Err("the snapshot is damaged: it has a part of a delayed action".into());
        }
        if !rewards.set_state(state.rewards, row) {
            return Err("the snapshot has another number of reward terms".into());
        }
        self.sampler.set_taken_at(&state.taken_at, row.step)?;
        judges.set_state(state.judges);
        let [x, y, z, i, j, k, w] = state.start;
        // As it was, not normalised again.
        let turn = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
        if !state.start.iter().all(|number| number.is_finite()) {
            return Err("the snapshot is damaged: the pelvis began nowhere".into());
        }
        self.start = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        self.delay = state.delay;
        self.episode = state.episode;
        self.noise_scale = state.noise_scale;
        self.suite.scale_noise(state.noise_scale);
        self.noise = state.noise.map(|(seed, episode)| NoiseSeed { seed, episode });
        self.camera = state.camera.filter(|_| self.options.camera != EpisodeRanges::default());
        self.vary_cameras();
        for past in &state.past {
            let past = read_row(&Message::decode(&past[..])?, row.layout)?;
            self.suite.remember(&past);
        }
        self.suite.restart(self.noise, Lighting::of(light));
        Ok(())
    }
}
