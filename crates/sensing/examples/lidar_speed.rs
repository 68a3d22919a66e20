//! Microseconds per LiDAR scan: standing before the ladder, on its platform, and lying next to it.
#![expect(clippy::disallowed_methods, reason = "it measures time")]

use std::error::Error;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Row, Task, errand};
use fiatlux_sensing::{Lidar, Sight};
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};
use nalgebra::{Isometry3, Vector3};

const SCANS: usize = 2000;

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Arc::new(Robot::benchmark()?);
    let gains = robot.gains(GainSet::Fiatlux);
    let spec = SceneSpec::new(SceneKind::CoupledLadder, 0, gains);
    let scene = Arc::new(Scene::build(&SceneConfig::default(), robot, spec)?);
    let row = |task| -> Result<Row, Box<dyn Error>> {
        Ok(start(Arc::clone(&scene), task, 0, &StartOptions::default())?.row().clone())
    };
    let (before, platform) = (row(Task::S02)?, row(Task::S03)?);
    let mut lying = before.clone();
    lying.robot.pose =
        before.things[errand::LADDER].pose * Isometry3::new(Vector3::new(0.7, 0.0, 0.15), Vector3::y() * 1.57);
    let mut lidar = Lidar::new(&scene, Sight::Published)?;
    for (name, row) in [("before the ladder", &before), ("on the platform", &platform), ("lying", &lying)] {
        let mut times: Vec<f64> = (0..SCANS)
            .map(|_| {
                let begin = Instant::now();
                black_box(lidar.scan(black_box(row)));
                begin.elapsed().as_secs_f64() * 1e6
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let mean = times.iter().sum::<f64>() / SCANS as f64;
        println!("{name:18} mean {mean:6.1}  p50 {:6.1}  p99 {:6.1} us", times[SCANS / 2], times[SCANS * 99 / 100]);
    }
    Ok(())
}
