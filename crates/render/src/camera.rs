use fiatlux_robot::Robot;
use fiatlux_rules::Row;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::RenderError;

/// Width and height of the head camera's picture in the published benchmark, pixels.
pub const HEAD_PIXELS: usize = 256;
/// Half the head camera's field of view as a slope, both ways: horizontal aperture over twice the focal length of the
/// published benchmark's camera (69.4 degrees in all).
const HEAD_SLOPE: f64 = 20.955 / (2.0 * 15.13);
/// The head camera's near clipping distance in the published benchmark, m.
const HEAD_NEAR: f64 = 0.05;
const HEAD_MOUNT: &str = "d435_link";
const HEAD_LINK: &str = "head_link";

/// The head camera's field of view from left to right, rad.
pub fn head_fov() -> f64 {
    2.0 * libm::atan(HEAD_SLOPE)
}

/// A pinhole camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Pose: the camera looks along its x axis, its y axis points left in the picture and its z axis up, m.
    pub world_from_camera: Isometry3<f64>,
    /// From the left to the right edge, rad.
    pub horizontal_fov: f64,
    /// From the upper to the lower edge, rad.
    pub vertical_fov: f64,
    /// Nothing nearer than this along the axis is drawn, m.
    pub near: f64,
    /// A link of the robot that is not drawn, by link index: the head around a camera inside it.
    pub hidden_link: Option<usize>,
}

impl Camera {
    /// The camera in the robot's head, at the mount of its D435: 47.6 degrees downwards, [`HEAD_PIXELS`] square.
    ///
    /// # Errors
    /// A robot without that mount, or joint angles that it refuses.
    pub fn head(robot: &Robot, row: &Row) -> Result<Self, RenderError> {
        let Some(mount) = robot.link_index(HEAD_MOUNT) else {
            return Err(RenderError::NoMount { robot: robot.name().into(), link: HEAD_MOUNT });
        };
        let poses = robot.forward_kinematics(&row.joint_position, &row.robot.pose)?;
        let fov = head_fov();
        Ok(Self {
            world_from_camera: poses[mount],
            horizontal_fov: fov,
            vertical_fov: fov,
            near: HEAD_NEAR,
            hidden_link: robot.link_index(HEAD_LINK),
        })
    }

    /// The same camera for a picture of that size in square pixels: the horizontal field of view stays.
    pub fn fitted(mut self, width: usize, height: usize) -> Self {
        let slope = libm::tan(self.horizontal_fov / 2.0) * height as f64 / width as f64;
        self.vertical_fov = 2.0 * libm::atan(slope);
        self
    }

    /// A camera at `eye` (m, world) that looks at `target` with the horizon level. `vertical_fov` in rad; `aspect` is
    /// width over height of the picture, for square pixels.
    ///
    /// Where the view is straight up or down, the picture's top is towards +x.
    pub fn look_at(eye: Vector3<f64>, target: Vector3<f64>, vertical_fov: f64, aspect: f64) -> Self {
        let ahead = (target - eye).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let left = Vector3::z().cross(&ahead).try_normalize(1e-6).unwrap_or_else(Vector3::y);
        let up = ahead.cross(&left);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[ahead, left, up]));
        Self {
            world_from_camera: Isometry3::from_parts(
                Translation3::from(eye),
                UnitQuaternion::from_rotation_matrix(&rotation),
            ),
            horizontal_fov: 2.0 * libm::atan(aspect * libm::tan(vertical_fov / 2.0)),
            vertical_fov,
            near: 0.05,
            hidden_link: None,
        }
    }

    /// Where a point of the world (m) is in a picture of that size: pixels from its left and its upper edge, so that the
    /// first pixel's centre is at (0.5, 0.5). None for a point that is nearer than `near`.
    pub fn project(&self, point: &Vector3<f64>, width: usize, height: usize) -> Option<[f64; 2]> {
        let p = self.world_from_camera.inverse_transform_point(&Point3::from(*point));
        let [fx, fy] = self.focal(width, height);
        (p.x >= self.near).then(|| [width as f64 / 2.0 - fx * p.y / p.x, height as f64 / 2.0 - fy * p.z / p.x])
    }

    /// Focal lengths in pixels, horizontal and vertical.
    pub fn focal(&self, width: usize, height: usize) -> [f64; 2] {
        let half = |pixels: usize, fov: f64| pixels as f64 / 2.0 / libm::tan(fov / 2.0);
        [half(width, self.horizontal_fov), half(height, self.vertical_fov)]
    }
}
