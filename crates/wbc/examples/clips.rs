//! Contact sheets of some short clips of the controller; the tilt of feet that bear a load, the distance between two of them to
//! the side, and the lean of the torso.
//!
//!     cargo run --release -p fiatlux-wbc --example clips -- OUT_DIR [WEIGHTS.safetensors]
#![allow(clippy::unwrap_used)]

mod play;

use fiatlux_rules::errand;
use std::path::Path;
use std::sync::Arc;

use fiatlux_dynamics::Wrench;
use fiatlux_render::{Camera, Image, Lighting, Renderer, Visuals};
use fiatlux_wbc::{BodyCommand, Network, Swing};
use fiatlux_world::{AppliedWrench, Push, Target};
use nalgebra::Vector3;

use play::{Play, floor};

/// Size of a picture, pixels, and pictures in a row of a sheet.
const SIZE: [usize; 2] = [240, 300];
const IN_A_ROW: usize = 8;
const PICTURES: usize = 24;
/// A foot that bears more than this, N, counts.
const LOADED_N: f64 = 50.0;

/// A clip: control steps that are played before it, control steps between two pictures, and the velocity at each step.
struct Clip {
    name: &'static str,
    before: usize,
    every: usize,
    velocity: fn(usize) -> [f64; 3],
    /// Weight in the right hand, kg.
    load_kg: f64,
    /// A jump of the velocity, m/s, at the first picture.
    push: Option<[f64; 2]>,
}

const STANDING: Clip =
    Clip { name: "standing", before: 250, every: 4, velocity: |_| [0.0; 3], load_kg: 0.0, push: None };

const CLIPS: [Clip; 6] = [
    STANDING,
    Clip { name: "walking", before: 150, velocity: |_| [0.8, 0.0, 0.0], ..STANDING },
    Clip { name: "turning", before: 150, every: 6, velocity: |_| [0.0, 0.0, 0.8], ..STANDING },
    Clip {
        name: "stopping",
        before: 190,
        every: 5,
        velocity: |step| if step < 200 { [0.6, 0.0, 0.0] } else { [0.0; 3] },
        ..STANDING
    },
    Clip { name: "carrying", before: 150, every: 5, velocity: |_| [0.5, 0.0, 0.3], load_kg: 1.0, ..STANDING },
    Clip { name: "push", before: 150, push: Some([0.3, 1.0]), ..STANDING },
];

fn main() {
    let out = std::env::args().nth(1).unwrap_or_else(|| "target/clips".into());
    std::fs::create_dir_all(&out).unwrap();
    let network = std::env::args().nth(2).map_or_else(Network::shipped, |file| Network::read(Path::new(&file)));
    let (scene, network) = (floor(), Arc::new(network.unwrap()));
    let visuals = Visuals::for_people(&scene, None);
    let mut renderer = Renderer::supersampled(SIZE[0], SIZE[1], 2);
    println!(
        "{:10}{:>11}{:>11}{:>11}{:>11}{:>11}",
        "clip", "roll, rad", "pitch, rad", "apart, m", "torso, rad", "pelvis, m"
    );
    for clip in CLIPS {
        let mut play = Play::new(&scene, &network, 1, false);
        let (mut swing, is_free) = (Swing::new(&play.targets), [true, clip.load_kg == 0.0]);
        if clip.load_kg > 0.0 {
            let wrench = Wrench { force: -9.81 * clip.load_kg * Vector3::z(), torque: Vector3::zeros() };
            play.wrenches.push(AppliedWrench { target: Target::Link(scene.robot.palms()[1]), point: None, wrench });
        }
        let mut sheet = Image::black(SIZE[0] * IN_A_ROW, SIZE[1] * PICTURES.div_ceil(IN_A_ROW));
        // Of the soles that bear a load: number, sums of the magnitudes of roll and pitch.
        let (mut loaded, mut tilt) = (0, [0.0; 2]);
        // Of the steps on both feet: number, sum of their distance to the side. Of all steps: sum of the torso's pitch.
        let (mut on_both, mut apart, mut lean) = (0, 0.0, 0.0);
        for step in 0..clip.before + clip.every * PICTURES {
            if step == clip.before {
                play.push = clip.push.map(|[x, y]| Push { linear: Vector3::new(x, y, 0.0), angular: Vector3::zeros() });
            }
            let command = BodyCommand { velocity: (clip.velocity)(step), ..BodyCommand::default() };
            swing.step(&command, play.controller.stride(), is_free, &mut play.targets);
            assert!(play.step(&command).is_some(), "{} falls at step {step}", clip.name);
            let row = play.world.row();
            if step >= clip.before {
                lean += play.torso()[1];
                if row.load(errand::FLOOR_LOAD).iter().take(2).all(|load| *load > LOADED_N) {
                    apart += play.feet_apart();
                    on_both += 1;
                }
            }
            for (foot, load) in scene.robot.feet().iter().zip(row.load(errand::FLOOR_LOAD)) {
                if *load > LOADED_N && step >= clip.before {
                    let up = play.world.world_from_link(*foot).rotation.inverse() * Vector3::z();
                    tilt[0] += up.y.abs();
                    tilt[1] += up.x.abs();
                    loaded += 1;
                }
            }
            if let Some(since) = step.checked_sub(clip.before).filter(|since| since.is_multiple_of(clip.every)) {
                let mut target = row.robot.pose.translation.vector;
                target.z = 0.65;
                let camera = Camera::look_at(
                    target + Vector3::new(1.6, -2.6, 0.35),
                    target,
                    0.55,
                    SIZE[0] as f64 / SIZE[1] as f64,
                );
                let picture = renderer.render(&visuals, row, &camera, &Lighting::default());
                let index = since / clip.every;
                sheet.paste(picture, SIZE[0] * (index % IN_A_ROW), SIZE[1] * (index / IN_A_ROW));
            }
        }
        let [roll, pitch] = tilt.map(|sum| sum / f64::from(loaded.max(1)));
        let (apart, lean) = (apart / f64::from(on_both.max(1)), lean / (clip.every * PICTURES) as f64);
        let pelvis = play.world.row().robot.pose.translation.z;
        println!("{:10}{roll:>11.3}{pitch:>11.3}{apart:>11.3}{lean:>11.3}{pelvis:>11.3}", clip.name);
        std::fs::write(Path::new(&out).join(format!("{}.png", clip.name)), sheet.to_png().unwrap()).unwrap();
    }
}
