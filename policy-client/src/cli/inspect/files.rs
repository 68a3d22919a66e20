//! The files that `inspect` leaves.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;

use super::Failure;
use super::scan::Scan;
use super::state::State;
use super::{document, pictures};

/// What `inspect` writes.
const NAMES: [&str; 3] = ["camera.png", "lidar.png", "observation.json"];

/// Refuses a folder that has something else in it than an earlier `inspect` left, unless by force: before a session is
/// opened.
pub fn check(folder: &Path, force: bool) -> Result<(), Failure> {
    let name = folder.display();
    let cannot = |error: std::io::Error| {
        Failure::Usage(format!("folder {name} cannot be used: {error}; name another one with --out"))
    };
    let is_ours = |entry: std::fs::DirEntry| entry.file_name().to_str().is_some_and(|name| NAMES.contains(&name));
    match std::fs::read_dir(folder).map(|entries| entries.flatten().all(is_ours)) {
        Ok(false) if !force => {
            Err(Failure::Usage(format!("folder {name} holds other files; name another one with --out, or add --force")))
        }
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(cannot(error)),
        _ => Ok(()),
    }
}

/// Writes what the state has; the paths by what they hold.
pub fn write(folder: &Path, state: &State) -> Result<BTreeMap<&'static str, String>, anyhow::Error> {
    std::fs::create_dir_all(folder).with_context(|| format!("folder {} cannot be made", folder.display()))?;
    let scan = Scan::of(&state.info, &state.scanned);
    let pictures = [
        ("camera", state.latest.camera.as_ref().and_then(pictures::camera)),
        ("lidar", pictures::lidar(&state.scanned.lidar, scan.as_ref())),
    ];
    let mut files = BTreeMap::new();
    let mut put = |what, name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).with_context(|| format!("{} cannot be written", path.display()))?;
        files.insert(what, path.display().to_string());
        anyhow::Ok(())
    };
    for (what, picture) in pictures {
        if let Some(picture) = picture {
            put(what, &format!("{what}.png"), &picture.to_png()?)?;
        }
    }
    put("observation", "observation.json", document::observation(state).as_bytes())?;
    Ok(files)
}
