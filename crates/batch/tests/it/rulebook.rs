//! The benchmark's tasks in a batch are its episodes.

use std::sync::Arc;

use fiatlux_batch::{ActionForm, Bank, Batch, BatchConfig, Outputs, Rulebook, RulebookOptions};
use fiatlux_render::Lighting;
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Cause, Task, Variant};
use fiatlux_sensing::{Sampler, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{Episode, EpisodeSpec, Light, Random, Scene, SceneConfig, Stream};

use crate::common::bits;

/// Those of a learner that sees much.
const SENSORS: Sensors = Sensors::of(&[
    Sensor::Proprioception,
    Sensor::HandContact,
    Sensor::LastAction,
    Sensor::Lidar,
    Sensor::Privileged,
    Sensor::Verdict,
]);

struct Rig {
    batch: Batch,
    episodes: Vec<Episode>,
}

/// A world for each episode, one start each.
fn rig(specs: &[EpisodeSpec], threads: usize, form: ActionForm) -> Rig {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let config = SceneConfig::default();
    let banks: Vec<Bank> = specs
        .iter()
        .flat_map(|spec| Bank::of_episodes(&config, &robot, &gains, std::slice::from_ref(spec)).unwrap())
        .collect();
    let episodes = specs.iter().map(|spec| {
        let scene = Scene::build(&config, Arc::clone(&robot), spec.scene(gains.clone())).unwrap();
        Episode::start(Arc::new(scene), spec).unwrap()
    });
    let episodes = episodes.collect();
    let (task, variant) = (specs[0].task, specs[0].variant);
    let sensors = Sampler::new(SENSORS);
    let options = RulebookOptions { variant, sensors, noise: false, action_form: form, ..RulebookOptions::new(task) };
    let played = Rulebook::new(task, &banks[0].scene, options, None).unwrap();
    let batch = Batch::new(BatchConfig { threads, ..BatchConfig::new(banks) }, &played).unwrap();
    Rig { batch, episodes }
}

fn specs(task: Task, variant: Variant) -> Vec<EpisodeSpec> {
    [(0, 0), (0, 1), (5, 2)]
        .map(|(seed, episode)| EpisodeSpec { variant, ..EpisodeSpec::new(task, seed, episode) })
        .into()
}

fn suite(episode: &Episode) -> SensorSuite {
    let task = episode.spec().task;
    let mut suite = SensorSuite::new(SENSORS, Setup::new(episode.scene(), task));
    let visuals = || Arc::new(fiatlux_render::Visuals::new(episode.scene()));
    suite.begin(episode.scene(), None, visuals, Default::default()).unwrap();
    suite
}

fn observe(suite: &mut SensorSuite, episode: &Episode) -> Vec<f32> {
    SENSORS
        .iter()
        .flat_map(|sensor| {
            let mut numbers = vec![0.0; suite.length(sensor)];
            suite.compute(sensor, &View::of(episode), &mut numbers).unwrap();
            numbers
        })
        .collect()
}

/// Rows, observations, rewards and ends, to the last bit, on one thread and on eight.
#[test]
fn rows_are_those_of_episodes() {
    for (task, variant, threads) in
        [(Task::S05, Variant::Training, 1), (Task::S05, Variant::Benchmark, 8), (Task::S02, Variant::Training, 8)]
    {
        let Rig { mut batch, mut episodes } = rig(&specs(task, variant), threads, ActionForm::Action);
        let mut suites: Vec<_> = episodes.iter().map(suite).collect();
        let mut outputs = Outputs::new(&batch);
        batch.reset(&mut outputs.observation).unwrap();
        let (joints, length) = (batch.spec().actions.len(), batch.spec().observation_length());
        let mut ended = 0;
        for step in 0..120 {
            for (world, episode) in episodes.iter().enumerate() {
                if episode.end().is_none() {
                    assert_eq!(batch.row(world).unwrap(), *episode.row(), "{task} world {world} step {step}");
                    let seen = &outputs.observation[world * length..][..length];
                    assert_eq!(seen, observe(&mut suites[world], episode), "{task} world {world} step {step}");
                }
            }
            let mut random = Random::new(Stream::Trial, 1, step);
            let actions: Vec<f64> = (0..3 * joints).map(|_| random.uniform(-0.4, 0.4)).collect();
            batch.step(&actions, &mut outputs.buffers()).unwrap();
            for (world, episode) in episodes.iter_mut().enumerate().filter(|(_, episode)| episode.end().is_none()) {
                let stepped = episode.step(&actions[world * joints..][..joints]).unwrap();
                let terms: Vec<f32> = stepped.terms.iter().map(|term| term.reward as f32).collect();
                assert_eq!(outputs.reward_terms[world * terms.len()..][..terms.len()], terms);
                let end = episode.end();
                assert_eq!(outputs.terminated[world], end.is_some_and(|end| end.is_terminated()));
                assert_eq!(outputs.truncated[world], end.is_some_and(|end| end.is_truncated()));
                assert_eq!(outputs.success[world], end.is_some_and(|end| end.cause() == Cause::Success));
                if end.is_some() {
                    ended += 1;
                    let last = &outputs.final_observation[world * length..][..length];
                    assert_eq!(last, observe(&mut suites[world], episode));
                    assert_eq!(batch.row(world).unwrap().step, 0);
                }
            }
        }
        assert!(ended > 0, "{task}: no episode ended");
    }
}

/// Light, sizes, friction and room are those of the episode, in pictures as well.
#[test]
fn whatever_is_drawn_is_drawn_as_in_an_episode() {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    for spec in specs(Task::S05, Variant::Benchmark) {
        let banks = Bank::of_episodes(&SceneConfig::default(), &robot, &gains, std::slice::from_ref(&spec)).unwrap();
        let (scene, start) = (Arc::clone(&banks[0].scene), banks[0].starts[0].clone());
        let sensors = Sensors::of(&[Sensor::Camera, Sensor::ChestCamera]);
        let image_size = [32, 24];
        let options = RulebookOptions { sensors: Sampler::new(sensors), image_size, ..RulebookOptions::new(spec.task) };
        let played = Rulebook::new(spec.task, &scene, options, None).unwrap();
        let mut batch = Batch::new(BatchConfig::new(banks), &played).unwrap();
        let mut seen = vec![0.0; batch.spec().observation_length()];
        batch.reset(&mut seen).unwrap();

        let own = Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(gains.clone())).unwrap();
        let episode = Episode::start(Arc::new(own), &spec).unwrap();
        let drawn = episode.domain_sample();
        assert_ne!(drawn.light, Light::default());
        assert_eq!((scene.layout, scene.spec.scale, start.light), (drawn.layout, drawn.scale, drawn.light));
        let mut friction = Default::default();
        scene.set_hand_friction(drawn.hand_friction.unwrap().dynamic_friction, &mut friction);
        assert_eq!(start.variation, friction);

        let mut suite = SensorSuite::new(sensors, Setup { image_size, ..Setup::new(episode.scene(), spec.task) });
        let visuals = || Arc::new(fiatlux_render::Visuals::new(episode.scene()));
        suite.begin(episode.scene(), None, visuals, Lighting::of(&spec.light())).unwrap();
        let mut wanted = vec![0.0; seen.len()];
        for (sensor, part) in sensors.iter().zip(wanted.chunks_mut(seen.len() / 2)) {
            suite.fill(sensor, &View::of(&episode), part).unwrap();
        }
        let [seen, wanted] = [seen, wanted].map(|words| bits(&words));
        assert_eq!(seen, wanted, "seed {} episode {}", spec.seed, spec.episode);
    }
}

#[test]
fn joint_targets_are_actions() {
    let specs = &specs(Task::S07, Variant::Benchmark)[..1];
    let Rig { mut batch, mut episodes } = rig(specs, 1, ActionForm::JointTarget);
    let mut outputs = Outputs::new(&batch);
    let target: Vec<f64> = episodes[0].scene().robot.q0().iter().map(|q| q + 0.05).collect();
    for _ in 0..20 {
        batch.step(&target, &mut outputs.buffers()).unwrap();
        let action = episodes[0].action_for(&target);
        episodes[0].step(&action).unwrap();
    }
    assert_eq!(batch.row(0).unwrap(), *episodes[0].row());
}

/// Starts of one room share its scene; each brings the friction of its hands.
#[test]
fn episodes_of_a_room_share_a_bank() {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let specs = [(0, 0), (1, 0), (0, 1), (0, 2)].map(|(seed, episode)| EpisodeSpec::new(Task::S07, seed, episode));
    let banks = Bank::of_episodes(&SceneConfig::default(), &robot, &gains, &specs).unwrap();
    assert_eq!(banks.iter().map(|bank| bank.starts.len()).collect::<Vec<_>>(), [3, 1]);
    assert_ne!(banks[0].starts[0].variation, banks[0].starts[1].variation);
    let options = RulebookOptions::new(Task::S07);
    let task = Rulebook::new(Task::S07, &banks[0].scene, options, None).unwrap();
    let batch = Batch::new(BatchConfig { worlds: 4, ..BatchConfig::new(banks) }, &task).unwrap();
    let seeds = (0..4).map(|world| batch.scene(world).unwrap().spec.seed).collect::<Vec<_>>();
    assert_eq!(seeds, [0, 0, 1, 1]);
}
