use std::io;
use std::path::{Path, PathBuf};

use fiatlux_robot::RobotError;
use thiserror::Error;

/// Why there is neither camera nor picture file.
#[derive(Debug, Error)]
pub enum RenderError {
    #[error("robot '{robot}' has no camera '{camera}'; add a [[camera]] of that name to its file")]
    NoMount { robot: String, camera: String },
    #[error("cannot place the camera")]
    Posture(#[from] RobotError),
    #[error("cannot write the image as PNG")]
    Png(#[from] png::EncodingError),
}

/// Why the meshes of a folder cannot be used.
#[derive(Debug, Error)]
pub enum MeshError {
    #[error("cannot list the folder {}; name one with an STL or OBJ file for each link", path.display())]
    Folder { path: PathBuf, source: io::Error },
    #[error(
        "no file in {} is named after a link of robot '{robot}'; expected names such as {expected}",
        folder.display()
    )]
    NoLink { folder: PathBuf, robot: String, expected: String },
    #[error("{} and {} in {} are both for link '{link}'; leave one of them", files[0], files[1], folder.display())]
    Twice { folder: PathBuf, link: String, files: [String; 2] },
    #[error("cannot read {}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot use {}: {problem}", path.display())]
    Content { path: PathBuf, problem: String },
}

impl MeshError {
    pub(crate) fn content(path: &Path, problem: impl Into<String>) -> Self {
        Self::Content { path: path.into(), problem: problem.into() }
    }
}
