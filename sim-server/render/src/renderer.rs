//! One frame from meshes to bytes.

use fiatlux_rules::{Bulb, Row};
use fiatlux_world::ShapeOwner;
use nalgebra::{Isometry3, Vector3};

use crate::lighting::PreparedLight;
use crate::mesh::{Detail, Mesh};
use crate::occlusion::Occlusion;
use crate::paint::{Finish, Paint};
use crate::raster::{Corner, Plane, Setup, fill};
use crate::shade::{Shader, Spot, Tone, Vec3, add, dot, floor, normalize, scale, sub};
use crate::shadow::ShadowMap;
use crate::{Camera, Image, Lighting, Visuals};

/// Nothing is seen at this pixel.
const NOTHING: u32 = u32::MAX;
/// Every so many pixels one is looked at to fit the shadow map.
const SHADOW_LATTICE: usize = 4;

/// Draws frames of one size; keeps its buffers between them. A frame follows from its arguments alone.
#[derive(Debug, Clone)]
pub struct Renderer {
    /// Size of the picture, and samples a pixel each way.
    size: [usize; 2],
    samples: usize,
    detail: Detail,
    depth: Vec<f32>,
    ids: Vec<u32>,
    surfaces: Vec<Surface>,
    owners: Vec<ShapeOwner>,
    poses: Vec<Option<Isometry3<f64>>>,
    vertices: Vec<Vertex>,
    casters: Vec<Corner>,
    shadow: ShadowMap,
    occlusion: Occlusion,
    finishes: Vec<Finish>,
    tone: Tone,
    image: Image,
}

/// A visible triangle: what is needed to light its pixels.
#[derive(Debug, Clone)]
struct Surface {
    /// Components of the normal times the inverse depth, which are linear over the picture.
    normal: [Plane; 3],
    paint: Paint,
    mesh: u16,
}

#[derive(Debug, Clone, Copy)]
struct Vertex {
    /// In the camera: ahead, left, up, m.
    at: Vec3,
    /// World.
    normal: Vec3,
    corner: Corner,
}

/// The camera as the rasteriser takes it.
struct View {
    eye: Vec3,
    axes: [Vec3; 3],
    focal: [f32; 2],
    inverse_focal: [f32; 2],
    middle: [f32; 2],
    near: f32,
}

impl View {
    fn new(camera: &Camera, [width, height]: [usize; 2]) -> Self {
        let axis = |i: usize| {
            let mut unit = Vector3::zeros();
            unit[i] = 1.0;
            single(&(camera.world_from_camera.rotation * unit))
        };
        let focal = camera.focal(width, height);
        Self {
            eye: single(&camera.world_from_camera.translation.vector),
            axes: [axis(0), axis(1), axis(2)],
            focal: focal.map(|f| f as f32),
            inverse_focal: focal.map(|f| (1.0 / f) as f32),
            middle: [width as f32 / 2.0 - 0.5, height as f32 / 2.0 - 0.5],
            near: camera.near.max(1e-4) as f32,
        }
    }

    /// From the eye through a pixel, one metre ahead.
    #[inline]
    fn ray(&self, x: usize, y: usize) -> Vec3 {
        let left = (self.middle[0] - x as f32) * self.inverse_focal[0];
        let up = (self.middle[1] - y as f32) * self.inverse_focal[1];
        add(self.axes[0], add(scale(self.axes[1], left), scale(self.axes[2], up)))
    }

    fn project(&self, at: Vec3) -> Corner {
        let depth = 1.0 / at[0];
        let u = self.middle[0] - self.focal[0] * at[1] * depth;
        let v = self.middle[1] - self.focal[1] * at[2] * depth;
        Corner { u, v, depth }
    }

    /// Whether a sphere can be in the picture.
    fn reaches(&self, center: Vec3, radius: f32) -> bool {
        let way = sub(center, self.eye);
        let at = self.axes.map(|axis| dot(axis, way));
        if at[0] + radius < self.near {
            return false;
        }
        (0..2).all(|i| {
            let slope = (self.middle[i] + 0.5) / self.focal[i];
            at[i + 1].abs() - slope * at[0] <= radius * (1.0 + slope * slope).sqrt()
        })
    }
}

fn single(v: &Vector3<f64>) -> Vec3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

impl Renderer {
    /// For pictures of that size in pixels, one sample each: what a robot's camera needs.
    pub fn new(width: usize, height: usize) -> Self {
        Self::supersampled(width, height, 1)
    }

    /// For pictures of that size with `samples` by `samples` samples a pixel and shadows that soften with distance: for
    /// people to look at.
    pub fn supersampled(width: usize, height: usize, samples: usize) -> Self {
        let samples = samples.max(1);
        let (w, h) = (width * samples, height * samples);
        let large = samples > 1 || w.max(h) > 512;
        let (shadow, detail) = if large { (2048, Detail::Fine) } else { (384, Detail::Coarse) };
        Self {
            size: [width, height],
            samples,
            detail,
            depth: vec![0.0; w * h],
            ids: vec![NOTHING; w * h],
            surfaces: Vec::new(),
            owners: Vec::new(),
            poses: Vec::new(),
            vertices: Vec::new(),
            casters: Vec::new(),
            shadow: ShadowMap::new(shadow),
            occlusion: Occlusion::new(w, h),
            finishes: Paint::ALL.iter().map(|paint| paint.finish()).collect(),
            tone: Tone::new(),
            image: Image::new(width, height),
        }
    }

    /// Draws a row. The same arguments give the same bytes.
    ///
    /// A row whose joint angles are not finite is drawn without its robot.
    pub fn render(&mut self, visuals: &Visuals, row: &Row, camera: &Camera, lighting: &Lighting) -> &Image {
        let light = lighting.prepared();
        let view = View::new(camera, self.grid());
        visuals.place(row, &mut self.poses);
        self.owners.clear();
        self.owners.extend(visuals.meshes(self.detail).iter().map(|mesh| mesh.owner));
        let lit_bulb = row.attachments[Bulb::Fresh as usize].seated;
        self.draw(visuals, &view, camera.hidden_link, lit_bulb);
        let shaded = self.draw_shadows(visuals, &view, &light);
        self.find_occlusion(&view);
        self.shade(&view, &light, shaded);
        &self.image
    }

    /// The last picture.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Whose surface the last picture shows at a pixel; None for the background.
    ///
    /// # Panics
    /// If the pixel is outside the picture.
    pub fn owner(&self, x: usize, y: usize) -> Option<ShapeOwner> {
        let id = self.ids[self.sample(x, y)];
        self.surfaces.get(id as usize).map(|surface| self.owners[usize::from(surface.mesh)])
    }

    /// Distance along the camera's axis of what the last picture shows at a pixel, m; None for the background.
    ///
    /// # Panics
    /// If the pixel is outside the picture.
    pub fn depth(&self, x: usize, y: usize) -> Option<f64> {
        let inverse = self.depth[self.sample(x, y)];
        (inverse > 0.0).then(|| 1.0 / f64::from(inverse))
    }

    /// The sample at the middle of a pixel.
    fn sample(&self, x: usize, y: usize) -> usize {
        let [width, height] = self.size;
        assert!(x < width && y < height, "pixel ({x}, {y}) of {width} x {height}");
        let n = self.samples;
        (y * n + n / 2) * width * n + x * n + n / 2
    }

    fn grid(&self) -> [usize; 2] {
        self.size.map(|pixels| pixels * self.samples)
    }

    /// Depth and number of the nearest triangle at every sample.
    fn draw(&mut self, visuals: &Visuals, view: &View, hidden_link: Option<usize>, lit_bulb: bool) {
        self.depth.fill(0.0);
        self.ids.fill(NOTHING);
        self.surfaces.clear();
        let hidden = hidden_link.map(ShapeOwner::Robot);
        for (index, mesh) in visuals.meshes(self.detail).iter().enumerate() {
            let Some(pose) = self.poses[index] else { continue };
            let center = single(&(pose * nalgebra::Point3::from(mesh.center)).coords);
            if Some(mesh.owner) == hidden || !view.reaches(center, mesh.radius as f32) {
                continue;
            }
            self.place_vertices(mesh, &pose, view);
            for triangle in &mesh.triangles {
                let corners = triangle.vertices.map(|i| self.vertices[i as usize]);
                let mut paint = triangle.paint;
                if lit_bulb && paint == Paint::Glass {
                    paint = Paint::LitGlass;
                }
                let ahead = corners.map(|c| c.at[0] >= view.near);
                if ahead == [true; 3] {
                    self.add(&corners, paint, index);
                } else if ahead != [false; 3] {
                    self.add_clipped(&corners, view, paint, index);
                }
            }
        }
    }

    fn place_vertices(&mut self, mesh: &Mesh, pose: &Isometry3<f64>, view: &View) {
        let turn = Turn::new(pose);
        self.vertices.clear();
        self.vertices.extend(mesh.positions.iter().zip(&mesh.normals).map(|(p, n)| {
            let world = turn.point(*p);
            let way = sub(world, view.eye);
            let at = [dot(view.axes[0], way), dot(view.axes[1], way), dot(view.axes[2], way)];
            Vertex { at, normal: turn.vector(*n), corner: view.project(at) }
        }));
    }

    /// Cuts a triangle off at the near plane and draws what is left.
    fn add_clipped(&mut self, corners: &[Vertex; 3], view: &View, paint: Paint, mesh: usize) {
        let mut left: Vec<Vertex> = Vec::with_capacity(4);
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            if a.at[0] >= view.near {
                left.push(a);
            }
            if (a.at[0] >= view.near) != (b.at[0] >= view.near) {
                let share = (view.near - a.at[0]) / (b.at[0] - a.at[0]);
                let between = |a: Vec3, b: Vec3| [0, 1, 2].map(|i| a[i] + share * (b[i] - a[i]));
                let mut at = between(a.at, b.at);
                at[0] = view.near;
                left.push(Vertex { at, normal: between(a.normal, b.normal), corner: view.project(at) });
            }
        }
        for i in 2..left.len() {
            self.add(&[left[0], left[i - 1], left[i]], paint, mesh);
        }
    }

    fn add(&mut self, corners: &[Vertex; 3], paint: Paint, mesh: usize) {
        let [width, height] = self.grid();
        let Some(setup) = Setup::new(&corners.map(|c| c.corner), width, height) else { return };
        let depths = corners.map(|c| c.corner.depth);
        let normal = [0, 1, 2].map(|i| setup.plane([0, 1, 2].map(|k| corners[k].normal[i] * depths[k])));
        let id = self.surfaces.len() as u32;
        self.surfaces.push(Surface { normal, paint, mesh: mesh as u16 });
        fill(&setup, &setup.plane(depths), width, &mut self.depth, Some((&mut self.ids, id)));
    }

    /// Draws the shadow map for what is visible; false where nothing is.
    fn draw_shadows(&mut self, visuals: &Visuals, view: &View, light: &PreparedLight) -> bool {
        let [width, height] = self.grid();
        self.shadow.aim(light.towards_key);
        let step = SHADOW_LATTICE * self.samples;
        for y in (0..height).step_by(step) {
            for x in (0..width).step_by(step) {
                let at = y * width + x;
                let Some(surface) = self.surfaces.get(self.ids[at] as usize) else { continue };
                if surface.paint != Paint::Ceiling && self.depth[at] > 0.08 {
                    self.shadow.see(add(view.eye, scale(view.ray(x, y), 1.0 / self.depth[at])));
                }
            }
        }
        if !self.shadow.fit() {
            return false;
        }
        for (mesh, pose) in visuals.meshes(self.detail).iter().zip(&self.poses) {
            let (Some(pose), true) = (pose, mesh.casts) else { continue };
            let center = single(&(pose * nalgebra::Point3::from(mesh.center)).coords);
            if !self.shadow.reaches(center, mesh.radius as f32) {
                continue;
            }
            let turn = Turn::new(pose);
            let shadow = &self.shadow;
            self.casters.clear();
            self.casters.extend(mesh.positions.iter().map(|p| shadow.corner_of(turn.point(*p))));
            for triangle in &mesh.triangles {
                let corners = triangle.vertices.map(|i| self.casters[i as usize]);
                self.shadow.draw(corners);
            }
        }
        true
    }

    fn find_occlusion(&mut self, view: &View) {
        let width = self.grid()[0];
        let (depth, ids, surfaces) = (&self.depth, &self.ids, &self.surfaces);
        let point = |x: usize, y: usize| {
            let inverse = depth[y * width + x];
            (inverse > 0.0).then(|| (add(view.eye, scale(view.ray(x, y), 1.0 / inverse)), inverse))
        };
        let normal =
            |x: usize, y: usize| surfaces.get(ids[y * width + x] as usize).map(|surface| surface.normal_at(x, y));
        self.occlusion.find(view.focal[1], point, normal);
    }

    /// Lights every sample and averages those of a pixel.
    fn shade(&mut self, view: &View, light: &PreparedLight, shaded: bool) {
        let (n, [width, height]) = (self.samples, self.size);
        let shader = Shader { light, finishes: &self.finishes };
        let share = 1.0 / (n * n) as f32;
        for y in 0..height {
            for x in 0..width {
                if n == 1 {
                    let colour = self.sample_colour(&shader, view, x, y, shaded);
                    let at = 3 * (y * width + x);
                    self.image.rgb[at..at + 3].copy_from_slice(&colour.map(|light| self.tone.byte(light)));
                    continue;
                }
                let mut sum = [0.0; 3];
                for j in y * n..(y + 1) * n {
                    for i in x * n..(x + 1) * n {
                        sum = add(sum, self.tone.curve(self.sample_colour(&shader, view, i, j, shaded)));
                    }
                }
                let at = 3 * (y * width + x);
                for (byte, value) in self.image.rgb[at..at + 3].iter_mut().zip(sum) {
                    *byte = self.tone.byte_of_mean(value * share);
                }
            }
        }
    }

    #[inline]
    fn sample_colour(&self, shader: &Shader<'_>, view: &View, x: usize, y: usize, shaded: bool) -> Vec3 {
        let at = y * self.size[0] * self.samples + x;
        let ray = view.ray(x, y);
        let Some(surface) = self.surfaces.get(self.ids[at] as usize) else { return shader.haze(normalize(ray)) };
        let inverse = self.depth[at];
        let distance = 1.0 / inverse;
        let point = add(view.eye, scale(ray, distance));
        let normal = surface.normal_at(x, y);
        let lit = if !shaded || dot(normal, shader.light.towards_key) <= 0.0 {
            1.0
        } else if self.samples > 1 {
            self.shadow.soft_light(point, normal, turn_of(x, y))
        } else {
            self.shadow.light(point, normal)
        };
        let spot = Spot {
            point,
            normal,
            ray: normalize(ray),
            footprint: distance / view.focal[0],
            open: self.occlusion.at(x, y, inverse),
            lit,
        };
        shader.colour(surface.paint, &spot)
    }
}

impl Surface {
    #[inline]
    fn normal_at(&self, x: usize, y: usize) -> Vec3 {
        let (u, v) = (x as f32, y as f32);
        normalize([self.normal[0].at(u, v), self.normal[1].at(u, v), self.normal[2].at(u, v)])
    }
}

/// A pose in single precision.
struct Turn {
    rows: [Vec3; 3],
    shift: Vec3,
}

impl Turn {
    fn new(pose: &Isometry3<f64>) -> Self {
        let matrix = pose.rotation.to_rotation_matrix();
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| matrix[(i, j)] as f32));
        Self { rows, shift: single(&pose.translation.vector) }
    }

    fn point(&self, p: Vec3) -> Vec3 {
        add(self.vector(p), self.shift)
    }

    fn vector(&self, v: Vec3) -> Vec3 {
        [dot(self.rows[0], v), dot(self.rows[1], v), dot(self.rows[2], v)]
    }
}

/// A number in [0, 1) that differs between neighbours (interleaved gradient noise).
fn turn_of(x: usize, y: usize) -> f32 {
    let t = 0.067_110_56 * x as f32 + 0.005_837_15 * y as f32;
    let t = 52.982_918 * (t - floor(t));
    t - floor(t)
}
