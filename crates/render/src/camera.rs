use fiatlux_robot::Robot;
use fiatlux_rules::Row;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::RenderError;

/// Width and height of the head camera's picture in the published benchmark, pixels.
pub const HEAD_PIXELS: usize = 256;
/// Name of the head camera in a robot's file.
pub const HEAD_CAMERA: &str = "head_camera";

/// A pinhole camera: a pose and two angles, without lens distortion.
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
    /// The camera in the robot's head: 47.6 degrees downwards on the G1, for a square picture.
    pub fn head(robot: &Robot, row: &Row) -> Result<Self, RenderError> {
        Self::mounted(robot, HEAD_CAMERA, row)
    }

    /// A camera of the robot by its name in the robot's file, for a square picture.
    ///
    /// # Errors
    /// A robot without that camera, or joint angles that it refuses.
    pub fn mounted(robot: &Robot, name: &str, row: &Row) -> Result<Self, RenderError> {
        let no_mount = || RenderError::NoMount { robot: robot.name().into(), camera: name.into() };
        let mount = robot.camera(name).ok_or_else(no_mount)?;
        let poses = robot.forward_kinematics(&row.joint_position, &row.robot.pose)?;
        Ok(Self {
            world_from_camera: poses[mount.link] * mount.link_from_camera,
            horizontal_fov: mount.horizontal_fov,
            vertical_fov: mount.horizontal_fov,
            near: mount.near,
            hidden_link: mount.hidden_link,
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
