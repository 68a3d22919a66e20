//! Bad use is refused by name, and nothing panics.

use std::sync::Arc;

use fiatlux_batch::{
    Bank, Batch, BatchConfig, BatchError, Begin, Control, Outcome, Outputs, Ranges, Spec, Task, TaskError, Walking,
};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Row;
use fiatlux_world::{Light, Random, Scene, SceneConfig, SceneSpec, World};

use crate::common::{floor, play, simple, walkers};

#[test]
fn configs_that_make_no_batch() {
    let bank = Bank::standing(floor());
    let task = Walking::new(&bank.scene, Default::default()).unwrap();
    let refused = |change: &dyn Fn(&mut BatchConfig)| {
        let mut config = BatchConfig::new(vec![bank.clone()]);
        change(&mut config);
        Batch::new(config, &task).unwrap_err().to_string()
    };
    assert_eq!(refused(&|config| config.worlds = 0), "batch config: worlds is 0; give at least one");
    assert_eq!(refused(&|config| config.threads = 0), "batch config: threads is 0; give at least one");
    assert!(refused(&|config| config.banks.clear()).contains("banks is 0"));
    assert_eq!(refused(&|config| config.banks.push(bank.clone())), "batch config: banks is 2; give at most 1");
    assert!(refused(&|config| config.banks[0].starts.clear()).contains("bank.starts is 0"));
    let huge = usize::MAX;
    assert_eq!(
        refused(&|config| config.worlds = huge),
        format!("batch config: worlds is {huge}; give at most 1048576")
    );
    assert_eq!(refused(&|config| config.threads = huge), format!("batch config: threads is {huge}; give at most 1024"));
    let broken = refused(&|config| config.banks[0].starts[0].row.joint_position[3] = f64::NAN);
    assert!(
        broken.starts_with("bank 0, start 0: no world starts there: joint_position of 'left_knee_joint' is NaN"),
        "{broken}"
    );
    let pushes = fiatlux_batch::Pushes { interval_s: [2.0, 1.0], linear: 0.1, angular: 0.0 };
    assert!(refused(&|config| config.disturbances.pushes = Some(pushes.clone())).contains("pushes.interval_s"));
    let nominal = Ranges::NOMINAL;
    for (ranges, expected) in [
        (Ranges { com_shift_m: 1e300, ..nominal.clone() }, "ranges: com_shift_m must be from 0 to 1 m"),
        (Ranges { com_shift_m: -0.01, ..nominal.clone() }, "ranges: com_shift_m must be from 0 to 1 m"),
        (Ranges { mass: [0.0, 1.0], ..nominal.clone() }, "ranges: mass must be [least, most], above 0 and below 1e6"),
        (
            Ranges { stiffness: [1.1, 0.9], ..nominal.clone() },
            "ranges: stiffness must be [least, most], at least 0 and below 1e6",
        ),
        (
            Ranges { floor_friction: Some([0.5, f64::NAN]), ..nominal.clone() },
            "ranges: floor_friction must be [least, most], at least 0 and below 1e6",
        ),
    ] {
        assert_eq!(refused(&|config| config.banks[0] = bank.clone().varied(&ranges, 2, 0)), expected);
    }
}

#[test]
fn bad_steps_change_nothing() {
    let mut batch = walkers(3, 2, 0);
    let mut outputs = Outputs::new(&batch);
    let rows: Vec<_> = (0..3).map(|world| batch.row(world).unwrap()).collect();
    let short = batch.step(&[0.0; 44], &mut outputs.buffers()).unwrap_err();
    assert_eq!(short.to_string(), "actions has 44 numbers instead of 45");
    let mut actions = [0.0; 45];
    for (value, named) in [(f64::NAN, "NaN"), (f64::INFINITY, "inf"), (1e300, "1e300")] {
        actions[15 + 3] = value;
        let refused = batch.step(&actions, &mut outputs.buffers()).unwrap_err().to_string();
        assert!(refused.starts_with(&format!("actions: world 1, 'left_knee_joint' is {named}; ")), "{refused}");
    }
    let mut buffers = outputs.buffers();
    buffers.terminated = &mut [];
    let refused = batch.step(&[0.0; 45], &mut buffers).unwrap_err();
    assert_eq!(refused.to_string(), "terminated has 0 numbers instead of 3");
    assert!(matches!(batch.reset(&mut []), Err(BatchError::Length { field: "observation", .. })));
    assert!(matches!(batch.save_world(3), Err(BatchError::NoWorld { world: 3, worlds: 3 })));
    assert_eq!(rows, (0..3).map(|world| batch.row(world).unwrap()).collect::<Vec<_>>());
    batch.step(&[0.0; 45], &mut outputs.buffers()).unwrap();
}

/// A task that fails on request.
#[derive(Clone)]
struct Faulty(Spec);

impl Task for Faulty {
    fn spec(&self) -> &Spec {
        &self.0
    }

    fn begin(&mut self, _: &World, _: &Light, _: &mut Random) -> Result<(), TaskError> {
        Ok(())
    }

    fn command(&mut self, scene: &Scene, _: &Row, action: &[f64], _: &mut Random, control: &mut Control) {
        assert!(action[0] != 1.0, "as the test wants");
        control.joint_target.copy_from_slice(scene.robot.q0());
        if action[0] == 2.0 {
            control.joint_target[4] = f64::NAN;
        }
    }

    fn judge(&mut self, _: &World, _: &mut Random, reward_terms: &mut [f32]) -> Outcome {
        reward_terms.fill(f32::NAN);
        Outcome::Continues
    }

    fn observe(&mut self, _: &World, _: &mut [f32]) -> Result<(), TaskError> {
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "faulty".into())]
    }
}

/// Whatever a task does, the caller gets an error, and a reset helps.
#[test]
fn faults_of_a_task_stay_its_own() {
    let spec = Spec {
        actions: vec!["what".into()],
        action_range: vec![[0.0, 2.0]],
        horizon_steps: 100,
        action_limit: 9.0,
        observation: vec![],
        rewards: vec!["one".into()],
        reward_weights: vec![1.0],
    };
    let mut batch = simple(Bank::standing(floor()), &Faulty(spec), 4, 2);
    let mut outputs = Outputs::new(&batch);
    for faulty in [0, 3] {
        let mut actions = [0.0; 4];
        actions[faulty] = 1.0;
        let unsaved = batch.save().unwrap_err();
        assert!(matches!(unsaved, BatchError::Task { world: 0, .. }), "{unsaved}");
        let panicked = batch.step(&actions, &mut outputs.buffers()).unwrap_err();
        assert!(matches!(panicked, BatchError::Panicked { world } if world == faulty), "{panicked}");
        assert!(matches!(batch.step(&[0.0; 4], &mut outputs.buffers()), Err(BatchError::Torn)));
        batch.reset(&mut []).unwrap();
        actions[faulty] = 2.0;
        let refused = batch.step(&actions, &mut outputs.buffers()).unwrap_err();
        assert!(matches!(refused, BatchError::World { world, .. } if world == faulty), "{refused}");
        batch.reset(&mut []).unwrap();
        batch.step(&[0.0; 4], &mut outputs.buffers()).unwrap();
        assert_eq!(outputs.reward, [0.0; 4], "what is not finite pays nothing");
    }
}

/// A refused call leaves every world, its random stream and the caller's buffer as they were.
#[test]
fn a_refused_reset_changes_nothing() {
    for threads in [1, 3] {
        let (mut batch, mut twin) = (walkers(5, threads, 4), walkers(5, threads, 4));
        let (mut outputs, mut others) = (Outputs::new(&batch), Outputs::new(&twin));
        play(&mut batch, &mut outputs, 0..12);
        play(&mut twin, &mut others, 0..12);
        let row = batch.row(2).unwrap();
        type Change = fn(&mut Row);
        let changes: [(Change, &str); 24] = [
            (|row| row.joint_position[3] = f64::NAN, "joint_position of 'left_knee_joint' is NaN"),
            (|row| row.joint_position[3] = 10.0, "joint_position of 'left_knee_joint' is 10, rad"),
            (|row| row.joint_velocity[0] = 1e4, "joint_velocity of 'left_hip_pitch_joint' is 10000, rad/s"),
            (|row| row.joint_target[3] = 1e200, "joint_target of 'left_knee_joint' is 1e200, rad; the joint goes"),
            (|row| row.joint_target[3] = -1.0, "joint_target of 'left_knee_joint' is -1, rad; the joint goes"),
            (|row| row.joint_effort[3] = 1e200, "joint_effort of 'left_knee_joint' is 1e200, N m; give -"),
            (|row| row.joint_effort[3] = -200.0, "joint_effort of 'left_knee_joint' is -200, N m; give -"),
            (|row| row.joint_effort[3] = f64::NAN, "joint_effort of 'left_knee_joint' is NaN, N m"),
            (|row| row.robot.pose.translation.x = 1e6, "robot_pose is 1000000"),
            (|row| row.robot.pose.translation.x = 1e200, "robot_pose is 1e200 m"),
            (|row| row.robot.pose.rotation.as_mut_unchecked().coords.w = 1.1, "robot_pose has a quaternion of length"),
            (|row| row.robot.linear_velocity.z = f64::INFINITY, "robot_linear_velocity is not finite"),
            (|row| row.robot.linear_velocity.z = 101.0, "robot_linear_velocity is 101"),
            (|row| row.robot.angular_velocity.z = 1e200, "robot_angular_velocity is 1e200 rad/s"),
            (|row| row.action[1] = f64::NAN, "action of 'left_hip_roll_joint' is NaN"),
            (|row| row.action[1] = 1e200, "action of 'left_hip_roll_joint' is 1e200"),
            (|row| row.forces[0].x = 1e200, "old_bulb.hand_force is 1e200 N"),
            (|row| row.forces[1].x = f64::NAN, "old_bulb.hand_force is not finite"),
            (|row| row.loads[0] = 1e200, "old_bulb.hand_force_peak is 1e200 N"),
            (|row| row.loads[0] = f64::NAN, "old_bulb.hand_force_peak is not finite"),
            (|row| row.joint_speed_peak = f64::NAN, "joint_speed_peak is not finite"),
            (|row| row.penetration = 1e200, "penetration is 1e200 m"),
            (|row| row.attachments[0].steps_beyond = u32::MAX, "attachments"),
            (|row| row.attachments.iter_mut().for_each(|bulb| bulb.seated = true), "the socket holds one"),
        ];
        for (change, says) in changes {
            let mut bad = row.clone();
            change(&mut bad);
            let begin = |world| if world == 3 { Begin::AtRow(Box::new(bad.clone())) } else { Begin::AtStart };
            let mut observation = vec![7.0; outputs.observation.len()];
            let refused = batch.reset_worlds(begin, Some(9), &mut observation).expect_err(says);
            let by_world = matches!(refused, BatchError::Row { world: 3, .. } | BatchError::World { world: 3, .. });
            assert!(by_world, "{refused}");
            let words = std::error::Error::source(&refused).map_or(refused.to_string(), |source| source.to_string());
            assert!(words.contains(says), "{words}");
            assert!(observation.iter().all(|number| *number == 7.0));
        }
        assert_eq!(play(&mut batch, &mut outputs, 12..60), play(&mut twin, &mut others, 12..60));
    }
}

/// A row in which a joint is not where its leader has it is no state of that robot.
#[test]
fn a_row_off_the_coupling_is_refused() {
    let robot = Arc::new(Robot::by_name("g1_inspire6").unwrap());
    let spec = SceneSpec::floor(robot.gains(GainSet::Fiatlux));
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap());
    let mut row = World::new(Arc::clone(&scene)).row().clone();
    let [leader, follower] =
        ["L_ring_proximal_joint", "L_ring_intermediate_joint"].map(|name| scene.robot.joint_index(name).unwrap());
    row.joint_position[leader] = 0.5;
    let begin = |row: &Row| {
        let mut bank = Bank::standing(Arc::clone(&scene));
        bank.starts[0].row = row.clone();
        let task = Walking::new(&scene, Default::default()).unwrap();
        Batch::new(BatchConfig { worlds: 1, threads: 1, ..BatchConfig::new(vec![bank]) }, &task).map(|_| ())
    };
    let refused = begin(&row).unwrap_err().to_string();
    let says =
        "joint_position of 'L_ring_intermediate_joint' is 0, rad; it follows 'L_ring_proximal_joint', so make it 0.5";
    assert!(refused.contains(says), "{refused}");
    row.joint_position[follower] = 0.5;
    begin(&row).unwrap();
}

/// A task that cannot begin where one of its worlds shall begin.
#[derive(Clone)]
struct Picky(Spec, u64);

impl Task for Picky {
    fn spec(&self) -> &Spec {
        &self.0
    }

    fn begin(&mut self, world: &World, _: &Light, random: &mut Random) -> Result<(), TaskError> {
        self.1 += 1;
        random.unit();
        if world.row().robot.pose.translation.x > 50.0 { Err("too far away".into()) } else { Ok(()) }
    }

    fn command(&mut self, scene: &Scene, _: &Row, _: &[f64], _: &mut Random, control: &mut Control) {
        control.joint_target.copy_from_slice(scene.robot.q0());
    }

    fn judge(&mut self, _: &World, random: &mut Random, reward_terms: &mut [f32]) -> Outcome {
        reward_terms[0] = self.1 as f32 + random.unit() as f32;
        Outcome::Continues
    }

    fn observe(&mut self, world: &World, observation: &mut [f32]) -> Result<(), TaskError> {
        observation[0] = world.row().robot.pose.translation.x as f32;
        Ok(())
    }

    fn settings(&self) -> Vec<(&'static str, String)> {
        vec![("task", "picky".into())]
    }
}

#[test]
fn a_task_that_cannot_begin_changes_nothing() {
    let spec = Spec {
        actions: vec!["what".into()],
        action_range: vec![[0.0, 2.0]],
        horizon_steps: 100,
        action_limit: 9.0,
        observation: vec![fiatlux_batch::Field::new("x", &[])],
        rewards: vec!["one".into()],
        reward_weights: vec![1.0],
    };
    let made = || simple(Bank::standing(floor()), &Picky(spec.clone(), 0), 4, 2);
    let (mut batch, mut twin) = (made(), made());
    let (mut outputs, mut others) = (Outputs::new(&batch), Outputs::new(&twin));
    let mut far = batch.row(0).unwrap();
    far.robot.pose.translation.x = 60.0;
    let begin = |world| if world == 1 { Begin::AtRow(Box::new(far.clone())) } else { Begin::AtStart };
    let refused = batch.reset_worlds(begin, Some(3), &mut outputs.observation).unwrap_err();
    assert!(matches!(refused, BatchError::Task { world: 1, .. }), "{refused}");
    for _ in 0..5 {
        batch.step(&[0.0; 4], &mut outputs.buffers()).unwrap();
        twin.step(&[0.0; 4], &mut others.buffers()).unwrap();
        assert_eq!((&outputs.reward, &outputs.observation), (&others.reward, &others.observation));
    }
    // What is below the floor is seen when the world is there.
    let mut low = far.clone();
    low.robot.pose.translation.x = 0.0;
    low.robot.pose.translation.z = -3.0;
    let begin = |_| Begin::AtRow(Box::new(low.clone()));
    let refused = batch.reset_worlds(begin, None, &mut outputs.observation).unwrap_err();
    assert!(refused.to_string().contains("m below the floor"), "{refused}");
    batch.step(&[0.0; 4], &mut outputs.buffers()).unwrap();
}
