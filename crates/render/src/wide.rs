//! Light on eight pixels at once: the operations of [`crate::shade`] in the same order, so that the bytes are the same.

mod looks;
pub(crate) mod vector;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, i32x8, u32x8};

use looks::Looks;
use vector::{
    Wide, Wide3, add, clamp, dot, floor, greater, lesser, mix, normalize, product, scale, select, sub, wide3,
};

use crate::lighting::PreparedLight;
use crate::occlusion::Occlusion;
use crate::paint::{Finish, Paint};
use crate::raster::{LANES, Places};
use crate::shade::{FADE, GROUND, HAZE, SIDE, SKY};
use crate::shadow::ShadowMap;
use crate::spot::{GROUT, MIN_SLANT, SKIRTING, TILE};
use crate::tone::Tone;
use crate::view::View;
use crate::visible::Surface;

/// A frame that is being lit: where a renderer has one sample a pixel and no lamp burns.
pub(crate) struct WideShader<'a> {
    pub view: &'a View,
    pub light: &'a PreparedLight,
    pub finishes: &'a [Finish],
    pub surfaces: &'a [Surface],
    pub ids: &'a [u32],
    pub depth: &'a [f32],
    pub shadow: Option<&'a ShadowMap>,
    pub occlusion: &'a Occlusion,
    pub tone: &'a Tone,
}

/// Pixels that wait to be lit.
#[derive(Debug, Clone, Default)]
pub(crate) struct Queue {
    at: Places,
    /// Shares of the key light and of the dome that arrive; below 0 where they are still to be found.
    lit: [f32; LANES],
    open: [f32; LANES],
    count: usize,
}

/// Queues of a frame, by what they become.
#[derive(Debug, Clone, Default)]
pub(crate) struct Queues {
    /// First pixels of two by two that show one surface.
    heads: Queue,
    single: Queue,
    /// First pixels of two by two of one colour, and of two by two on the clear floor.
    plain: Queue,
    tiled: Queue,
}

impl Queue {
    /// Adds a pixel; true once there are eight.
    #[inline(always)]
    fn push(&mut self, at: [u32; 2], lit: f32, open: f32) -> bool {
        let lane = self.count % LANES;
        (self.at[0][lane], self.at[1][lane]) = (at[0], at[1]);
        (self.lit[lane], self.open[lane]) = (lit, open);
        self.count = lane + 1;
        self.count == LANES
    }

    /// Takes what is there; the lanes beyond it repeat pixels.
    #[inline(always)]
    fn take(&mut self) -> (Self, usize) {
        let count = std::mem::take(&mut self.count);
        let mut taken = self.clone();
        for lane in count..LANES {
            (taken.at[0][lane], taken.at[1][lane]) = (taken.at[0][0], taken.at[1][0]);
            (taken.lit[lane], taken.open[lane]) = (taken.lit[0], taken.open[0]);
        }
        (taken, count)
    }
}

/// Geometry and paint of eight pixels.
struct Spots<S: Simd> {
    point: Wide3<S>,
    normal: Wide3<S>,
    ray: Wide3<S>,
    distance: Wide<S>,
    inverse: Wide<S>,
    /// The normal is the same all over the surface.
    flat: [bool; LANES],
    paint: [Paint; LANES],
}

impl WideShader<'_> {
    /// Lights a picture without background between its first and last pixels; returns pixels that show nothing, for others to
    /// fill.
    #[inline(always)]
    pub(crate) fn shade<S: Simd>(&self, simd: S, rgb: &mut [u8], empty: &mut Vec<[u32; 2]>) {
        let [width, height] = self.view.size;
        let mut queues = Queues::default();
        for y in (0..height).step_by(2) {
            for x in (0..width).step_by(2) {
                let at = y * width + x;
                let id = self.ids[at];
                let whole = x + 1 < width && y + 1 < height && {
                    let (upper, lower) = (&self.ids[at..at + 2], &self.ids[at + width..at + width + 2]);
                    (upper[1] == id) & (lower[0] == id) & (lower[1] == id)
                };
                let place = [x as u32, y as u32];
                if whole && (id as usize) < self.surfaces.len() {
                    if queues.heads.push(place, 0.0, 0.0) {
                        self.sort(simd, &mut queues, rgb);
                    }
                } else {
                    for j in y..(y + 2).min(height) {
                        for i in x..(x + 2).min(width) {
                            let place = [i as u32, j as u32];
                            if (self.ids[j * width + i] as usize) >= self.surfaces.len() {
                                empty.push(place);
                            } else if queues.single.push(place, -1.0, 0.0) {
                                self.light_single(simd, &mut queues.single, rgb);
                            }
                        }
                    }
                }
            }
        }
        self.sort(simd, &mut queues, rgb);
        self.light_single(simd, &mut queues.single, rgb);
        self.light_plain(simd, &mut queues.plain, rgb);
        self.light_tiled(simd, &mut queues.tiled, rgb);
    }

    /// Finds what reaches the heads. Where all or none of the key light does, all four pixels share it.
    #[inline(always)]
    fn sort<S: Simd>(&self, simd: S, queues: &mut Queues, rgb: &mut [u8]) {
        let (heads, count) = queues.heads.take();
        if count == 0 {
            return;
        }
        let spots = self.spots(simd, &heads.at);
        let lit = self.lit(simd, &spots);
        let open: [f32; LANES] = self.open(simd, &heads.at, &spots).into();
        let [px, py, pz]: [[f32; LANES]; 3] = [spots.point[0].into(), spots.point[1].into(), spots.point[2].into()];
        for k in 0..count {
            let (at, paint) = ([heads.at[0][k], heads.at[1][k]], spots.paint[k]);
            let shared = lit[k] == 0.0 || lit[k] == 1.0;
            if shared && paint == Paint::Floor && crate::shade::is_clear([px[k], py[k], pz[k]]) {
                if queues.tiled.push(at, lit[k], open[k]) {
                    self.light_tiled(simd, &mut queues.tiled, rgb);
                }
            } else if shared && spots.flat[k] && paint.is_plain(self.finishes, pz[k]) {
                if queues.plain.push(at, lit[k], open[k]) {
                    self.light_plain(simd, &mut queues.plain, rgb);
                }
            } else {
                let lit = if shared { lit[k] } else { -1.0 };
                for [i, j] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                    if queues.single.push([at[0] + i, at[1] + j], lit, open[k]) {
                        self.light_single(simd, &mut queues.single, rgb);
                    }
                }
            }
        }
    }

    #[inline(never)]
    fn light_single<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        simd.vectorize(
            #[inline(always)]
            || self.single(simd, queue, rgb),
        );
    }

    #[inline(always)]
    fn single<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        let (pixels, count) = queue.take();
        if count == 0 {
            return;
        }
        let spots = self.spots(simd, &pixels.at);
        let zero = f32x8::splat(simd, 0.0);
        let (mut lit, mut open) = (f32x8::from_slice(simd, &pixels.lit), f32x8::from_slice(simd, &pixels.open));
        let unknown = lit.simd_lt(zero);
        if unknown.any_true() {
            lit = unknown.select(f32x8::from_slice(simd, &self.lit(simd, &spots)), lit);
            open = unknown.select(self.open(simd, &pixels.at, &spots), open);
        }
        let colour = self.colour(simd, &spots, lit, open, true);
        let bytes = self.bytes(simd, colour);
        let width = self.view.size[0];
        for k in 0..count {
            let [x, y] = [pixels.at[0][k], pixels.at[1][k]];
            let at = 3 * (y as usize * width + x as usize);
            rgb[at..at + 3].copy_from_slice(&bytes[k]);
        }
    }

    #[inline(never)]
    fn light_plain<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        simd.vectorize(
            #[inline(always)]
            || self.plain(simd, queue, rgb),
        );
    }

    #[inline(always)]
    fn plain<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        let (pixels, count) = queue.take();
        if count == 0 {
            return;
        }
        let spots = self.spots(simd, &pixels.at);
        let (lit, open) = (f32x8::from_slice(simd, &pixels.lit), f32x8::from_slice(simd, &pixels.open));
        let bytes = self.bytes(simd, self.colour(simd, &spots, lit, open, true));
        let width = self.view.size[0];
        for k in 0..count {
            let [x, y] = [pixels.at[0][k], pixels.at[1][k]];
            let at = 3 * (y as usize * width + x as usize);
            for at in [at, at + 3 * width] {
                let two = &mut rgb[at..at + 6];
                two[..3].copy_from_slice(&bytes[k]);
                two[3..].copy_from_slice(&bytes[k]);
            }
        }
    }

    #[inline(never)]
    fn light_tiled<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        simd.vectorize(
            #[inline(always)]
            || self.tiled(simd, queue, rgb),
        );
    }

    #[inline(always)]
    fn tiled<S: Simd>(&self, simd: S, queue: &mut Queue, rgb: &mut [u8]) {
        let (pixels, count) = queue.take();
        if count == 0 {
            return;
        }
        let (view, width) = (self.view, self.view.size[0]);
        let splat = |value: f32| f32x8::splat(simd, value);
        let spots = self.spots(simd, &pixels.at);
        let (lit, open) = (f32x8::from_slice(simd, &pixels.lit), f32x8::from_slice(simd, &pixels.open));
        let colour = self.colour(simd, &spots, lit, open, false);
        let [left, up] = self.across(simd, &pixels.at);
        let (lefts, ups) = ([left, left - splat(view.inverse_focal[0])], [up, up - splat(view.inverse_focal[1])]);
        let axes = [wide3(simd, view.axes[0]), wide3(simd, view.axes[1]), wide3(simd, view.axes[2])];
        for [i, j] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            let mut inverse = [0.0; LANES];
            for (k, inverse) in inverse.iter_mut().enumerate() {
                *inverse = self.depth[(pixels.at[1][k] as usize + j) * width + pixels.at[0][k] as usize + i];
            }
            let [ahead, left, up] = axes;
            let ray = add(add(ahead, scale(left, lefts[i])), scale(up, ups[j]));
            let distance = splat(1.0) / f32x8::from_slice(simd, &inverse);
            let (x, y) = (splat(view.eye[0]) + ray[0] * distance, splat(view.eye[1]) + ray[1] * distance);
            let slant = splat(0.0) - dot(spots.normal, ray);
            let footprint = distance * splat(view.inverse_focal[0]) / greater(slant, splat(MIN_SLANT));
            let tile = tiles(simd, x, y, footprint);
            let bytes = self.bytes(simd, scale(colour, tile));
            for (k, bytes) in bytes.iter().enumerate().take(count) {
                let at = 3 * ((pixels.at[1][k] as usize + j) * width + pixels.at[0][k] as usize + i);
                rgb[at..at + 3].copy_from_slice(bytes);
            }
        }
    }

    /// Distances of pixels to the left of and above the middle, one metre ahead, m.
    #[inline(always)]
    fn across<S: Simd>(&self, simd: S, at: &Places) -> [Wide<S>; 2] {
        [self.across_axis(simd, at, 0), self.across_axis(simd, at, 1)]
    }

    #[inline(always)]
    fn across_axis<S: Simd>(&self, simd: S, at: &Places, axis: usize) -> Wide<S> {
        let middle = f32x8::splat(simd, self.view.middle[axis]);
        (middle - numbers(simd, &at[axis])) * f32x8::splat(simd, self.view.inverse_focal[axis])
    }

    #[inline(always)]
    fn spots<S: Simd>(&self, simd: S, at: &Places) -> Spots<S> {
        let (view, width) = (self.view, self.view.size[0]);
        let splat = |value: f32| f32x8::splat(simd, value);
        let (mut inverse, mut flat, mut paint) = ([0.0; LANES], [false; LANES], [Paint::Floor; LANES]);
        let mut ids = [0_usize; LANES];
        for k in 0..LANES {
            let index = at[1][k] as usize * width + at[0][k] as usize;
            (inverse[k], ids[k]) = (self.depth[index], self.ids[index] as usize);
        }
        let [left, up] = self.across(simd, at);
        let axes = [wide3(simd, view.axes[0]), wide3(simd, view.axes[1]), wide3(simd, view.axes[2])];
        let ray = add(axes[0], add(scale(axes[1], left), scale(axes[2], up)));
        let inverse = f32x8::from_slice(simd, &inverse);
        let distance = splat(1.0) / inverse;
        let point = add(wide3(simd, view.eye), scale(ray, distance));

        let mut bent = [0.0; LANES];
        let mut planes = [[0.0; LANES]; 9];
        let mut any_bent = false;
        for (k, id) in ids.into_iter().enumerate() {
            let surface = &self.surfaces[id];
            (flat[k], paint[k]) = (surface.flat.is_some(), surface.paint);
            match surface.flat {
                Some(normal) => {
                    for axis in 0..3 {
                        planes[3 * axis][k] = normal[axis];
                    }
                }
                None => {
                    any_bent = true;
                    bent[k] = 1.0;
                    for (axis, plane) in surface.normal.iter().enumerate() {
                        planes[3 * axis][k] = plane.origin;
                        planes[3 * axis + 1][k] = plane.slope[0];
                        planes[3 * axis + 2][k] = plane.slope[1];
                    }
                }
            }
        }
        let of = |k: usize| f32x8::from_slice(simd, &planes[k]);
        let mut normal = [of(0), of(3), of(6)];
        if any_bent {
            let (u, v) = (numbers(simd, &at[0]), numbers(simd, &at[1]));
            let (right, down) = ([of(1), of(4), of(7)], [of(2), of(5), of(8)]);
            let turned = normalize(simd, add(add(normal, scale(right, u)), scale(down, v)));
            let bent = f32x8::from_slice(simd, &bent).simd_gt(splat(0.5));
            for axis in 0..3 {
                normal[axis] = bent.select(turned[axis], normal[axis]);
            }
        }
        Spots { point, normal, ray, distance, inverse, flat, paint }
    }

    /// Share of the key light that arrives.
    #[inline(always)]
    fn lit<S: Simd>(&self, simd: S, spots: &Spots<S>) -> [f32; LANES] {
        let Some(shadow) = self.shadow else { return [1.0; LANES] };
        let facing = dot(spots.normal, wide3(simd, self.light.towards_key));
        let facing = facing.simd_le(f32x8::splat(simd, 0.0)).to_bitmask();
        shadow.light_eight(simd, spots.point, spots.normal, !facing)
    }

    /// Share of the dome that is not occluded.
    #[inline(always)]
    fn open<S: Simd>(&self, simd: S, at: &Places, spots: &Spots<S>) -> Wide<S> {
        self.occlusion.at_eight(simd, at, spots.inverse)
    }

    /// Linear colours of lit spots; `has_tiles` puts the tiles on the floor.
    #[inline(always)]
    fn colour<S: Simd>(&self, simd: S, spots: &Spots<S>, lit: Wide<S>, open: Wide<S>, has_tiles: bool) -> Wide3<S> {
        let light = self.light;
        let splat = |value: f32| f32x8::splat(simd, value);
        let (zero, one) = (splat(0.0), splat(1.0));
        let look = Looks::of(spots.paint, self.finishes, light);
        let of = |numbers: &[f32; LANES]| f32x8::from_slice(simd, numbers);
        let floor = of(&look.floor).simd_gt(zero);
        let wall = of(&look.wall).simd_gt(zero);
        let mirror = of(&look.mirror).simd_gt(zero);
        let mut share = one;
        if has_tiles && floor.any_true() {
            let slant = zero - dot(spots.normal, spots.ray);
            let footprint = spots.distance * splat(self.view.inverse_focal[0]);
            let footprint = footprint / greater(slant, splat(MIN_SLANT));
            share = floor.select(tiles(simd, spots.point[0], spots.point[1], footprint), share);
        }
        if wall.any_true() {
            let skirting = wall & spots.point[2].simd_lt(splat(SKIRTING));
            share = skirting.select(splat(0.62), share);
        }
        let base = product(
            scale([of(&look.colour[0]), of(&look.colour[1]), of(&look.colour[2])], share),
            [of(&look.tint[0]), of(&look.tint[1]), of(&look.tint[2])],
        );
        let n = spots.normal;
        let up = splat(0.5) + splat(0.5) * n[2];
        let side = one + splat(SIDE) * (n[0] * splat(light.dome_side[0]) + n[1] * splat(light.dome_side[1]));
        let dome = scale(mix(simd, GROUND, SKY, up), splat(light.dome) * side * open);
        let facing = greater(dot(n, wide3(simd, light.towards_key)), zero);
        let key = wide3(simd, light.key);
        let arriving = add(dome, scale(key, facing * lit));
        let glow = of(&look.glow);
        let mut colour = product(base, add(arriving, [glow; 3]));
        if mirror.any_true() {
            let shining = self.mirrored(simd, spots, &look, colour, lit, open);
            colour = select(mirror, shining, colour);
        }
        if floor.any_true() {
            let square = spots.point[0] * spots.point[0] + spots.point[1] * spots.point[1];
            let far = floor & square.simd_gt(splat(FADE[0] * FADE[0]));
            if far.any_true() {
                let away = lesser((square.sqrt() - splat(FADE[0])) / splat(FADE[1] - FADE[0]), one);
                let haze = self.haze(simd, normalize(simd, spots.ray));
                let share = away * away * (splat(3.0) - splat(2.0) * away);
                colour = select(far, add(colour, scale(sub(haze, colour), share)), colour);
            }
        }
        colour
    }

    #[inline(always)]
    fn mirrored<S: Simd>(
        &self,
        simd: S,
        spots: &Spots<S>,
        look: &Looks,
        colour: Wide3<S>,
        lit: Wide<S>,
        open: Wide<S>,
    ) -> Wide3<S> {
        let (light, n) = (self.light, spots.normal);
        let splat = |value: f32| f32x8::splat(simd, value);
        let (zero, one) = (splat(0.0), splat(1.0));
        let of = |numbers: &[f32; LANES]| f32x8::from_slice(simd, numbers);
        let ray = normalize(simd, spots.ray);
        let back = zero - dot(n, ray);
        let mirrored = add(ray, scale(n, splat(2.0) * back));
        let grazing = one - clamp(simd, back);
        let grazing = grazing * grazing * grazing * grazing * grazing;
        let own = of(&look.mirror);
        let mirror = own + (one - own) * splat(0.5) * grazing;
        let sky = clamp(simd, splat(0.5) + splat(0.9) * mirrored[2]);
        let room = mix(simd, GROUND, SKY, sky * sky * (splat(3.0) - splat(2.0) * sky));
        let room = scale(room, splat(light.dome) * open * mirror * splat(1.6));
        let mut shine = greater(dot(mirrored, wide3(simd, light.towards_key)), zero);
        let bright = shine.simd_gt(splat(0.5));
        if bright.any_true() {
            let sharpness = of(&look.sharpness);
            for k in 0..look.sharpest() {
                shine = sharpness.simd_gt(splat(f32::from(k))).select(shine * shine, shine);
            }
        }
        shine = bright.select(shine, zero);
        let gain = splat(0.12) * of(&look.power) * lesser(mirror, splat(0.2)) * lit;
        add(add(colour, room), scale(wide3(simd, light.key), shine * gain))
    }

    #[inline(always)]
    fn haze<S: Simd>(&self, simd: S, ray: Wide3<S>) -> Wide3<S> {
        let up = ray[2] * f32x8::splat(simd, 2.0);
        scale(
            mix(simd, HAZE[0], HAZE[1], clamp(simd, up)),
            f32x8::splat(simd, self.light.dome + 0.25 * self.light.key[1]),
        )
    }

    /// sRGB of colours.
    #[inline(always)]
    fn bytes<S: Simd>(&self, simd: S, colour: Wide3<S>) -> [[u8; 3]; LANES] {
        let mut bytes = [[0; 3]; LANES];
        for (channel, light) in colour.into_iter().enumerate() {
            let light = greater(light, f32x8::splat(simd, 0.0));
            let bits: u32x8<S> = light.bitcast();
            let indices: [u32; LANES] = self.tone.indices(simd, bits).into();
            for k in 0..LANES {
                bytes[k][channel] = self.tone.byte_at(indices[k]);
            }
        }
        bytes
    }
}

/// Pixels' numbers, which are below 2 to the power of 31.
#[inline(always)]
fn numbers<S: Simd>(simd: S, at: &[u32; LANES]) -> Wide<S> {
    let whole: i32x8<S> = u32x8::from_slice(simd, at).bitcast();
    f32x8::float_from(whole)
}

/// Brightness of the tiled floor, smoothed over a width (m).
#[inline(always)]
fn tiles<S: Simd>(simd: S, x: Wide<S>, y: Wide<S>, width: Wide<S>) -> Wide<S> {
    let splat = |value: f32| f32x8::splat(simd, value);
    let (zero, one, half) = (splat(0.0), splat(1.0), splat(0.5));
    let (x, y) = (x * splat(1.0 / TILE), y * splat(1.0 / TILE));
    let pixel = half * width;
    let joint = lesser(greater(overlap(simd, pixel, x), overlap(simd, pixel, y)) / width, one);
    let number = half * (floor(simd, x) + floor(simd, y));
    let odd = splat(2.0) * (number - floor(simd, number));
    let checker = one - odd * splat(0.05) * greater(one - width * splat(1.0 / TILE), zero);
    checker * (one - splat(0.35) * joint)
}

/// Overlap of pixels, given by their halves, with the joints across an axis; `x` in tiles.
#[inline(always)]
fn overlap<S: Simd>(simd: S, pixel: Wide<S>, x: Wide<S>) -> Wide<S> {
    let grout = f32x8::splat(simd, 0.5 * GROUT);
    let from_joint = f32x8::splat(simd, TILE) * (x - floor(simd, x + f32x8::splat(simd, 0.5))).abs();
    let overlap = lesser(pixel, grout - from_joint) + lesser(pixel, grout + from_joint);
    greater(overlap, f32x8::splat(simd, 0.0))
}
