//! Policy `stand` with the robot whose fingers are welded, on a floor and nothing else.

use std::sync::Arc;

use fiatlux_client::Command;
use fiatlux_proto::v3::{Observation, SessionInfo};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_wire::joint_messages;
use fiatlux_world::{ACTION_SCALE, Random, Scene, SceneConfig, SceneSpec, Stream, World};
use nalgebra::UnitQuaternion;

/// Control steps of 120 s.
const STEPS: usize = 6000;

/// It stands for the time of a task with the usual noise of joints at the start and of the sensors.
#[test]
fn stand_stands_for_120_seconds() {
    let robot = Arc::new(Robot::by_name("g1_bare").unwrap());
    let gains = robot.gains(GainSet::Fiatlux);
    let spec = SceneSpec::floor(gains.clone());
    let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap());
    let joints = joint_messages(&robot, &gains);
    let info = SessionInfo { joints, action_scale: ACTION_SCALE, ..SessionInfo::default() };

    for seed in [64, 65] {
        let mut world = World::new(Arc::clone(&scene));
        let mut row = world.row().clone();
        let mut random = Random::new(Stream::Reset, seed, 0);
        let noise = scene.config.start.noise.joint;
        for ((q, q0), limits) in row.joint_position.iter_mut().zip(robot.q0()).zip(robot.joints()) {
            *q = (q0 + random.uniform(-noise, noise)).clamp(limits.lower, limits.upper);
        }
        let upright = UnitQuaternion::identity();
        row.robot.pose.translation.z = robot.height_on_soles(&row.joint_position, &upright).unwrap();
        world.reset_to(&row).unwrap();

        let mut observer = Observer::new(robot.q0().to_vec(), Some(NoiseSeed { seed, episode: 0 }));
        let mut sensed = Proprioception::zeros(29);
        let mut policy = fiatlux_policies::Policies::default().make("stand").unwrap();
        for step in 0..STEPS {
            observer.observe(world.row(), &mut sensed);
            let observation = Observation {
                step: step as u64,
                last_action: vec![0.0; 29],
                proprioception: Some((&sensed).into()),
                ..Observation::default()
            };
            if step == 0 {
                policy.reset(&info, &observation).unwrap();
            }
            let Command::JointTarget(targets) = policy.act(&observation).unwrap() else { panic!("joint targets") };
            let row = world.step(&[0.0; 29], &targets).unwrap();
            let pelvis = &row.robot.pose;
            assert!(pelvis.translation.z > 0.7, "seed {seed}: {} m after {step} steps", pelvis.translation.z);
            assert!(pelvis.translation.vector.xy().norm() < 0.1, "seed {seed}: {pelvis} after {step} steps");
        }
    }
}
