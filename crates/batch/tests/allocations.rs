//! A step allocates nothing, also where episodes end in it. One test, so that no other one allocates at the same time.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_batch::{Bank, Batch, BatchConfig, Outputs, Rulebook, RulebookOptions, Walking, WalkingOptions};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Task, Variant};
use fiatlux_sensing::{Cadence, Sampler, Sensor, Sensors};
use fiatlux_world::{EpisodeSpec, Scene, SceneConfig, SceneSpec};

/// Allocations in steps of a batch, after a few; and how many episodes ended in them.
fn count(mut batch: Batch) -> (usize, usize) {
    let mut outputs = Outputs::new(&batch);
    let actions = vec![0.2; batch.worlds() * batch.spec().actions.len()];
    for _ in 0..5 {
        batch.step(&actions, &mut outputs.buffers()).unwrap();
    }
    let mut ended = 0;
    let step = |(): &mut ()| {
        for _ in 0..60 {
            batch.step(&actions, &mut outputs.buffers()).unwrap();
            ended += outputs.terminated.iter().zip(&outputs.truncated).filter(|(a, b)| **a || **b).count();
        }
    };
    (fiatlux_allocations::count(|| (), step), ended)
}

#[test]
fn a_step_allocates_nothing() {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let scene = Scene::build(&SceneConfig::default(), Arc::clone(&robot), SceneSpec::floor(gains.clone())).unwrap();
    let bank = Bank::standing(Arc::new(scene));
    let options = WalkingOptions { horizon_steps: 10, ..WalkingOptions::default() };
    let task = Walking::new(&bank.scene, options).unwrap();
    let config = |banks| BatchConfig { worlds: 4, threads: 2, ..BatchConfig::new(banks) };
    let (allocations, ended) = count(Batch::new(config(vec![bank]), &task).unwrap());
    assert!(allocations == 0 && ended == 48, "{allocations} allocations, {ended} ends");

    let episodes = [0, 1].map(|episode| EpisodeSpec::new(Task::S07, 0, episode));
    let banks = Bank::of_episodes(&SceneConfig::default(), &robot, &gains, &episodes).unwrap();
    let sensors = Sampler::new(Sensors::of_body(Task::S07)).with(Sensor::Privileged, Cadence::Every(3));
    let options = RulebookOptions { variant: Variant::Training, sensors, ..RulebookOptions::new(Task::S07) };
    let task = Rulebook::new(Task::S07, &banks[0].scene, options, None).unwrap();
    let (allocations, ended) = count(Batch::new(config(banks), &task).unwrap());
    assert!(allocations == 0 && ended > 0, "{allocations} allocations, {ended} ends");
}
