//! A step allocates nothing, also where episodes end in it; and what pictures hold. One test, so that no other one allocates at the same
//! time.
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

/// Bytes that these many worlds of one thread hold, with the caller's array, after steps in which each ended an episode.
fn held(banks: &[Bank], worlds: usize, image_size: [usize; 2]) -> usize {
    let sensors = Sampler::new(Sensors::of(&[Sensor::Camera]));
    let options = RulebookOptions { sensors, image_size, horizon_steps: 2, ..RulebookOptions::new(Task::S07) };
    let make = || {
        let task = Rulebook::new(Task::S07, &banks[0].scene, options, None).unwrap();
        let config = BatchConfig { worlds, threads: 1, ..BatchConfig::new(banks.to_vec()) };
        let mut batch = Batch::new(config, &task).unwrap();
        let actions = vec![0.0; batch.worlds() * batch.spec().actions.len()];
        let mut outputs = Outputs::new(&batch);
        for _ in 0..3 {
            batch.step(&actions, &mut outputs.buffers()).unwrap();
        }
        // What a caller may do without.
        outputs.final_observation = Vec::new();
        (batch, outputs)
    };
    fiatlux_allocations::held(make).1
}

/// Bars of memory: 1,024 worlds of 128 x 128 below 120 MB of pictures, a world of 640 x 480 at most 6 MiB, its thread's renderer and
/// the meshes not counted.
fn pictures_hold_two_copies(banks: &[Bank]) {
    for (size, bar) in [([128, 128], 120_000_000 / 1024), ([640, 480], 6 << 20)] {
        let [few, many] = [1, 3].map(|worlds| held(banks, worlds, size));
        let plain = held(banks, 3, [4, 4]) - held(banks, 1, [4, 4]);
        let pictures = (many - few - plain) / 2;
        let bytes = 3 * size[0] * size[1];
        assert!(pictures <= bar && pictures >= 2 * bytes - 1024, "{size:?}: {pictures} bytes of pictures a world");
        assert!(
            pictures <= 2 * bytes,
            "{size:?}: {pictures} bytes, where the world's own and the caller's array have {bytes} each"
        );
    }
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
    let (allocations, ended) = count(Batch::new(config(banks.clone()), &task).unwrap());
    assert!(allocations == 0 && ended > 0, "{allocations} allocations, {ended} ends");
    pictures_hold_two_copies(&banks[..1]);
}
