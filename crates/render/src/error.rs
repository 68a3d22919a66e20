use std::io;
use std::path::{Path, PathBuf};

use fiatlux_robot::RobotError;
use thiserror::Error;

/// Why there is neither camera nor picture file.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The robot has no camera of that name.
    #[error("robot '{robot}' has no camera '{camera}'; add a [[camera]] of that name to its file")]
    NoMount {
        /// Name of the robot.
        robot: String,
        /// Name of the camera that is missing.
        camera: String,
    },
    /// The row's joint angles do not make a posture of the robot.
    #[error("cannot place the camera")]
    Posture(#[from] RobotError),
    /// The image does not fit a PNG file.
    #[error("cannot write the image as PNG")]
    Png(#[from] png::EncodingError),
}

/// Why the meshes of a folder cannot be used.
#[derive(Debug, Error)]
pub enum MeshError {
    /// The folder cannot be listed.
    #[error("cannot list the folder {}; name one with an STL or OBJ file for each link", path.display())]
    Folder {
        /// Path of the folder, as it was given.
        path: PathBuf,
        /// The system's error.
        #[source]
        source: io::Error,
    },
    /// No file is named after a link.
    #[error(
        "no file in {} is named after a link of robot '{robot}'; expected names such as {expected}",
        folder.display()
    )]
    NoLink {
        /// Path of the folder, as it was given.
        folder: PathBuf,
        /// Name of the robot.
        robot: String,
        /// Some names that fit.
        expected: String,
    },
    /// Two files are for the same link.
    #[error("{} and {} in {} are both for link '{link}'; leave one of them", files[0], files[1], folder.display())]
    Twice {
        /// Path of the folder, as it was given.
        folder: PathBuf,
        /// Name of the link that both files are for.
        link: String,
        /// Names of the files.
        files: [String; 2],
    },
    /// A file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// Path of the file that cannot be read.
        path: PathBuf,
        /// The system's error.
        #[source]
        source: io::Error,
    },
    /// A file's content is not the mesh of a link.
    #[error("cannot use {}: {problem}", path.display())]
    Content {
        /// Path of the file that cannot be used.
        path: PathBuf,
        /// Fault and remedy.
        problem: String,
    },
}

impl MeshError {
    pub(crate) fn content(path: &Path, problem: impl Into<String>) -> Self {
        Self::Content { path: path.into(), problem: problem.into() }
    }
}
