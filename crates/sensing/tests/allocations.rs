//! Sensing the body and scanning allocate nothing.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;

use fiatlux_render::{Lighting, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_sensing::{Cost, NoiseSeed, Sensor, SensorSuite, Sensors, Setup, View};
use fiatlux_world::{Episode, EpisodeSpec, Scene, SceneConfig};

#[test]
fn sensing_into_a_buffer_allocates_nothing() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = EpisodeSpec::new(Task::S07, 1, 0);
    let gains = robot.gains(GainSet::default());
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec.scene(gains)).unwrap());
    let mut episode = Episode::start(Arc::clone(&scene), &spec).unwrap();
    let cheap = Sensor::ALL.into_iter().filter(|sensor| sensor.cost() <= Cost::Scan).collect::<Vec<_>>();
    assert!(cheap.contains(&Sensor::Proprioception) && cheap.contains(&Sensor::Lidar) && cheap.len() >= 7);
    let mut suite = SensorSuite::new(Sensors::of(&cheap), Setup::new(&scene, spec.task));
    let visuals = || Arc::new(Visuals::new(&scene));
    suite.begin(&scene, NoiseSeed::of(&spec), visuals, Lighting::default()).unwrap();
    let mut buffers: Vec<Vec<f32>> = cheap.iter().map(|sensor| vec![0.0; suite.length(*sensor)]).collect();
    let action = episode.row().action.clone();
    for _ in 0..20 {
        episode.step(&action).unwrap();
        for (sensor, buffer) in cheap.iter().zip(&mut buffers) {
            let compute = |(): &mut ()| suite.compute(*sensor, &View::of(&episode), buffer).unwrap();
            assert_eq!(fiatlux_allocations::count(|| (), compute), 0, "{}", sensor.name());
        }
    }
    assert!(buffers.iter().flatten().all(|number| number.is_finite()));
}
