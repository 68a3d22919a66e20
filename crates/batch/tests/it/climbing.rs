//! Following the plan of the ladder.

use std::sync::Arc;

use fiatlux_batch::{Bank, Batch, BatchConfig, Climbing, ClimbingOptions, Outputs};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_world::{LadderPart, Scene, SceneConfig, SceneParts, SceneSpec};

fn bank(ladder: Option<LadderPart>) -> Bank {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let parts = SceneParts { ladder, ..SceneParts::FLOOR };
    let spec = SceneSpec::new(parts, 0, robot.gains(GainSet::default()));
    Bank::standing(Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap()))
}

fn batch(options: ClimbingOptions, worlds: usize, threads: usize) -> (Batch, Outputs) {
    let bank = bank(Some(LadderPart::Free));
    let task = Climbing::new(&bank.scene, options).unwrap();
    let batch = Batch::new(BatchConfig { worlds, threads, ..BatchConfig::new(vec![bank]) }, &task).unwrap();
    let outputs = Outputs::new(&batch);
    (batch, outputs)
}

/// Numbers of a field of the first world's observation.
fn field<'a>(batch: &Batch, outputs: &'a Outputs, name: &str) -> &'a [f32] {
    let fields = &batch.spec().observation;
    let at = fields.iter().position(|field| field.name == name).unwrap();
    let start: usize = fields[..at].iter().map(|field| field.length()).sum();
    &outputs.observation[start..start + fields[at].length()]
}

fn term(batch: &Batch, outputs: &Outputs, name: &str) -> f32 {
    outputs.reward_terms[batch.spec().rewards.iter().position(|term| term == name).unwrap()]
}

#[test]
fn episodes_begin_on_the_plan_and_bear_at_rest() {
    let start = [70.0, 70.0];
    let options = ClimbingOptions { noise: false, starts: vec![start], holds: 1.0, ..ClimbingOptions::default() };
    let (mut batch, mut outputs) = batch(options, 1, 1);
    batch.reset(&mut outputs.observation).unwrap();
    // Apart by the noise of the start alone, in units of 5 cm and 0.2 rad.
    for name in ["pelvis_error", "sole_error", "privileged.sole_error"] {
        assert!(field(&batch, &outputs, name).iter().all(|number| number.abs() < 0.8), "{name}");
    }
    assert_eq!(field(&batch, &outputs, "rate"), [0.0]);
    // Without any correction the plan's targets bear the robot for a while, both feet on treads at 0.7 m or so.
    for _ in 0..10 {
        batch.step(&[0.0; 15], &mut outputs.buffers()).unwrap();
        assert!(!outputs.terminated[0]);
    }
    let height = batch.row(0).unwrap().robot.pose.translation.z;
    assert!((1.2..1.6).contains(&height), "{height}");
    let force = field(&batch, &outputs, "privileged.foot_force");
    let load = (force[2] + force[5]) * 200.0;
    assert!((200.0..500.0).contains(&load), "{load} N");
}

#[test]
fn who_leaves_the_plan_ends_the_episode_and_is_charged() {
    let options = ClimbingOptions { starts: vec![[20.0, 20.0]], ..ClimbingOptions::default() };
    let (mut batch, mut outputs) = batch(options, 1, 1);
    batch.reset(&mut outputs.observation).unwrap();
    let mut thrown = [0.0; 15];
    thrown[3] = 3.0;
    thrown[9] = -3.0;
    let lost = (0..100).find(|_| {
        batch.step(&thrown, &mut outputs.buffers()).unwrap();
        outputs.terminated[0]
    });
    assert!(lost.is_some() && !outputs.success[0]);
    assert_eq!(term(&batch, &outputs, "termination"), -5.0);
    assert_eq!(term(&batch, &outputs, "alive"), 0.02);
}

#[test]
fn the_plan_runs_both_ways_and_the_arms_may_carry() {
    let mut posture = [0.0; 14];
    posture[10] = 0.35;
    let starts = vec![[1e3, 1e3]];
    let options = ClimbingOptions { backwards: 1.0, holds: 0.0, ..ClimbingOptions::default() };
    let options = ClimbingOptions { starts, arms: vec![posture], carries: 1.0, noise: false, ..options };
    let (mut batch, mut outputs) = batch(options, 1, 1);
    batch.reset(&mut outputs.observation).unwrap();
    let phase = field(&batch, &outputs, "phase")[0];
    assert!(field(&batch, &outputs, "rate")[0] < -0.7);
    batch.step(&[0.0; 15], &mut outputs.buffers()).unwrap();
    assert!(field(&batch, &outputs, "phase")[0] < phase);
    let row = batch.row(0).unwrap();
    assert_eq!(row.joint_target[25], 0.35);
    assert!(row.robot.pose.translation.z > 1.8, "on the platform");
}

#[test]
fn results_do_not_depend_on_threads() {
    let play = |threads| {
        let options = ClimbingOptions { horizon_steps: 15, ..ClimbingOptions::default() };
        let (mut batch, mut outputs) = batch(options, 6, threads);
        batch.reset(&mut outputs.observation).unwrap();
        let mut said: Vec<u32> = Vec::new();
        for step in 0..30 {
            let actions: Vec<f64> = (0..90).map(|index| ((index * 7 + step) % 11) as f64 * 0.2 - 1.0).collect();
            batch.step(&actions, &mut outputs.buffers()).unwrap();
            said.extend(outputs.observation.iter().chain(&outputs.reward_terms).map(|number| number.to_bits()));
        }
        said
    };
    assert_eq!(play(1), play(3));
}

#[test]
fn a_snapshot_goes_on_as_the_world_did() {
    let options = ClimbingOptions { horizon_steps: 40, ..ClimbingOptions::default() };
    let (mut batch, mut outputs) = batch(options, 3, 1);
    batch.reset(&mut outputs.observation).unwrap();
    let mut play = |batch: &mut Batch, steps: std::ops::Range<usize>| {
        let mut said: Vec<u32> = Vec::new();
        for step in steps {
            let actions: Vec<f64> = (0..45).map(|index| ((index * 5 + step) % 7) as f64 * 0.1 - 0.3).collect();
            batch.step(&actions, &mut outputs.buffers()).unwrap();
            said.extend(outputs.observation.iter().chain(&outputs.reward_terms).map(|number| number.to_bits()));
        }
        said
    };
    play(&mut batch, 0..12);
    let saved = batch.save().unwrap();
    let went_on = play(&mut batch, 12..60);
    let mut observation = vec![0.0; 3 * batch.spec().observation_length()];
    batch.restore(&saved, &mut observation).unwrap();
    assert_eq!(play(&mut batch, 12..60), went_on);
}

#[test]
fn options_and_scenes_that_make_no_sense_are_refused() {
    let ladder = bank(Some(LadderPart::Free));
    let refused = |options| Climbing::new(&ladder.scene, options).unwrap_err().to_string();
    let usual = ClimbingOptions::default;
    assert!(refused(ClimbingOptions { rates: [2.0, 1.0], ..usual() }).contains("rates"));
    assert!(refused(ClimbingOptions { starts: Vec::new(), ..usual() }).contains("starts"));
    assert!(refused(ClimbingOptions { starts: vec![[f64::NAN, 1.0]], ..usual() }).contains("starts"));
    assert!(refused(ClimbingOptions { holds: 1.5, ..usual() }).contains("holds"));
    assert!(refused(ClimbingOptions { carries: 0.5, ..usual() }).contains("arms"));
    assert!(refused(ClimbingOptions { until: f64::NAN, ..usual() }).contains("until"));
    let weights = [("height".to_owned(), 1.0)].into();
    assert!(refused(ClimbingOptions { reward_weights: weights, ..usual() }).contains("height"));
    for scene in [bank(None), bank(Some(LadderPart::Fixed))] {
        let error = Climbing::new(&scene.scene, usual()).unwrap_err().to_string();
        assert!(error.contains("ladder"), "{error}");
    }
}
