//! Light on one pixel.

use crate::lighting::PreparedLight;
use crate::paint::{Finish, Paint, encode};

pub(crate) type Vec3 = [f32; 3];

#[inline]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
pub(crate) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline]
pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub(crate) fn scale(a: Vec3, by: f32) -> Vec3 {
    [a[0] * by, a[1] * by, a[2] * by]
}

#[inline]
fn product(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline]
pub(crate) fn mix(a: Vec3, b: Vec3, share: f32) -> Vec3 {
    add(a, scale(sub(b, a), share))
}

#[inline]
pub(crate) fn normalize(a: Vec3) -> Vec3 {
    scale(a, 1.0 / dot(a, a).max(1e-30).sqrt())
}

/// The next whole number below; for values within +-2^31.
#[inline]
pub(crate) fn floor(x: f32) -> f32 {
    let whole = x as i32 as f32;
    if whole > x { whole - 1.0 } else { whole }
}

/// Light of the dome from above, from below (off the floor), and how much its brighter side adds; linear.
const SKY: Vec3 = [0.97, 1.0, 1.05];
const GROUND: Vec3 = [0.56, 0.54, 0.51];
const SIDE: f32 = 0.14;
/// What stands behind everything, low and high.
const HAZE: [Vec3; 2] = [[0.60, 0.65, 0.71], [0.70, 0.78, 0.88]];
/// The floor fades into the haze between these distances from the world's origin, m.
const FADE: [f32; 2] = [6.5, 13.0];
/// Side of a floor tile and width of a joint between tiles, m.
const TILE: f32 = 0.5;
const GROUT: f32 = 0.006;
/// Height of the skirting on the walls, m.
const SKIRTING: f32 = 0.09;
/// Exposure before the tone curve.
const EXPOSURE: f32 = 0.92;

/// What lights a pixel and how it is seen.
pub(crate) struct Spot {
    pub point: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Unit vector from the eye.
    pub ray: Vec3,
    /// Width of the pixel on a surface that faces it, m.
    pub footprint: f32,
    /// Share of the dome that is not occluded.
    pub open: f32,
    /// Share of the key light that arrives.
    pub lit: f32,
}

/// Colours and light of one frame.
pub(crate) struct Shader<'a> {
    pub light: &'a PreparedLight,
    pub finishes: &'a [Finish],
}

impl Shader<'_> {
    /// Linear colour of a lit spot.
    pub(crate) fn colour(&self, paint: Paint, spot: &Spot) -> Vec3 {
        let finish = &self.finishes[paint as usize];
        let light = self.light;
        let mut base = finish.colour;
        match paint {
            Paint::Floor => base = scale(base, tiles(spot)),
            Paint::Wall if spot.point[2] < SKIRTING => base = scale(base, 0.62),
            _ => {}
        }
        if finish.tinted {
            base = product(base, light.room_tint);
        }
        let n = spot.normal;
        let up = 0.5 + 0.5 * n[2];
        let side = 1.0 + SIDE * (n[0] * light.dome_side[0] + n[1] * light.dome_side[1]);
        let dome = scale(mix(GROUND, SKY, up), light.dome * side * spot.open);
        let facing = dot(n, light.towards_key).max(0.0);
        let key = scale(light.key, facing * spot.lit);
        let glow = finish.glow;
        let mut colour = product(base, add(add(dome, key), [glow; 3]));
        if finish.mirror > 0.0 {
            let back = -dot(n, spot.ray);
            let mirrored = add(spot.ray, scale(n, 2.0 * back));
            let grazing = 1.0 - back.clamp(0.0, 1.0);
            let grazing = grazing * grazing * grazing * grazing * grazing;
            let mirror = finish.mirror + (1.0 - finish.mirror) * 0.5 * grazing;
            let sky = (0.5 + 0.9 * mirrored[2]).clamp(0.0, 1.0);
            let room = scale(mix(GROUND, SKY, sky * sky * (3.0 - 2.0 * sky)), light.dome * spot.open * mirror * 1.6);
            let mut shine = dot(mirrored, light.towards_key).max(0.0);
            if shine > 0.5 {
                for _ in 0..finish.sharpness {
                    shine *= shine;
                }
            } else {
                shine = 0.0;
            }
            // A sharper highlight is a brighter one.
            let gain = 0.12 * f32::from(1_u16 << finish.sharpness) * mirror.min(0.2) * spot.lit;
            let shine = shine * gain;
            colour = add(add(colour, room), scale(light.key, shine));
        }
        if paint == Paint::Floor {
            let from_origin = (spot.point[0] * spot.point[0] + spot.point[1] * spot.point[1]).sqrt();
            let away = ((from_origin - FADE[0]) / (FADE[1] - FADE[0])).clamp(0.0, 1.0);
            colour = mix(colour, self.haze(spot.ray), away * away * (3.0 - 2.0 * away));
        }
        colour
    }

    /// What is seen where nothing is.
    pub(crate) fn haze(&self, ray: Vec3) -> Vec3 {
        let up = (ray[2] * 2.0).clamp(0.0, 1.0);
        scale(mix(HAZE[0], HAZE[1], up), self.light.dome + 0.25 * self.light.key[1])
    }
}

/// Brightness of the tiled floor, smoothed over the pixel.
fn tiles(spot: &Spot) -> f32 {
    let slant = (-dot(spot.normal, spot.ray)).max(0.05);
    let width = spot.footprint / slant;
    let cover = |x: f32| {
        let from_joint = x - TILE * floor(x / TILE + 0.5);
        let (low, high) = (from_joint - width / 2.0, from_joint + width / 2.0);
        ((high.min(GROUT / 2.0) - low.max(-GROUT / 2.0)) / width).clamp(0.0, 1.0)
    };
    let joint = cover(spot.point[0]).max(cover(spot.point[1]));
    let number = |x: f32| floor(x / TILE) as i32;
    let odd = (number(spot.point[0]) + number(spot.point[1])) & 1;
    let checker = if odd == 0 { 1.0 } else { 1.0 - 0.05 * (1.0 - width / TILE).max(0.0) };
    checker * (1.0 - 0.35 * joint)
}

/// From linear light to 8-bit sRGB by way of a curve with a soft toe and shoulder.
#[derive(Debug, Clone)]
pub(crate) struct Tone {
    /// The curve, by the upper bits of the number: finer where it is darker, as the eye is.
    curve: Vec<f32>,
    /// sRGB of the curve's value.
    bytes: Vec<u8>,
    /// sRGB, by the square root of a mean of the curve's values.
    of_mean: Vec<u8>,
}

impl Tone {
    /// Steps within each doubling of light, as bits.
    const FINE: u32 = 9;
    /// Least and largest light that differ from what is beyond them, as exponents of their numbers.
    const RANGE: [u32; 2] = [127 - 12, 127 + 5];

    const FIRST: u32 = Self::RANGE[0] << Self::FINE;

    pub(crate) fn new() -> Self {
        let steps = (Self::RANGE[1] - Self::RANGE[0]) << Self::FINE;
        let curve: Vec<f32> = (0..steps)
            .map(|k| {
                let x = f32::from_bits((Self::FIRST + k) << (23 - Self::FINE)) * EXPOSURE;
                (x * (1.9 * x + 0.18) / (x * (1.75 * x + 0.85) + 0.16)).min(1.0)
            })
            .collect();
        let bytes = curve.iter().map(|c| encode(f64::from(*c))).collect();
        let of_mean = (0..4096).map(|k| encode((f64::from(k) / 4095.0) * (f64::from(k) / 4095.0))).collect();
        Self { curve, bytes, of_mean }
    }

    #[inline]
    fn index(&self, light: f32) -> usize {
        // Less than nothing, and what is no number, count as dark.
        let bits = light.max(0.0).to_bits() >> (23 - Self::FINE);
        (bits.saturating_sub(Self::FIRST) as usize).min(self.curve.len() - 1)
    }

    /// The curve's values, in [0, 1].
    pub(crate) fn curve(&self, light: Vec3) -> Vec3 {
        light.map(|c| self.curve[self.index(c)])
    }

    /// sRGB of the curve's value.
    #[inline]
    pub(crate) fn byte(&self, light: f32) -> u8 {
        self.bytes[self.index(light)]
    }

    /// sRGB of a mean of the curve's values.
    pub(crate) fn byte_of_mean(&self, mean: f32) -> u8 {
        self.of_mean[((mean.max(0.0).sqrt() * 4095.0) as usize).min(4095)]
    }
}
