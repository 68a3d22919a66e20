//! Sensors with a rate of their own in a batch: the numbers are those of an episode at the steps that are due.

use std::sync::Arc;

use fiatlux_batch::{Bank, Batch, BatchConfig, BatchError, Outputs, Rulebook, RulebookOptions, Snapshot};
use fiatlux_render::{Lighting, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{CONTROL_DT, Task, errand};
use fiatlux_sensing::{Cadence, Sampler, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};
use nalgebra::Point3;

use crate::common::bits;

const IMAGE_SIZE: [usize; 2] = [16, 12];
const PIXELS: usize = 3 * 16 * 12;
const PERIOD: u64 = 5;
const TASK: Task = Task::S05;

fn robot() -> Arc<Robot> {
    Arc::new(Robot::by_name("g1_inspire").unwrap())
}

/// A picture in every fifth step, another one when somebody looks, and contact in every step.
fn sampler() -> Sampler {
    Sampler::new(Sensors::of(&[Sensor::HandContact]))
        .with(Sensor::Camera, Cadence::Every(PERIOD))
        .with(Sensor::ChestCamera, Cadence::Look)
}

fn specs() -> Vec<EpisodeSpec> {
    [(0, 0), (5, 2)].map(|(seed, episode)| EpisodeSpec::new(TASK, seed, episode)).into()
}

/// A world for each episode, on two threads.
fn batch(sensors: Sampler) -> Batch {
    let (robot, config) = (robot(), SceneConfig::default());
    let gains = robot.gains(GainSet::Fiatlux);
    let banks: Vec<Bank> = specs()
        .iter()
        .flat_map(|spec| Bank::of_episodes(&config, &robot, &gains, std::slice::from_ref(spec)).unwrap())
        .collect();
    let options = RulebookOptions {
        sensors,
        image_size: IMAGE_SIZE,
        noise: false,
        horizon_steps: 23,
        ..RulebookOptions::new(TASK)
    };
    let task = Rulebook::new(TASK, &banks[0].scene, options, None).unwrap();
    Batch::new(BatchConfig { threads: 2, ..BatchConfig::new(banks) }, &task).unwrap()
}

/// The pictures of a row's cameras.
fn pictures(episode: &Episode) -> [Vec<f32>; 2] {
    let sensors = Sensors::of(&[Sensor::Camera, Sensor::ChestCamera]);
    let setup = Setup { image_size: IMAGE_SIZE, ..Setup::new(episode.scene(), TASK) };
    let mut suite = SensorSuite::new(sensors, setup);
    let visuals = || Arc::new(Visuals::new(episode.scene()));
    suite.begin(episode.scene(), None, visuals, Lighting::of(&episode.spec().light())).unwrap();
    [Sensor::Camera, Sensor::ChestCamera].map(|sensor| {
        let mut numbers = vec![0.0; suite.length(sensor)];
        suite.compute(sensor, &View::of(episode), &mut numbers).unwrap();
        numbers
    })
}

fn started() -> Vec<Episode> {
    let robot = robot();
    let start = |spec: &EpisodeSpec| {
        let scene =
            Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec.scene(robot.gains(GainSet::Fiatlux)));
        Episode::start(Arc::new(scene.unwrap()), spec).unwrap()
    };
    specs().iter().map(start).collect()
}

/// The parts of an observation: both pictures, and the age of each, s.
fn parts(batch: &Batch, observation: &[f32], world: usize) -> [(Vec<f32>, f32); 2] {
    let length = batch.spec().observation_length();
    let seen = &observation[world * length..][..length];
    ["camera", "chest_camera"].map(|name| {
        let (mut at, mut found) = (0, (Vec::new(), f32::NAN));
        for field in &batch.spec().observation {
            let numbers = &seen[at..at + field.words()];
            if field.name == name {
                let bytes = numbers.iter().flat_map(|word| word.to_ne_bytes());
                found.0 = bytes.take(field.length()).map(f32::from).collect();
            } else if field.name == format!("{name}.age") {
                found.1 = numbers[0];
                assert!((field.range[0]..=field.range[1]).contains(&found.1), "{field:?}");
            }
            at += field.words();
        }
        found
    })
}

fn age(steps: u64) -> f32 {
    (steps as f64 * CONTROL_DT) as f32
}

/// A field keeps its last picture and says its age, also in the last observation of an episode; the next one begins with fresh ones.
#[test]
fn pictures_are_kept_between_those_that_are_due() {
    let (mut batch, mut episodes) = (batch(sampler()), started());
    let mut outputs = Outputs::new(&batch);
    batch.reset(&mut outputs.observation).unwrap();
    let first: Vec<_> = episodes.iter().map(pictures).collect();
    let (mut drawn, mut looked) = (first.clone(), 0);
    for step in 0..23 {
        if step == 8 {
            batch.look(&["chest_camera".into()], &[true, false], &mut outputs.observation).unwrap();
            drawn[0][1] = pictures(&episodes[0])[1].clone();
            looked = step;
        }
        for (world, episode) in episodes.iter().enumerate() {
            if step % PERIOD == 0 {
                drawn[world][0] = pictures(episode)[0].clone();
            }
            let taken = if world == 0 { looked } else { 0 };
            let [head, chest] = parts(&batch, &outputs.observation, world);
            assert_eq!(head, (drawn[world][0].clone(), age(step % PERIOD)), "world {world} step {step}");
            assert_eq!(chest, (drawn[world][1].clone(), age(step - taken)), "world {world} step {step}");
            assert_eq!(head.0.len(), PIXELS);
        }
        let moved = vec![0.3; 2 * batch.spec().actions.len()];
        batch.step(&moved, &mut outputs.buffers()).unwrap();
        let joints = batch.spec().actions.len();
        for episode in &mut episodes {
            episode.step(&moved[..joints]).unwrap();
        }
    }
    assert_eq!(outputs.truncated, [true, true]);
    assert_ne!(drawn[0][0], first[0][0], "the robot moves");
    for world in 0..2 {
        let [head, chest] = parts(&batch, &outputs.final_observation, world);
        assert_eq!(head, (drawn[world][0].clone(), age(3)));
        assert_eq!(chest.0, drawn[world][1]);
        let [head, chest] = parts(&batch, &outputs.observation, world);
        assert_eq!((head, chest), ((first[world][0].clone(), 0.0), (first[world][1].clone(), 0.0)));
    }
}

/// A restored or copied world has the kept picture with its age, and goes on to the last bit.
#[test]
fn a_restored_world_goes_on_with_its_picture() {
    let mut played = batch(sampler());
    let mut outputs = Outputs::new(&played);
    played.reset(&mut outputs.observation).unwrap();
    let joints = played.spec().actions.len();
    let step = |batch: &mut Batch, steps: std::ops::Range<u64>| {
        let mut outputs = Outputs::new(batch);
        for step in steps {
            let actions: Vec<f64> = (0..2 * joints).map(|index| 0.3 * ((index as f64 + step as f64).sin())).collect();
            batch.step(&actions, &mut outputs.buffers()).unwrap();
        }
        outputs.observation
    };
    step(&mut played, 0..7);
    played.look(&["chest_camera".into()], &[true, true], &mut outputs.observation).unwrap();
    let saved = Snapshot::from_bytes(&played.save().unwrap().to_bytes()).unwrap();
    let [one, all] = [7..9, 7..15].map(|steps| {
        let mut other = batch(sampler());
        let mut seen = outputs.observation.clone();
        seen.fill(0.0);
        other.restore(&saved, &mut seen).unwrap();
        assert_eq!(bits(&seen), bits(&outputs.observation), "the snapshot has the pictures");
        step(&mut other, steps)
    });
    assert_eq!(bits(&step(&mut played, 7..9)), bits(&one));
    let [_, chest] = parts(&played, &one, 0);
    assert_eq!(chest.1, age(2));
    assert_eq!(bits(&step(&mut played, 9..15)), bits(&all));

    let other = batch(Sampler::new(sampler().sensors()));
    let error = { other }.restore(&saved, &mut outputs.observation).unwrap_err();
    assert!(matches!(error, BatchError::Snapshot { .. }), "{error}: other rates are other settings");
}

#[test]
fn a_look_at_a_missing_sensor_is_refused() {
    let mut batch = batch(sampler());
    let mut outputs = Outputs::new(&batch);
    batch.reset(&mut outputs.observation).unwrap();
    let before = outputs.observation.clone();
    let error = batch.look(&["lidar".into()], &[true, true], &mut outputs.observation).unwrap_err();
    let before = bits(&before);
    let source = std::error::Error::source(&error).map(ToString::to_string).unwrap_or_default();
    assert!(source.contains("'lidar'") && source.contains("camera@10"), "{error}: {source}");
    assert_eq!(bits(&outputs.observation), before);
    batch.step(&vec![0.0; 2 * batch.spec().actions.len()], &mut outputs.buffers()).unwrap();
}

/// The goal is where the lamp is, in the frame that the pelvis had at the start of the episode, also in a world that goes on from another
/// batch's snapshot.
#[test]
fn the_goal_is_the_lamp_from_where_the_robot_began() {
    let mut played = batch(Sampler::new(Sensors::of(&[Sensor::Goal])));
    let mut outputs = Outputs::new(&played);
    played.reset(&mut outputs.observation).unwrap();
    let began = [0, 1].map(|world| played.row(world).unwrap());
    let joints = played.spec().actions.len();
    let expected = outputs.observation.clone();
    for (row, goal) in began.iter().zip(expected.chunks(3)) {
        let goal = Point3::new(goal[0], goal[1], goal[2]).cast::<f64>();
        let lamp = (row.robot.pose * goal).coords - row.things[errand::FIXTURE].pose.translation.vector;
        // Depth of the seat in the published fixture.
        assert!((lamp.norm() - 0.036_259).abs() < 1e-5, "{lamp}");
    }
    for _ in 0..8 {
        played.step(&vec![0.4; 2 * joints], &mut outputs.buffers()).unwrap();
    }
    assert!(
        (played.row(0).unwrap().robot.pose.translation.vector - began[0].robot.pose.translation.vector).norm() > 1e-3
    );
    assert_eq!(outputs.observation, expected);
    let saved = Snapshot::from_bytes(&played.save().unwrap().to_bytes()).unwrap();
    let mut other = batch(Sampler::new(Sensors::of(&[Sensor::Goal])));
    other.restore(&saved, &mut outputs.observation).unwrap();
    other.step(&vec![0.4; 2 * joints], &mut outputs.buffers()).unwrap();
    assert_eq!(outputs.observation, expected);
    other.copy_world(0, &[true, false], &mut outputs.observation).unwrap();
    other.reset(&mut outputs.observation).unwrap();
    assert_eq!(outputs.observation, expected, "the same start");
}
