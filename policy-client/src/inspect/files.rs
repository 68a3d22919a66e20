//! The files that an inspection writes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::scan::Scan;
use super::state::State;
use super::{document, pictures};

/// Names of the files.
const NAMES: [&str; 3] = ["camera.png", "lidar.png", "observation.json"];

/// Why a folder or file cannot be used.
#[derive(Debug, Error)]
pub enum FilesError {
    #[error("folder {} holds other files; name another one with --out, or add --force", .0.display())]
    Foreign(PathBuf),
    #[error("folder {} cannot be used; name another one with --out", .0.display())]
    Folder(PathBuf, #[source] std::io::Error),
    #[error("{} cannot be written", .0.display())]
    Write(PathBuf, #[source] std::io::Error),
    #[error("a picture cannot be encoded")]
    Png(#[from] png::EncodingError),
}

/// Refuses a folder with other files than those of an earlier inspection, unless `force` is set.
pub fn check(folder: &Path, force: bool) -> Result<(), FilesError> {
    let is_ours = |entry: std::fs::DirEntry| entry.file_name().to_str().is_some_and(|name| NAMES.contains(&name));
    match std::fs::read_dir(folder).map(|entries| entries.flatten().all(is_ours)) {
        Ok(false) if !force => Err(FilesError::Foreign(folder.to_owned())),
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(FilesError::Folder(folder.to_owned(), error)),
        _ => Ok(()),
    }
}

/// Writes what the state contains; returns the paths by content.
pub fn write(folder: &Path, state: &State) -> Result<BTreeMap<&'static str, String>, FilesError> {
    std::fs::create_dir_all(folder).map_err(|error| FilesError::Folder(folder.to_owned(), error))?;
    let scan = Scan::of(&state.info, &state.scanned);
    let pictures =
        [state.latest.camera.as_ref().and_then(pictures::camera), pictures::lidar(&state.scanned.lidar, scan.as_ref())];
    let [camera, lidar] = pictures.map(|picture| picture.map(|picture| picture.to_png()).transpose());
    let observation = Some(document::observation(state).into_bytes());
    let mut files = BTreeMap::new();
    for (name, bytes) in NAMES.into_iter().zip([camera?, lidar?, observation]) {
        let Some(bytes) = bytes else { continue };
        let path = folder.join(name);
        fiatlux_cli::write_whole(&path, bytes).map_err(|error| FilesError::Write(path.clone(), error))?;
        files.insert(name.split('.').next().unwrap_or(name), path.display().to_string());
    }
    Ok(files)
}
