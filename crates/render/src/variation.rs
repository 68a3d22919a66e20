//! Pictures that differ from the benchmark's: where a camera is, how it sees, and what covers floor and walls.
//!
//! All of it is added to a finished picture, so that one without variation is drawn as ever.

use fiatlux_world::{CameraVariation, Random, Stream};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};

use crate::paint::{Paint, encode, linear};
use crate::single::{Vec3, add, floor, scale};
use crate::view::View;
use crate::{Camera, Renderer};

/// Widest angle of view of a varied camera, rad.
const WIDEST: f64 = 2.8;
/// Share of the brightness that the dark parts of a pattern lose.
const DARKER: f32 = 0.4;

impl Camera {
    /// The camera shifted, turned and with the angle of view of a variation, for a square picture.
    #[must_use]
    pub fn varied(mut self, variation: &CameraVariation) -> Self {
        let [x, y, z] = variation.shift;
        let [roll, pitch, yaw] = variation.turn;
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        self.world_from_camera *= Isometry3::from_parts(Translation3::new(x, y, z), turn);
        let angle = (self.horizontal_fov * variation.angle).min(WIDEST);
        (self.horizontal_fov, self.vertical_fov) = (angle, angle);
        self
    }
}

impl Renderer {
    /// Varies the picture that [`Renderer::render`] drew last, as [`Renderer::vary`] does.
    pub fn vary_image(&mut self, camera: &Camera, variation: &CameraVariation, name: &str, step: u64) {
        let mut rgb = std::mem::take(&mut self.image.rgb);
        self.vary(&mut rgb, camera, variation, name, step);
        self.image.rgb = rgb;
    }

    /// Varies the bytes of the picture that was drawn last with this camera: colours and patterns, then exposure, blur and noise. The
    /// noise is of the camera's name and the step. For one sample a pixel.
    pub fn vary(&self, rgb: &mut [u8], camera: &Camera, variation: &CameraVariation, name: &str, step: u64) {
        let (seed, episode) = variation.stream;
        if variation.colours > 0.0 || variation.pattern > 0 {
            let mut random = Random::of_term(Stream::Ranges, "camera.colours of paints", seed, episode);
            let share = variation.colours;
            let factors = Paint::ALL.map(|_| [(); 3].map(|()| (1.0 + random.uniform(-share, share)) as f32));
            self.colour(rgb, &View::new(camera, self.size()), &factors, variation.pattern);
        }
        if variation.exposure != 0.0 {
            let gain = libm::exp2(variation.exposure);
            let exposed: [u8; 256] = std::array::from_fn(|byte| encode(f64::from(linear(byte as u8)) * gain));
            rgb.iter_mut().for_each(|byte| *byte = exposed[usize::from(*byte)]);
        }
        if variation.blur > 0.0 {
            blur(rgb, self.size(), variation.blur);
        }
        if variation.noise > 0.0 {
            let mut random = Random::of_term(Stream::Ranges, &format!("camera.noise {name} {step}"), seed, episode);
            for byte in rgb {
                let noise = random.uniform(-variation.noise, variation.noise);
                // Saturates.
                *byte = (f64::from(*byte) + noise + 0.5) as u8;
            }
        }
    }

    /// Multiplies each paint by its factors, and floor and walls by a pattern.
    fn colour(&self, rgb: &mut [u8], view: &View, factors: &[Vec3; Paint::ALL.len()], pattern: usize) {
        let [width, _] = self.size();
        for (at, pixel) in rgb.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let Some(surface) = self.surfaces.get(self.ids[at] as usize) else { continue };
            let mut factor = factors[surface.paint as usize];
            if pattern > 0 && matches!(surface.paint, Paint::Floor | Paint::Wall) {
                let (x, y) = (at % width, at / width);
                let point = add(view.eye, scale(view.ray(x, y), 1.0 / self.depth[at]));
                let normal = surface.normal_at(x, y);
                let place = match surface.paint {
                    Paint::Floor => [point[0], point[1]],
                    _ if normal[0].abs() > normal[1].abs() => [point[1], point[2]],
                    _ => [point[0], point[2]],
                };
                factor = scale(factor, 1.0 - DARKER * darkness(pattern, place));
            }
            for (byte, factor) in pixel.iter_mut().zip(factor) {
                *byte = (f32::from(*byte) * factor + 0.5) as u8;
            }
        }
    }
}

/// Darkness, from 0 to 1, of a pattern at a place, m.
fn darkness(pattern: usize, [a, b]: [f32; 2]) -> f32 {
    let odd = |x: f32| {
        let half = 0.5 * floor(x);
        2.0 * (half - floor(half))
    };
    let part = |x: f32| x - floor(x);
    let is = |holds: bool| f32::from(u8::from(holds));
    let differ = |one: f32, other: f32| is(one != other);
    match pattern {
        // Checks.
        1 => differ(odd(a * 4.0), odd(b * 4.0)),
        // Stripes.
        2 => odd(b * 5.0),
        // Planks, each row shifted.
        3 => 0.25 * (1.0 + 2.0 * odd(b * 6.0)) + 0.25 * odd(a * 0.8 + 0.5 * floor(b * 6.0)),
        // Bricks with joints.
        4 => is(part(b * 8.0) > 0.1 && part(a * 4.0 + 0.5 * odd(b * 8.0)) > 0.05),
        // Dots.
        5 => {
            let (x, y) = (part(a * 3.0) - 0.5, part(b * 3.0) - 0.5);
            is(x * x + y * y < 0.09)
        }
        // Diamonds.
        6 => differ(odd((a + b) * 3.0), odd((a - b) * 3.0)),
        // Waves.
        7 => odd(b * 4.0 + (part(a * 2.0) - 0.5).abs()),
        // Blots: a number for each cell, smooth in between.
        _ => {
            let (x, y) = (a * 3.0, b * 3.0);
            let (left, low) = (floor(x), floor(y));
            let at = |i: f32, j: f32| cell(left + i, low + j);
            let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
            let (u, v) = (smooth(x - left), smooth(y - low));
            let [below, above] = [0.0, 1.0].map(|j| at(0.0, j) + u * (at(1.0, j) - at(0.0, j)));
            below + v * (above - below)
        }
    }
}

/// A number from 0 to 1 for a cell of the plane.
fn cell(x: f32, y: f32) -> f32 {
    let mix = (x as i32 as u32).wrapping_mul(0x9e37_79b1) ^ (y as i32 as u32).wrapping_mul(0x85eb_ca6b);
    let mix = (mix ^ mix >> 15).wrapping_mul(0xc2b2_ae35);
    ((mix ^ mix >> 13) & 0xffff) as f32 / 65_535.0
}

/// Blurs by a Gaussian; beyond the edges the picture goes on with its border.
fn blur(rgb: &mut [u8], [width, height]: [usize; 2], deviation: f64) {
    let reach = (3.0 * deviation).ceil() as usize;
    let weight = |offset: usize| libm::exp(-0.5 * (offset as f64 / deviation) * (offset as f64 / deviation));
    let total = (1..=reach).map(|offset| 2.0 * weight(offset)).sum::<f64>() + 1.0;
    let weights: Vec<f32> = (0..=reach).map(|offset| (weight(offset) / total) as f32).collect();
    let mean = |length: usize, at: usize, read: &dyn Fn(usize) -> f32| {
        let sides =
            weights.iter().enumerate().skip(1).map(|(offset, weight)| {
                weight * (read(at.saturating_sub(offset)) + read((at + offset).min(length - 1)))
            });
        weights[0] * read(at) + sides.sum::<f32>()
    };
    let mut across = vec![0.0; rgb.len()];
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let read = |x: usize| f32::from(rgb[3 * (y * width + x) + channel]);
                across[3 * (y * width + x) + channel] = mean(width, x, &read);
            }
        }
    }
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let read = |y: usize| across[3 * (y * width + x) + channel];
                rgb[3 * (y * width + x) + channel] = (mean(height, y, &read) + 0.5) as u8;
            }
        }
    }
}
