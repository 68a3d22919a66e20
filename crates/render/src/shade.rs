//! Light on one pixel.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::lighting::PreparedLight;
use crate::paint::{Finish, Paint};
use crate::people::Touches;
use crate::single::{Vec3, add, dot, floor, mix, normalize, product, scale, single, sub};
use crate::spot::{GROUT, MIN_SLANT, SKIRTING, Spot, TILE};

/// Light of the dome from above, from below (off the floor), and how much its brighter side adds; linear.
pub(crate) const SKY: Vec3 = [0.97, 1.0, 1.05];
pub(crate) const GROUND: Vec3 = [0.56, 0.54, 0.51];
pub(crate) const SIDE: f32 = 0.14;
/// Colours of the haze behind everything, low and high.
pub(crate) const HAZE: [Vec3; 2] = [[0.60, 0.65, 0.71], [0.70, 0.78, 0.88]];
/// The floor fades into the haze between these distances from the world's origin, m.
pub(crate) const FADE: [f32; 2] = [6.5, 13.0];
/// For people, mirrors show a darker ground, and a bright band between two heights of the ray, as of windows.
const DARK: Vec3 = [0.30, 0.29, 0.28];
const BAND: f32 = 1.1;
const BAND_AT: [f32; 2] = [0.12, 0.5];

/// Share of the bright band that a ray of that rise shows.
fn band(rise: f32) -> f32 {
    let at = ((rise - BAND_AT[0]) / (BAND_AT[1] - BAND_AT[0])).clamp(0.0, 1.0);
    let share = 4.0 * at * (1.0 - at);
    share * share
}

/// The light of a burning bulb. It passes through what stands in its way, but for the lamp's shade.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lamp {
    /// Middle of the glass, world, m.
    middle: Vec3,
    /// Unit vector out of the socket.
    out: Vec3,
}

impl Lamp {
    /// Middle of the glass above the bulb's root, m.
    const GLASS: f64 = 0.152;
    /// Colour of its light, linear.
    const WARM: Vec3 = [1.0, 0.78, 0.48];
    /// Light on a surface that faces it, at 1 m; the nominal key light gives 1.55.
    const STRENGTH: f32 = 1.5;
    /// Radius within which its light no longer grows, m.
    const RADIUS: f32 = 0.14;
    /// Cosine, from the way out of the socket, beyond which the shade takes its light, and how far that reaches behind the glass, m.
    const SHADED: (f32, f32) = (-0.5, 0.2);
    /// Light that its glow adds to a look straight at it, and the distance from it at which that has halved, m.
    const HALO: (f32, f32) = (0.55, 0.07);

    /// Of a bulb with that pose.
    pub(crate) fn at(bulb: &Isometry3<f64>) -> Self {
        let middle = bulb * Point3::new(0.0, 0.0, Self::GLASS);
        Self { middle: single(&middle.coords), out: single(&(bulb.rotation * Vector3::z())) }
    }

    /// Light that arrives at a point of a surface with that unit normal.
    fn on(&self, point: Vec3, normal: Vec3) -> Vec3 {
        let way = sub(self.middle, point);
        let square = dot(way, way).max(Self::RADIUS * Self::RADIUS);
        let distance = square.sqrt();
        let facing = (dot(normal, way) / distance).max(0.0);
        // Soft, as the glass is large.
        let beside = ((-dot(way, self.out) / distance - Self::SHADED.0) / 0.2 + 0.5).clamp(0.0, 1.0);
        let open = if distance > Self::SHADED.1 { beside } else { 1.0 };
        scale(Self::WARM, Self::STRENGTH * facing * open / square)
    }

    /// Its glow on a look along a ray that ends at a distance, in lengths of the ray.
    fn halo(&self, eye: Vec3, ray: Vec3, distance: f32) -> Vec3 {
        let way = sub(self.middle, eye);
        let along = dot(way, ray) / dot(ray, ray);
        // What stands before the glass hides its glow, and less so close to it.
        let length = dot(ray, ray).sqrt();
        let seen = (1.0 - (along - distance) * length / Self::RADIUS).clamp(0.0, 1.0);
        if along <= 0.0 || seen == 0.0 {
            return [0.0; 3];
        }
        let off = sub(way, scale(ray, along));
        let wide = dot(off, off) / (Self::HALO.1 * Self::HALO.1);
        scale(Self::WARM, seen * Self::HALO.0 / (1.0 + wide))
    }
}

/// Colours and light of one frame.
pub(crate) struct Shader<'a> {
    pub light: &'a PreparedLight,
    pub lamp: Option<Lamp>,
    /// In pictures for people.
    pub touches: Option<&'a Touches>,
    pub finishes: &'a [Finish],
}

impl Shader<'_> {
    /// Linear colour of a lit spot.
    pub(crate) fn colour(&self, paint: Paint, spot: &Spot) -> Vec3 {
        let finish = &self.finishes[paint as usize];
        let light = self.light;
        let mut base = finish.colour;
        match paint {
            Paint::Floor => base = scale(base, tiles(spot.point, spot.normal, spot.ray, spot.footprint)),
            Paint::Wall if spot.point[2] < SKIRTING => base = scale(base, 0.62),
            _ => {}
        }
        let mut under = 1.0;
        if let Some(touches) = self.touches {
            base = scale(base, touches.texture(paint, spot));
            under = touches.under_feet(spot);
        }
        if finish.tinted {
            base = product(base, light.room_tint);
        }
        let n = spot.normal;
        let up = 0.5 + 0.5 * n[2];
        let side = 1.0 + SIDE * (n[0] * light.dome_side[0] + n[1] * light.dome_side[1]);
        let dome = scale(mix(GROUND, SKY, up), light.dome * side * spot.open * under);
        let facing = dot(n, light.towards_key).max(0.0) * under;
        let mut arriving = add(dome, scale(light.key, facing * spot.lit));
        if let Some(lamp) = &self.lamp {
            arriving = add(arriving, lamp.on(spot.point, n));
        }
        let mut colour = product(base, add(arriving, [finish.glow; 3]));
        if finish.mirror > 0.0 {
            let ray = normalize(spot.ray);
            let back = -dot(n, ray);
            let mirrored = add(ray, scale(n, 2.0 * back));
            let grazing = 1.0 - back.clamp(0.0, 1.0);
            let grazing = grazing * grazing * grazing * grazing * grazing;
            let mirror = finish.mirror + (1.0 - finish.mirror) * 0.5 * grazing;
            let sky = (0.5 + 0.9 * mirrored[2]).clamp(0.0, 1.0);
            let sky = sky * sky * (3.0 - 2.0 * sky);
            let seen = match self.touches {
                None => mix(GROUND, SKY, sky),
                Some(_) => add(mix(DARK, SKY, sky), [BAND * band(mirrored[2]); 3]),
            };
            let room = scale(seen, light.dome * spot.open * mirror * 1.6);
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
            let square = spot.point[0] * spot.point[0] + spot.point[1] * spot.point[1];
            if square > FADE[0] * FADE[0] {
                let away = ((square.sqrt() - FADE[0]) / (FADE[1] - FADE[0])).min(1.0);
                colour = mix(colour, self.haze(normalize(spot.ray)), away * away * (3.0 - 2.0 * away));
            }
        }
        colour
    }

    /// Glow of the burning bulb on a look from `eye` along a ray that ends at a distance, in lengths of the ray.
    #[inline]
    pub(crate) fn halo(&self, eye: Vec3, ray: Vec3, distance: f32) -> Vec3 {
        self.lamp.map_or([0.0; 3], |lamp| lamp.halo(eye, ray, distance))
    }

    /// Colour of the haze along a ray.
    pub(crate) fn haze(&self, ray: Vec3) -> Vec3 {
        let up = (ray[2] * 2.0).clamp(0.0, 1.0);
        scale(mix(HAZE[0], HAZE[1], up), self.light.dome + 0.25 * self.light.key[1])
    }
}

/// True if a point of the floor is so near that the haze does not reach it.
pub(crate) fn is_clear(point: Vec3) -> bool {
    let most = FADE[0] - 0.2;
    point[0] * point[0] + point[1] * point[1] < most * most
}

/// Brightness of the tiled floor, smoothed over a pixel of that footprint.
fn tiles(point: Vec3, normal: Vec3, ray: Vec3, footprint: f32) -> f32 {
    const GROUT_HALF: f32 = 0.5 * GROUT;
    let width = footprint / (-dot(normal, ray)).max(MIN_SLANT);
    let (x, y) = (point[0] * (1.0 / TILE), point[1] * (1.0 / TILE));
    // Halves of the pixel and of the joint, and their overlap.
    let pixel = 0.5 * width;
    let overlap = |x: f32| {
        let from_joint = TILE * (x - floor(x + 0.5)).abs();
        (pixel.min(GROUT_HALF - from_joint) + pixel.min(GROUT_HALF + from_joint)).max(0.0)
    };
    let joint = (overlap(x).max(overlap(y)) / width).min(1.0);
    let number = 0.5 * (floor(x) + floor(y));
    let odd = 2.0 * (number - floor(number));
    let checker = 1.0 - odd * 0.05 * (1.0 - width * (1.0 / TILE)).max(0.0);
    checker * (1.0 - 0.35 * joint)
}
