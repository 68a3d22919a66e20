//! Shared helpers of the tests.

use std::sync::Arc;

use fiatlux_batch::{Bank, Batch, BatchConfig, Disturbances, Outputs, Pushes, Ranges, Task, Walking, Wrenches};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{Random, Scene, SceneConfig, SceneSpec, Stream};

pub fn floor() -> Arc<Scene> {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let spec = SceneSpec::floor(robot.gains(GainSet::Fiatlux));
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

/// Walkers that differ from each other in all that can differ, pushed and pulled.
pub fn walkers(worlds: usize, threads: usize, seed: u64) -> Batch {
    let ranges = Ranges {
        hand_friction: Some([0.7, 1.1]),
        floor_friction: Some([0.5, 1.1]),
        mass: [0.9, 1.1],
        com_shift_m: 0.01,
        stiffness: [0.9, 1.1],
        damping: [0.8, 1.2],
        effort_limit: [0.9, 1.0],
        ..Ranges::NOMINAL
    };
    let bank = Bank::standing(floor()).varied(&ranges, 5, 3);
    let task = Walking::new(&bank.scene, Default::default()).unwrap();
    let torso = bank.scene.robot.link_index("torso_link").unwrap();
    let disturbances = Disturbances {
        pushes: Some(Pushes { interval_s: [0.1, 0.4], linear: 0.6, angular: 0.3 }),
        wrenches: Some(Wrenches {
            link: torso,
            interval_s: [0.1, 0.3],
            duration_s: [0.1, 0.2],
            force_n: 30.0,
            torque_nm: 5.0,
        }),
    };
    Batch::new(BatchConfig { worlds, threads, seed, disturbances, ..BatchConfig::new(vec![bank]) }, &task).unwrap()
}

/// Words of an observation, which may have the bytes of pictures in them.
pub fn bits(words: &[f32]) -> Vec<u32> {
    words.iter().map(|word| word.to_bits()).collect()
}

/// Actions of a step: large enough that some robots fall soon.
pub fn actions(batch: &Batch, step: u64) -> Vec<f64> {
    let mut random = Random::new(Stream::Trial, 7, step);
    (0..batch.worlds() * batch.spec().actions.len()).map(|_| random.uniform(-1.0, 1.0)).collect()
}

/// Everything that a batch says over some steps, to the last bit.
pub fn play(batch: &mut Batch, outputs: &mut Outputs, steps: std::ops::Range<u64>) -> Vec<u32> {
    let mut said = Vec::new();
    for step in steps {
        batch.step(&actions(batch, step), &mut outputs.buffers()).unwrap();
        let Outputs { observation, final_observation, reward, reward_terms, .. } = &*outputs;
        let numbers = [observation, final_observation, reward, reward_terms];
        said.extend(numbers.into_iter().flatten().map(|number| number.to_bits()));
        let flags = [&outputs.terminated, &outputs.truncated, &outputs.success];
        said.extend(flags.into_iter().flatten().map(|flag| u32::from(*flag)));
    }
    said
}

pub fn simple(bank: Bank, task: &dyn Task, worlds: usize, threads: usize) -> Batch {
    Batch::new(BatchConfig { worlds, threads, ..BatchConfig::new(vec![bank]) }, task).unwrap()
}
