//! One frame from meshes to bytes.

use fearless_simd::{Level, Simd, dispatch};
use fiatlux_rules::{Bulb, Row, errand};
use fiatlux_world::ShapeOwner;
use nalgebra::Isometry3;

use crate::lighting::PreparedLight;
use crate::look::Look;
use crate::mesh::{Detail, Mesh, Triangle};
use crate::occlusion::Occlusion;
use crate::paint::{Finish, Paint};
use crate::people::Touches;
use crate::raster::{self, Corner, Four, SPARE};
use crate::shade::{Lamp, Shader};
use crate::shadow::ShadowMap;
use crate::single::{SinglePose, single};
use crate::single::{Vec3, add, dot, floor, normalize, scale};
use crate::spot::Spot;
use crate::tone::Tone;
use crate::transform::{Projected, Seen};
use crate::view::View;
use crate::visible::{Painter, Surface};
use crate::wide::WideShader;
use crate::{Camera, Image, Lighting, Visuals};

/// Nothing is seen at this pixel.
const NOTHING: u32 = u32::MAX;
/// One pixel in this many is looked at to fit the shadow map.
const SHADOW_LATTICE: usize = 4;

/// A side above this, in pixels, takes a finer shadow map.
const LARGE: usize = 512;
/// Shadow map, cells and meshes for people.
const FINE: (usize, usize, Detail) = (2048, 2, Detail::Fine);

/// Draws frames of one size; keeps its buffers between them. A frame follows from its arguments alone.
#[derive(Debug, Clone)]
pub struct Renderer {
    /// Size of the picture, and samples a pixel each way.
    size: [usize; 2],
    samples: usize,
    detail: Detail,
    pub(crate) depth: Vec<f32>,
    pub(crate) ids: Vec<u32>,
    pub(crate) surfaces: Vec<Surface>,
    owners: Vec<ShapeOwner>,
    poses: Vec<Option<Isometry3<f64>>>,
    vertices: Seen,
    casters: Projected,
    /// Triangles to be drawn.
    four: Four,
    level: Level,
    shadow: ShadowMap,
    occlusion: Occlusion,
    /// By the look.
    finishes: [Vec<Finish>; 2],
    tone: Tone,
    /// Pixels that show nothing.
    empty: Vec<[u32; 2]>,
    pub(crate) image: Image,
}

/// A corner of a triangle that the near plane cuts.
#[derive(Debug, Clone, Copy, Default)]
struct Vertex {
    /// In the camera: ahead, left, up, m.
    at: Vec3,
    /// Unit normal, world axes.
    normal: Vec3,
    corner: Corner,
}

impl Renderer {
    /// For pictures of that size in pixels, both above 0, one sample each: what a robot's camera needs.
    pub fn new(width: usize, height: usize) -> Self {
        let shadow = if width.max(height) > LARGE { 512 } else { 256 };
        Self::with(width, height, 1, (shadow, 4, Detail::Coarse))
    }

    /// For pictures of that size for people to look at, one sample a pixel: above 512 pixels a side with fine meshes.
    pub fn for_people(width: usize, height: usize) -> Self {
        match width.max(height) > LARGE {
            true => Self::with(width, height, 1, FINE),
            false => Self::new(width, height),
        }
    }

    /// For pictures of that size with `samples` by `samples` samples a pixel and shadows that soften with distance: for
    /// people to look at.
    pub fn supersampled(width: usize, height: usize, samples: usize) -> Self {
        match samples {
            0 | 1 => Self::for_people(width, height),
            _ => Self::with(width, height, samples, FINE),
        }
    }

    /// With a shadow map of that side, cells of occlusion of that many pixels, and meshes of that detail.
    fn with(width: usize, height: usize, samples: usize, (shadow, cell, detail): (usize, usize, Detail)) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let (w, h) = (width * samples, height * samples);
        Self {
            size: [width, height],
            samples,
            detail,
            depth: vec![0.0; w * h + SPARE],
            ids: vec![NOTHING; w * h + SPARE],
            surfaces: Vec::new(),
            owners: Vec::new(),
            poses: Vec::new(),
            vertices: Seen::default(),
            casters: Projected::default(),
            four: Four::default(),
            level: Level::new(),
            shadow: ShadowMap::new(shadow),
            occlusion: Occlusion::new(w, h, cell),
            finishes: [Look::One, Look::Two].map(|look| Paint::ALL.iter().map(|paint| paint.finish(look)).collect()),
            tone: Tone::new(),
            empty: Vec::new(),
            image: Image::new(width, height),
        }
    }

    /// Draws a row. The same arguments give the same bytes.
    ///
    /// A row whose joint angles are not finite is drawn without its robot.
    pub fn render(&mut self, visuals: &Visuals, row: &Row, camera: &Camera, lighting: &Lighting) -> &Image {
        let mut rgb = std::mem::take(&mut self.image.rgb);
        self.render_to(visuals, row, camera, lighting, &mut rgb);
        self.image.rgb = rgb;
        &self.image
    }

    /// As [`Renderer::render`], into bytes of the caller's: red, green and blue of each pixel, rows from the top.
    ///
    /// # Panics
    /// The buffer has another length than three bytes for each pixel.
    pub fn render_to(&mut self, visuals: &Visuals, row: &Row, camera: &Camera, lighting: &Lighting, rgb: &mut [u8]) {
        assert_eq!(rgb.len(), 3 * self.size[0] * self.size[1], "bytes of a picture");
        let light = lighting.prepared();
        let view = self.draw_row(visuals, row, camera);
        let lit_bulb = row.attachments[Bulb::Fresh as usize].seated;
        let is_for_people = visuals.look() == Look::Two;
        let lamp = (lit_bulb && is_for_people).then(|| Lamp::at(&row.things[errand::FRESH_BULB].pose));
        let touches = is_for_people.then(|| Touches::of(visuals, row));
        let shaded = self.draw_shadows(visuals, &view, &light);
        self.find_occlusion(&view);
        let look = visuals.look() as usize;
        let finishes = std::mem::take(&mut self.finishes[look]);
        let shader = Shader { light: &light, lamp, touches: touches.as_ref(), finishes: &finishes };
        self.shade(rgb, &view, &shader, shaded);
        self.finishes[look] = finishes;
    }

    /// Finds what a row shows at each pixel and how far away it is, without lighting it: [`Renderer::owner`] and
    /// [`Renderer::depth`] then speak of this row as after [`Renderer::render`], and [`Renderer::image`] of an earlier one.
    pub fn measure(&mut self, visuals: &Visuals, row: &Row, camera: &Camera) {
        self.draw_row(visuals, row, camera);
    }

    fn draw_row(&mut self, visuals: &Visuals, row: &Row, camera: &Camera) -> View {
        let view = View::new(camera, self.grid());
        visuals.place(row, &mut self.poses);
        self.owners.clear();
        self.owners.extend(visuals.meshes(self.detail).iter().map(|mesh| mesh.owner));
        self.draw(visuals, &view, camera.hidden_link, row.attachments[Bulb::Fresh as usize].seated);
        view
    }

    /// Width and height of the pictures, pixels.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The picture that was rendered last.
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
            let turn = SinglePose::new(&pose);
            self.vertices.project(self.level, &mesh.columns, &turn, view);
            dispatch!(self.level, simd => self.draw_mesh(simd, mesh, index, &turn, view, lit_bulb));
        }
    }

    #[inline(always)]
    fn draw_mesh<S: Simd>(
        &mut self,
        simd: S,
        mesh: &Mesh,
        index: usize,
        turn: &SinglePose,
        view: &View,
        lit_bulb: bool,
    ) {
        let mut four = std::mem::take(&mut self.four);
        let mut from = 0;
        while from < mesh.triangles.len() {
            // In their order: of two triangles at one depth the first is seen.
            let mut cut = None;
            let columns = self.vertices.projected().columns();
            while from < mesh.triangles.len() {
                let place = from;
                from += 1;
                let vertices = mesh.triangles[place].indices();
                if !self.vertices.may_cover(vertices) {
                    continue;
                }
                let [a, b, c] = vertices;
                let ahead = |i: usize| self.vertices.ahead(i) >= view.near;
                if !(ahead(a) && ahead(b) && ahead(c)) {
                    cut = Some(place);
                    break;
                }
                if four.push(columns, vertices, place as u32) {
                    break;
                }
            }
            let normals = |place: u32| {
                let [a, b, c] = mesh.triangles[place as usize].indices();
                [turn.vector(mesh.normals[a]), turn.vector(mesh.normals[b]), turn.vector(mesh.normals[c])]
            };
            let paint = |place: u32| mesh.triangles[place as usize].seen_paint(lit_bulb);
            raster::draw(simd, &mut four, &mut self.painter(index, normals, paint));
            if let Some(place) = cut {
                self.draw_clipped(&mesh.triangles[place], mesh, index, turn, view, lit_bulb);
            }
        }
        self.four = four;
    }

    #[inline(always)]
    fn painter<N: Fn(u32) -> [Vec3; 3], P: Fn(u32) -> Paint>(
        &mut self,
        mesh: usize,
        normals: N,
        paint: P,
    ) -> Painter<'_, N, P> {
        let size = self.grid();
        let Self { depth, ids, surfaces, .. } = self;
        Painter { size, depth, ids, surfaces, mesh: mesh as u16, normals, paint }
    }

    /// Cuts a triangle off at the near plane and draws what is left.
    fn draw_clipped(
        &mut self,
        triangle: &Triangle,
        mesh: &Mesh,
        index: usize,
        turn: &SinglePose,
        view: &View,
        lit_bulb: bool,
    ) {
        let corners = triangle.indices().map(|i| Vertex {
            at: self.vertices.at(i),
            normal: turn.vector(mesh.normals[i]),
            corner: self.vertices.corner(i),
        });
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
        let mut four = Four::default();
        for i in 2..left.len() {
            let fan = [left[0], left[i - 1], left[i]];
            let column = |of: fn(&Corner) -> f32| fan.map(|vertex| of(&vertex.corner));
            let (u, v, depth) = (column(|at| at.u), column(|at| at.v), column(|at| at.depth));
            four.push([&u, &v, &depth], [0, 1, 2], i as u32);
        }
        let normals = |i: u32| [left[0], left[i as usize - 1], left[i as usize]].map(|vertex| vertex.normal);
        let paint = |_: u32| triangle.seen_paint(lit_bulb);
        dispatch!(self.level, simd => raster::draw(simd, &mut four, &mut self.painter(index, normals, paint)));
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
            let turn = SinglePose::new(pose);
            self.casters.cast(self.level, &mesh.columns, &turn, self.shadow.across(), self.shadow.size());
            self.shadow.draw(self.level, mesh.casters(), &self.casters);
        }
        self.shadow.finish(self.level);
        true
    }

    fn find_occlusion(&mut self, view: &View) {
        // The grid reaches a cell beyond the picture; there it repeats the border.
        let [width, height] = self.grid();
        let inside = move |x: usize, y: usize| (x.min(width - 1), y.min(height - 1));
        let (depth, ids, surfaces) = (&self.depth, &self.ids, &self.surfaces);
        let point = |x: usize, y: usize| {
            let (x, y) = inside(x, y);
            let inverse = depth[y * width + x];
            (inverse > 0.0).then(|| (add(view.eye, scale(view.ray(x, y), 1.0 / inverse)), inverse))
        };
        let normal = |x: usize, y: usize| {
            let (x, y) = inside(x, y);
            surfaces.get(ids[y * width + x] as usize).map(|surface| surface.normal_at(x, y))
        };
        self.occlusion.find(self.level, view.focal[1], point, normal);
    }

    /// Lights every sample and averages those of a pixel.
    fn shade(&mut self, rgb: &mut [u8], view: &View, shader: &Shader<'_>, shaded: bool) {
        if self.samples == 1 && shader.touches.is_none() {
            let mut empty = std::mem::take(&mut self.empty);
            self.shade_wide(rgb, &mut empty, shader, view, shaded);
            self.empty = empty;
        } else {
            self.shade_mean(rgb, shader, view, shaded);
        }
    }

    /// Lights eight pixels at once; `empty` is room for a list.
    fn shade_wide(&self, rgb: &mut [u8], empty: &mut Vec<[u32; 2]>, shader: &Shader<'_>, view: &View, shaded: bool) {
        let wide = WideShader {
            view,
            light: shader.light,
            finishes: shader.finishes,
            surfaces: &self.surfaces,
            ids: &self.ids,
            depth: &self.depth,
            shadow: shaded.then_some(&self.shadow),
            occlusion: &self.occlusion,
            tone: &self.tone,
        };
        empty.clear();
        dispatch!(self.level, simd => wide.shade(simd, rgb, empty));
        for [x, y] in empty {
            let (x, y) = (*x as usize, *y as usize);
            let at = 3 * (y * self.size[0] + x);
            let haze = shader.haze(normalize(view.ray(x, y)));
            rgb[at..at + 3].copy_from_slice(&haze.map(|light| self.tone.byte(light)));
        }
    }

    fn shade_mean(&self, rgb: &mut [u8], shader: &Shader<'_>, view: &View, shaded: bool) {
        let (n, [width, height]) = (self.samples, self.size);
        let share = 1.0 / (n * n) as f32;
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0; 3];
                for j in y * n..(y + 1) * n {
                    for i in x * n..(x + 1) * n {
                        sum = add(sum, self.tone.curve(self.sample_colour(shader, view, [i, j], shaded)));
                    }
                }
                let at = 3 * (y * width + x);
                for (byte, value) in rgb[at..at + 3].iter_mut().zip(sum) {
                    *byte = self.tone.byte_of_mean(value * share);
                }
            }
        }
    }

    /// Share of the key light that reaches a point, where the surface faces it.
    #[inline]
    fn lit(&self, point: Vec3, normal: Vec3, shader: &Shader<'_>, shaded: bool) -> f32 {
        if !shaded || dot(normal, shader.light.towards_key) <= 0.0 {
            return 1.0;
        }
        self.shadow.light(point, normal)
    }

    /// Light from a sample.
    #[inline]
    fn sample_colour(&self, shader: &Shader<'_>, view: &View, [x, y]: [usize; 2], shaded: bool) -> Vec3 {
        let at = y * self.size[0] * self.samples + x;
        let ray = view.ray(x, y);
        let Some(surface) = self.surfaces.get(self.ids[at] as usize) else {
            return add(shader.haze(normalize(ray)), shader.halo(view.eye, ray, f32::INFINITY));
        };
        let inverse = self.depth[at];
        let distance = 1.0 / inverse;
        let point = add(view.eye, scale(ray, distance));
        let normal = surface.normal_at(x, y);
        let soft = self.samples > 1 && shaded && dot(normal, shader.light.towards_key) > 0.0;
        let lit = match soft {
            true => self.shadow.soft_light(point, normal, turn_of(x, y)),
            false => self.lit(point, normal, shader, shaded),
        };
        let open = self.occlusion.at(x, y, inverse);
        let footprint = distance * view.inverse_focal[0];
        let colour = shader.colour(surface.paint, &Spot { point, normal, ray, footprint, open, lit });
        add(colour, shader.halo(view.eye, ray, distance))
    }
}

/// A number in [0, 1) that differs between neighbours (interleaved gradient noise).
fn turn_of(x: usize, y: usize) -> f32 {
    let t = 0.067_110_56 * x as f32 + 0.005_837_15 * y as f32;
    let t = 52.982_918 * (t - floor(t));
    t - floor(t)
}

#[cfg(test)]
mod tests;
