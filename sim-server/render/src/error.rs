use fiatlux_robot::RobotError;
use thiserror::Error;

/// Why there is no camera or no picture file.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The robot has no link that carries the head camera.
    #[error("robot '{robot}' has no link '{link}' to carry the head camera; add one to its file")]
    NoMount {
        /// Name of the robot.
        robot: String,
        /// The link.
        link: &'static str,
    },
    /// The row's joint angles are no posture of the robot.
    #[error("cannot place the head camera")]
    Posture(#[from] RobotError),
    /// The image does not fit a PNG file.
    #[error("cannot write the image as PNG")]
    Png(#[from] png::EncodingError),
}
