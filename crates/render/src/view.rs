//! The camera in single precision.

use nalgebra::Vector3;

use crate::Camera;
use crate::raster::Corner;
use crate::single::{Vec3, add, dot, scale, single, sub};

/// The camera as the rasteriser takes it.
pub(crate) struct View {
    pub eye: Vec3,
    pub axes: [Vec3; 3],
    pub focal: [f32; 2],
    pub inverse_focal: [f32; 2],
    pub middle: [f32; 2],
    pub near: f32,
    /// Width and height of the picture, samples.
    pub size: [usize; 2],
}

impl View {
    pub(crate) fn new(camera: &Camera, [width, height]: [usize; 2]) -> Self {
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
            size: [width, height],
        }
    }

    /// From the eye through a pixel, one metre ahead.
    #[inline]
    pub(crate) fn ray(&self, x: usize, y: usize) -> Vec3 {
        add(self.axes[0], add(scale(self.axes[1], self.left_of(x)), scale(self.axes[2], self.up_of(y))))
    }

    /// Distance of a column to the left, one metre ahead, m.
    #[inline]
    pub(crate) fn left_of(&self, x: usize) -> f32 {
        (self.middle[0] - x as f32) * self.inverse_focal[0]
    }

    /// Distance of a row above the middle, one metre ahead, m.
    #[inline]
    pub(crate) fn up_of(&self, y: usize) -> f32 {
        (self.middle[1] - y as f32) * self.inverse_focal[1]
    }

    #[inline(always)]
    pub(crate) fn project(&self, at: Vec3) -> Corner {
        let depth = 1.0 / at[0];
        let u = self.middle[0] - self.focal[0] * at[1] * depth;
        let v = self.middle[1] - self.focal[1] * at[2] * depth;
        Corner { u, v, depth }
    }

    /// True if a sphere can be in the picture.
    pub(crate) fn reaches(&self, center: Vec3, radius: f32) -> bool {
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
