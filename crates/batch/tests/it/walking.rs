//! The example of a task.

use fiatlux_batch::{Bank, Outputs, Walking, WalkingOptions};

use crate::common::{floor, simple};

/// Numbers of a field of one world's observation.
fn field<'a>(batch: &fiatlux_batch::Batch, outputs: &'a Outputs, name: &str) -> &'a [f32] {
    let fields = &batch.spec().observation;
    let at = fields.iter().position(|field| field.name == name).unwrap();
    let start: usize = fields[..at].iter().map(|field| field.length()).sum();
    &outputs.observation[start..start + fields[at].length()]
}

#[test]
fn observations_have_the_pilots_form() {
    let bank = Bank::standing(floor());
    let options = WalkingOptions { noise: false, ..WalkingOptions::default() };
    let task = Walking::new(&bank.scene, options).unwrap();
    let mut batch = simple(bank, &task, 1, 1);
    assert_eq!(batch.spec().actions.len(), 15);
    let mut outputs = Outputs::new(&batch);
    assert_eq!(outputs.observation.len(), 4 * 80 + 94);
    batch.reset(&mut outputs.observation).unwrap();
    // Before the first step all frames are the first one.
    let angles = field(&batch, &outputs, "joint_position");
    assert!(angles[..15] == angles[45..] && angles.iter().any(|angle| *angle != 0.0));
    batch.step(&[0.3; 15], &mut outputs.buffers()).unwrap();
    let actions = field(&batch, &outputs, "last_action");
    assert!(actions[..45].iter().all(|action| *action == 0.0) && actions[45..].iter().all(|action| *action == 0.3));
    // The frame tells what the row has.
    let row = batch.row(0).unwrap();
    let q0 = batch.scene(0).unwrap().robot.q0();
    let angles = &field(&batch, &outputs, "joint_position")[45..];
    for joint in 0..15 {
        assert_eq!(angles[joint], (row.joint_position[joint] - q0[joint]) as f32);
    }
    // The soles are on the floor.
    let feet = field(&batch, &outputs, "privileged.foot_position");
    assert!(feet[2].min(feet[5]).abs() < 0.02, "{feet:?}");
}

#[test]
fn robots_fall_and_rise_and_time_runs_out() {
    let bank = Bank::standing(floor());
    let options = WalkingOptions { horizon_steps: 20, ..WalkingOptions::default() };
    let task = Walking::new(&bank.scene, options).unwrap();
    let mut batch = simple(bank, &task, 2, 2);
    let mut outputs = Outputs::new(&batch);
    for step in 1..=40 {
        batch.step(&[0.0; 30], &mut outputs.buffers()).unwrap();
        assert_eq!(outputs.truncated, [step % 20 == 0; 2]);
        assert!(outputs.terminated.iter().all(|ended| !ended));
        // The sum of the terms.
        let terms = outputs.reward_terms.len() / 2;
        let sum: f32 = outputs.reward_terms[..terms].iter().sum();
        assert!((outputs.reward[0] - sum).abs() < 1e-5 && sum > 0.0, "{sum}");
    }
    // Pitched forward it falls, and the fall is charged.
    let bank = Bank::standing(floor());
    let task = Walking::new(&bank.scene, WalkingOptions::default()).unwrap();
    let mut batch = simple(bank, &task, 1, 1);
    let fell = (0..200).find(|_| {
        batch.step(&[0.0; 15], &mut outputs_of(&mut outputs).buffers()).unwrap();
        outputs.terminated[0]
    });
    assert!(fell.is_some() && outputs.reward[0] < -1.5, "{fell:?} {}", outputs.reward[0]);
}

#[test]
fn weights_of_the_reward_can_be_given() {
    let bank = Bank::standing(floor());
    let with = |name: &str, weight: f64| {
        let options =
            WalkingOptions { reward_weights: [(name.to_owned(), weight)].into(), ..WalkingOptions::default() };
        Walking::new(&bank.scene, options)
    };
    assert!(with("velocitty", 1.0).unwrap_err().to_string().contains("velocitty"));
    assert!(with("alive", f64::NAN).unwrap_err().to_string().contains("NaN"));
    let task = with("alive", 2.0).unwrap();
    let mut batch = simple(bank.clone(), &task, 1, 1);
    let alive = batch.spec().rewards.iter().position(|name| name == "alive").unwrap();
    let mut outputs = Outputs::new(&batch);
    batch.step(&[0.0; 15], &mut outputs.buffers()).unwrap();
    assert_eq!(outputs.reward_terms[alive], 0.04);
}

/// Buffers for a single world.
fn outputs_of(outputs: &mut Outputs) -> &mut Outputs {
    let Outputs { observation, final_observation, reward, reward_terms, terminated, truncated, success } = outputs;
    let terms = reward_terms.len() / reward.len();
    let length = observation.len() / reward.len();
    [observation, final_observation].into_iter().for_each(|numbers| numbers.truncate(length));
    reward.truncate(1);
    reward_terms.truncate(terms);
    [terminated, truncated, success].into_iter().for_each(|flags| flags.truncate(1));
    outputs
}
