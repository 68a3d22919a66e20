#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::Task;
use fiatlux_world::{Scene, SceneConfig, SceneKind, SceneSpec, StartOptions, start};
use sha2::{Digest, Sha256};

use super::*;

/// SHA-256 of the pictures below: the look of the benchmark. Another one is another version of it.
const LOOK: &str = "48ec1fdb0b686451fd16005246556bd90e78ea95e920dfba1dd17aea42d7a2f4";

fn digest(level: Level) -> String {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let mut sum = Sha256::new();
    for (task, seed) in [(Task::S01, 0), (Task::S03, 0), (Task::S08, 2), (Task::S11, 4)] {
        let spec = SceneSpec::new(SceneKind::of(task), seed, robot.gains(GainSet::Fiatlux));
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap());
        let world = start(Arc::clone(&scene), task, 0, &StartOptions::default()).unwrap();
        let visuals = Visuals::new(&scene);
        let light = Lighting::default().with_key_turned(0.1, seed as f64);
        for [width, height] in [[64, 64], [128, 128], [61, 47]] {
            let mut renderer = Renderer { level, ..Renderer::new(width, height) };
            for name in ["head_camera", "chest_camera", "left_wrist_camera"] {
                let camera = Camera::mounted(&robot, name, world.row()).unwrap().fitted(width, height);
                sum.update(renderer.render(&visuals, world.row(), &camera, &light).rgb());
                for at in 0..width * height {
                    let (x, y) = (at % width, at / width);
                    sum.update(renderer.depth(x, y).unwrap_or(-1.0).to_bits().to_le_bytes());
                    sum.update(format!("{:?}", renderer.owner(x, y)));
                }
            }
        }
    }
    data_encoding::HEXLOWER.encode(&sum.finalize())
}

/// Guards that pictures and distances are the benchmark's on every processor: SSE2, AVX2 and the best that this one has.
#[test]
fn the_look_is_the_same_on_every_level_of_instructions() {
    assert_eq!(digest(Level::baseline()), LOOK);
    assert_eq!(digest(Level::new()), LOOK);
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = Level::new().as_avx2() {
        assert_eq!(digest(Level::Avx2(avx2)), LOOK);
    }
}

/// Rooms of many worlds are in memory at once, and fine meshes are most of what one takes.
#[test]
fn meshes_for_the_robots_cameras_are_coarse_alone() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = SceneSpec::new(SceneKind::of(Task::S01), 0, robot.gains(GainSet::Fiatlux));
    let scene = Scene::build(&SceneConfig::default(), robot, spec).unwrap();
    let shared = |visuals: Visuals| {
        let [fine, coarse] = [Detail::Fine, Detail::Coarse].map(|detail| visuals.meshes(detail).to_vec());
        fine.iter().zip(&coarse).filter(|(fine, coarse)| Arc::ptr_eq(fine, coarse)).count()
    };
    let sensors = Visuals::new(&scene);
    let count = sensors.meshes(Detail::Coarse).len();
    assert!(count > 30 && shared(sensors) == count);
    assert_eq!(shared(Visuals::for_people(&scene, None)), 0);
}
