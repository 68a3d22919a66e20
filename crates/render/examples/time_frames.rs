//! Milliseconds a frame of the head camera on one core, by size, from a few start states; with a folder, of the robot in its meshes.
//!
//! ```text
//! cargo run --release -p fiatlux-render --example time_frames -- [MESHES]
//! ```
#![expect(clippy::disallowed_methods, reason = "it measures time")]

use std::error::Error;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use fiatlux_render::{Camera, HEAD_PIXELS, Lighting, Renderer, RobotMeshes, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};

const FRAMES: usize = 60;
const SIZES: [[usize; 2]; 4] = [[64, 64], [128, 128], [HEAD_PIXELS, HEAD_PIXELS], [640, 480]];

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Arc::new(Robot::benchmark()?);
    let begun = Instant::now();
    let meshes = std::env::args().nth(1).map(|folder| RobotMeshes::open(folder, &robot)).transpose()?;
    if let Some(meshes) = &meshes {
        println!("{} links have meshes, read in {:.2} s", meshes.links().count(), begun.elapsed().as_secs_f64());
    }
    let light = Lighting::default();
    println!("{:24} {:>9} {:>8} {:>8} {:>8}", "case", "size", "min ms", "p50 ms", "p90 ms");
    let mut least = [0.0; SIZES.len()];
    let starts = [
        ("standing", Task::S01, 0),
        ("before the ladder", Task::S02, 0),
        ("on the ladder", Task::S03, 0),
        ("with a bulb, on it", Task::S11, 4),
        ("at the bench", Task::S08, 0),
        ("at the crate", Task::S06, 0),
    ];
    for (name, task, seed) in starts {
        let spec = SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
        let world = start(Arc::clone(&scene), task, 0, &StartOptions::default())?;
        let visuals = Visuals::with_robot(&scene, meshes.as_ref());
        for ([width, height], least) in SIZES.into_iter().zip(&mut least) {
            let mut renderer = Renderer::new(width, height);
            let camera = Camera::head(&robot, world.row())?.fitted(width, height);
            let mut times: Vec<f64> = (0..FRAMES)
                .map(|_| {
                    let begun = Instant::now();
                    black_box(renderer.render(&visuals, world.row(), &camera, &light));
                    begun.elapsed().as_secs_f64() * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            let size = format!("{width}x{height}");
            println!("{name:24} {size:>9} {:8.3} {:8.3} {:8.3}", times[0], times[FRAMES / 2], times[FRAMES * 9 / 10]);
            *least += times[0] / starts.len() as f64;
        }
    }
    for ([width, height], least) in SIZES.into_iter().zip(least) {
        println!("{width}x{height}: {:.0} pictures a second by the least times", 1e3 / least);
    }
    Ok(())
}
