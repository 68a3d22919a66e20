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

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Arc::new(Robot::g1_inspire()?);
    let mut still = Renderer::supersampled(640, 480, 2);
    let args: Vec<String> = std::env::args().skip(1).collect();
    for a in args {
        let f: Vec<&str> = a.split(',').collect();
        let task = Task::ALL.into_iter().find(|t| t.id().contains(f[0])).unwrap();
        let n: Vec<f64> = f[1..].iter().map(|v| v.parse().unwrap()).collect();
        let [seed, bearing, dist, eye_z, tz, fov, tx, pitch, yaw] = n[..] else { panic!() };
        let spec = SceneSpec {
            kind: SceneKind::of(task),
            seed: seed as u64,
            gains: robot.gains(GainSet::Fiatlux),
            hand_friction: None,
        };
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec)?);
        let world = start(Arc::clone(&scene), task, 0, &StartOptions::default())?;
        let (row, visuals) = (world.row(), Visuals::new(&scene));
        let p = row.robot.pose.translation.vector;
        let h = row.robot.pose.rotation * Vector3::x();
        let base = libm::atan2(h.y, h.x);
        let az = base + bearing.to_radians();
        let target = Vector3::new(p.x + tx * libm::cos(base), p.y + tx * libm::sin(base), tz);
        let eye = Vector3::new(target.x + dist * libm::cos(az), target.y + dist * libm::sin(az), eye_z);
        let camera = Camera::look_at(eye, target, fov.to_radians(), 4.0 / 3.0);
        let light = Lighting::default().with_key_turned(pitch.to_radians(), yaw.to_radians());
        println!(
            "{:?} base {:.0} pos {:.2} {:.2} ladder {:?}",
            scene.layout.mount,
            base.to_degrees(),
            p.x,
            p.y,
            row.ladder.pose.translation.vector.as_slice()
        );
        let name = a.replace(',', "_");
        let image: &Image = still.render(&visuals, row, &camera, &light);
        std::fs::write(Path::new("/tmp/ex").join(format!("{name}.png")), image.to_png()?)?;
    }
    Ok(())
}
