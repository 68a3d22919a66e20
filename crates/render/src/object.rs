//! Pictures of an object on its own: lit like everything else, in the colours and textures of its file.

use fiatlux_rules::Row;
use fiatlux_world::{Scene, ShapeOwner};
use nalgebra::{Point3, Vector3};

use crate::mesh::surface::Surface;
use crate::mesh::{Detail, Frame, Mesh};
use crate::paint::{Paint, encode, linear};
use crate::{Camera, Image, Lighting, Renderer, Visuals};

/// Samples a pixel, each way.
const SAMPLES: usize = 3;
/// Radius of the sphere around an object as it is drawn, m: light, shadows and tiles are made for things of a room's size.
const RADIUS: f64 = 0.5;
/// Bearing and elevation of the camera, rad, and its vertical field of view, rad.
const BEARING: f64 = -0.96;
const ELEVATION: f64 = 0.44;
const FOV: f64 = 0.5;
/// Paint in which everything is lit before it gets its own colour.
const LIT: Paint = Paint::Shell;

/// An image that covers a part, 8-bit sRGB, row by row from the top left. It repeats.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Pixels in a row, and rows; both above 0.
    pub size: [usize; 2],
    /// Red, green and blue of each pixel.
    pub rgb: Vec<u8>,
}

impl Texture {
    /// Linear colour at texture coordinates: u to the right, v upwards, 0 to 1 once over the image.
    fn at(&self, [u, v]: [f64; 2]) -> [f32; 3] {
        let [width, height] = self.size;
        let place = |t: f64, count: usize| ((t.rem_euclid(1.0) * count as f64) as usize).min(count - 1);
        let at = 3 * (place(1.0 - v, height) * width + place(u, width));
        [0, 1, 2].map(|channel| linear(self.rgb[at + channel]))
    }
}

/// A part of an object as it is drawn.
#[derive(Debug, Clone)]
pub struct ObjectPart {
    /// Corners, m, z up.
    pub positions: Vec<[f32; 3]>,
    /// Three corners each, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Share of the light that it scatters, linear; a texture is multiplied by it.
    pub colour: [f32; 3],
    /// Texture coordinates of the corners, and the image.
    pub texture: Option<(Vec<[f32; 2]>, Texture)>,
}

/// Draws an object on the floor of a scene without anything else, seen from the front right, above: width and height in pixels.
///
/// # Panics
/// A triangle names a corner, or a corner texture coordinates, that are not there.
pub fn object_picture(floor: &Scene, row: &Row, parts: &[ObjectPart], [width, height]: [usize; 2]) -> Image {
    let (parts, middle) = sized(parts);
    let eye = Vector3::new(
        libm::cos(ELEVATION) * libm::cos(BEARING),
        libm::cos(ELEVATION) * libm::sin(BEARING),
        libm::sin(ELEVATION),
    );
    let away = 1.06 * RADIUS / libm::sin(FOV / 2.0);
    let aspect = width as f64 / height as f64;
    let camera = Camera::look_at(middle + eye * away, middle, FOV, aspect);
    let grid = [width, height].map(|pixels| pixels.max(1) * SAMPLES);
    let mut renderer = Renderer::for_people(grid[0], grid[1]);
    // The shadows under the robot's feet would be seen without it.
    let mut row = row.clone();
    row.robot.pose.translation.vector.x += 1e3;
    let mut image = renderer.render(&visuals(floor, &parts), &row, &camera, &Lighting::default()).clone();
    let lit = linear_table();
    let base = LIT.finish(crate::look::Look::Two).colour;
    for (pixel, colour) in image.rgb.chunks_exact_mut(3).zip(colours(&parts, &camera, grid)) {
        let Some(colour) = colour else { continue };
        for (channel, byte) in pixel.iter_mut().enumerate() {
            *byte = encode(f64::from(lit[usize::from(*byte)] * colour[channel] / base[channel]));
        }
    }
    image.reduced(SAMPLES)
}

fn linear_table() -> Vec<f32> {
    (0..=u8::MAX).map(linear).collect()
}

/// The parts at the size that they are drawn in, and the middle of the sphere around them.
fn sized(parts: &[ObjectPart]) -> (Vec<ObjectPart>, Vector3<f64>) {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = -low;
    for p in parts.iter().flat_map(|part| &part.positions) {
        let p = Vector3::from(p.map(f64::from));
        (low, high) = (low.inf(&p), high.sup(&p));
    }
    let scale = 2.0 * RADIUS / (high - low).norm().max(1e-9);
    let from = Vector3::new((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z);
    let mut parts = parts.to_vec();
    for p in parts.iter_mut().flat_map(|part| &mut part.positions) {
        let at = (Vector3::from(p.map(f64::from)) - from) * scale;
        *p = [at.x as f32, at.y as f32, at.z as f32];
    }
    (parts, Vector3::z() * (scale * (high.z - low.z) / 2.0))
}

fn visuals(floor: &Scene, parts: &[ObjectPart]) -> Visuals {
    let drawn = parts.iter().map(|part| {
        let corners = |triangle: &[u32; 3]| triangle.map(|corner| part.positions[corner as usize]);
        let soup: Vec<_> = part.triangles.iter().map(corners).collect();
        let mut mesh = Mesh::new(Frame::World, ShapeOwner::CRATE, Detail::Fine);
        Surface::new(&soup).add_to(&mut mesh, LIT);
        mesh
    });
    Visuals::of_object(floor, drawn.collect())
}

/// Colour of the nearest part at each sample; None where there is none.
fn colours(parts: &[ObjectPart], camera: &Camera, [width, height]: [usize; 2]) -> Vec<Option<[f32; 3]>> {
    let mut nearest = vec![0.0; width * height];
    let mut colours = vec![None; width * height];
    let [fx, fy] = camera.focal(width, height);
    for part in parts {
        // Pixels from the left and the upper edge, and the inverse of the way ahead.
        let seen: Vec<[f64; 3]> = part
            .positions
            .iter()
            .map(|p| {
                let p = camera.world_from_camera.inverse_transform_point(&Point3::from(p.map(f64::from)));
                [width as f64 / 2.0 - fx * p.y / p.x, height as f64 / 2.0 - fy * p.z / p.x, 1.0 / p.x]
            })
            .collect();
        for triangle in &part.triangles {
            let [a, b, c] = triangle.map(|corner| seen[corner as usize]);
            let twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            if twice.abs() < 1e-12 || [a, b, c].iter().any(|corner| corner[2] <= 0.0) {
                continue;
            }
            let range = |axis: usize, count: usize| {
                let (low, high) = (a[axis].min(b[axis]).min(c[axis]), a[axis].max(b[axis]).max(c[axis]));
                (low - 0.5).ceil().max(0.0) as usize..((high - 0.5).floor() + 1.0).clamp(0.0, count as f64) as usize
            };
            for y in range(1, height) {
                for x in range(0, width) {
                    let (u, v) = (x as f64 + 0.5, y as f64 + 0.5);
                    let of_b = ((u - a[0]) * (c[1] - a[1]) - (v - a[1]) * (c[0] - a[0])) / twice;
                    let of_c = ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) / twice;
                    let shares = [1.0 - of_b - of_c, of_b, of_c];
                    if shares.iter().any(|share| *share < 0.0) {
                        continue;
                    }
                    let inverse = shares[0] * a[2] + shares[1] * b[2] + shares[2] * c[2];
                    let at = y * width + x;
                    if inverse <= nearest[at] {
                        continue;
                    }
                    nearest[at] = inverse;
                    let shares = [0, 1, 2].map(|i| shares[i] * [a, b, c][i][2] / inverse);
                    colours[at] = Some(part.colour_at(*triangle, shares));
                }
            }
        }
    }
    colours
}

impl ObjectPart {
    /// Linear colour of a place in a triangle, by the shares of its corners.
    fn colour_at(&self, triangle: [u32; 3], shares: [f64; 3]) -> [f32; 3] {
        let Some((coordinates, image)) = &self.texture else { return self.colour };
        let mut at = [0.0; 2];
        for (corner, share) in triangle.iter().zip(shares) {
            let [u, v] = coordinates[*corner as usize];
            at = [at[0] + share * f64::from(u), at[1] + share * f64::from(v)];
        }
        let texel = image.at(at);
        [0, 1, 2].map(|channel| self.colour[channel] * texel[channel])
    }
}
