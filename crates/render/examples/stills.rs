//! Writes pictures of some start states: a view from the side, and what the head camera sees; with a second folder, of
//! the robot in its meshes.
//!
//! ```text
//! cargo run --release -p fiatlux-render --example stills -- OUT_DIR [MESHES]
//! ```
//!
//! The first of them, `robot_on_ladder.png`, is the one in `docs/`.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use fiatlux_render::{Camera, HEAD_PIXELS, Image, Lighting, Renderer, RobotMeshes, Visuals};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};
use nalgebra::Vector3;

/// A view. Bearings are in degrees from the robot's heading, distances in metres.
struct Still {
    name: &'static str,
    task: Task,
    seed: u64,
    /// Distance of the camera from its target, its bearing and its height.
    away: f64,
    bearing: f64,
    height: f64,
    /// Target: distance ahead of the robot, and height.
    ahead: f64,
    target_height: f64,
    /// Vertical field of view, degrees.
    fov: f64,
    /// Yaw of the key light, degrees.
    light: f64,
}

const fn still(name: &'static str, task: Task, seed: u64, view: [f64; 7]) -> Still {
    let [away, bearing, height, ahead, target_height, fov, light] = view;
    Still { name, task, seed, away, bearing, height, ahead, target_height, fov, light }
}

const STILLS: &[Still] = &[
    still("robot_on_ladder", Task::S11, 4, [4.0, -66.0, 2.4, 0.30, 1.33, 39.0, -30.0]),
    still("climb_ladder", Task::S02, 4, [4.2, -60.0, 2.2, 0.45, 1.15, 38.0, -30.0]),
    still("remove_old_bulb", Task::S03, 5, [3.6, -38.0, 2.1, 0.10, 1.40, 41.0, 60.0]),
    still("carry_to_disposal", Task::S05, 4, [4.4, 70.0, 2.0, 0.40, 0.95, 38.0, -30.0]),
    still("grab_new_bulb", Task::S08, 0, [3.2, 65.0, 1.9, 0.40, 0.80, 36.0, 0.0]),
    still("climb_with_bulb", Task::S10, 4, [4.2, -60.0, 2.2, 0.45, 1.15, 38.0, -30.0]),
    still("bulb_in_place", Task::S12, 5, [3.6, -38.0, 2.1, 0.10, 1.40, 41.0, 60.0]),
];

fn main() -> Result<(), Box<dyn Error>> {
    let out = std::env::args().nth(1).unwrap_or_else(|| "target/stills".into());
    let out = Path::new(&out);
    std::fs::create_dir_all(out)?;
    let robot = Arc::new(Robot::benchmark()?);
    let meshes = std::env::args().nth(2).map(|folder| RobotMeshes::open(folder, &robot)).transpose()?;
    let mut large = Renderer::supersampled(1280, 960, 3);
    let mut eye = Renderer::new(HEAD_PIXELS, HEAD_PIXELS);
    for still in STILLS {
        let spec = SceneSpec::new(SceneKind::of(still.task), still.seed, robot.gains(GainSet::Fiatlux));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
        let world = start(Arc::clone(&scene), still.task, 0, &StartOptions::default())?;
        let (row, visuals) = (world.row(), Visuals::for_people(&scene, meshes.as_ref()));

        let heading = row.robot.pose.rotation * Vector3::x();
        let yaw = libm::atan2(heading.y, heading.x);
        let flat = |angle: f64, length: f64| Vector3::new(libm::cos(angle), libm::sin(angle), 0.0) * length;
        let mut target = row.robot.pose.translation.vector + flat(yaw, still.ahead);
        target.z = still.target_height;
        let mut from = target + flat(yaw + still.bearing.to_radians(), still.away);
        from.z = still.height;
        let camera = Camera::look_at(from, target, still.fov.to_radians(), 4.0 / 3.0);
        let light = Lighting::default().with_key_turned(0.0, still.light.to_radians());
        write(out, still.name, large.render(&visuals, row, &camera, &light))?;
        let head = Camera::head(&robot, row)?;
        write(out, &format!("{}_head", still.name), eye.render(&visuals, row, &head, &light))?;
    }
    Ok(())
}

fn write(out: &Path, name: &str, image: &Image) -> Result<(), Box<dyn Error>> {
    let path = out.join(format!("{name}.png"));
    std::fs::write(&path, image.to_png()?)?;
    println!("{}", path.display());
    Ok(())
}
