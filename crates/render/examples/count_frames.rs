//! Draws a picture of the head camera in each of six start states, for a program that counts instructions
//! (`.ci/instructions.py`).
//!
//! ```text
//! cargo run -p fiatlux-render --example count_frames -- WIDTH HEIGHT
//! ```
use std::error::Error;
use std::hint::black_box;
use std::sync::Arc;

use fiatlux_render::{Camera, Lighting, Renderer, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};

fn main() -> Result<(), Box<dyn Error>> {
    let sides = std::env::args().skip(1).map(|side| side.parse()).collect::<Result<Vec<usize>, _>>()?;
    let [width, height] = sides[..] else { return Err("usage: count_frames WIDTH HEIGHT".into()) };
    let robot = Arc::new(Robot::benchmark()?);
    let light = Lighting::default();
    let mut renderer = Renderer::new(width, height);
    for (task, seed) in [(Task::S01, 0), (Task::S02, 0), (Task::S03, 0), (Task::S11, 4), (Task::S08, 0), (Task::S06, 0)]
    {
        let spec = SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
        let world = start(Arc::clone(&scene), task, 0, &StartOptions::default())?;
        let camera = Camera::head(&robot, world.row())?.fitted(width, height);
        black_box(renderer.render(&Visuals::new(&scene), world.row(), &camera, &light));
    }
    Ok(())
}
