//! Writes pictures of some start states: a view from beside and the head camera's.
//!
//! ```text
//! cargo run --release -p fiatlux-render --example stills -- OUT_DIR
//! ```

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use fiatlux_render::{Camera, HEAD_PIXELS, Image, Lighting, Renderer, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};
use nalgebra::Vector3;

/// Task, layout seed, and where the camera stands from what it looks at: bearing from the robot's heading (degrees),
/// height above the middle (m), vertical field of view (degrees).
const STILLS: &[(Task, u64, f64, f64, f64)] = &[
    (Task::S02, 0, 70.0, 0.5, 36.0),
    (Task::S03, 0, 75.0, 0.3, 36.0),
    (Task::S05, 0, 150.0, 0.8, 36.0),
    (Task::S08, 0, 120.0, 0.7, 36.0),
    (Task::S10, 0, 60.0, 0.4, 36.0),
    (Task::S11, 0, 75.0, 0.2, 36.0),
    (Task::S12, 0, 75.0, 0.2, 36.0),
];

fn main() -> Result<(), Box<dyn Error>> {
    let out = std::env::args().nth(1).unwrap_or_else(|| "target/stills".into());
    let out = Path::new(&out);
    std::fs::create_dir_all(out)?;
    let robot = Arc::new(Robot::g1_inspire()?);
    let light = Lighting::default();
    let mut still = Renderer::supersampled(1280, 960, 2);
    let mut eye = Renderer::new(HEAD_PIXELS, HEAD_PIXELS);
    for &(task, seed, bearing, rise, fov) in STILLS {
        let spec =
            SceneSpec { kind: SceneKind::of(task), seed, gains: robot.gains(GainSet::Fiatlux), hand_friction: None };
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
        let world = start(Arc::clone(&scene), task, 0, &StartOptions::default())?;
        let (row, visuals) = (world.row(), Visuals::new(&scene));

        // Robot, ladder and fixture in one picture.
        let (pelvis, ladder) = (row.robot.pose.translation.vector, row.ladder.pose.translation.vector);
        let fixture = row.fixture.translation.vector;
        let heading = row.robot.pose.rotation * Vector3::x();
        let yaw = libm::atan2(heading.y, heading.x) + bearing.to_radians();
        let low = pelvis.inf(&ladder).inf(&fixture);
        let high = pelvis.sup(&ladder).sup(&fixture);
        let mut target = (low + high) / 2.0;
        target.z = (high.z + 0.5) / 2.0;
        let radius = 0.5 * (Vector3::new(high.x, high.y, high.z + 0.35) - Vector3::new(low.x, low.y, 0.0)).norm();
        let away = radius / libm::sin(fov.to_radians() / 2.0);
        let eye_at = target + Vector3::new(libm::cos(yaw) * away, libm::sin(yaw) * away, rise);
        let camera = Camera::look_at(eye_at, target, fov.to_radians(), 4.0 / 3.0);
        write(out, &format!("{}_{seed}", task.id()), still.render(&visuals, row, &camera, &light))?;
        let head = Camera::head(&robot, row)?;
        write(out, &format!("{}_{seed}_head", task.id()), eye.render(&visuals, row, &head, &light))?;
    }
    Ok(())
}

fn write(out: &Path, name: &str, image: &Image) -> Result<(), Box<dyn Error>> {
    let path = out.join(format!("{name}.png"));
    std::fs::write(&path, image.to_png()?)?;
    println!("{}", path.display());
    Ok(())
}
