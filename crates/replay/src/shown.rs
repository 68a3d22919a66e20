//! Replays as they are sent, and those that were asked for last.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use axum::body::Bytes;

use crate::{Replay, ReplayError};

/// Replays that are kept in memory by default, of at most 50 MB each.
const MOST_KEPT: usize = 2;

/// A replay as it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shown {
    /// What it shows, as JSON.
    pub document: Bytes,
    /// See [`Replay::meshes`].
    pub meshes: Bytes,
    /// See [`Replay::track`].
    pub track: Bytes,
}

/// Which file it was made of, and which version of it: a bag may still be growing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Edition {
    path: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

/// Reads replays, and keeps those that were asked for last.
#[derive(Debug)]
pub struct Desk {
    most: usize,
    /// The last one is the one that was asked for last.
    kept: Mutex<Vec<(Edition, Shown)>>,
}

impl Default for Desk {
    fn default() -> Self {
        Self::keeping(MOST_KEPT)
    }
}

impl Desk {
    /// Keeps at most so many replays, of at most 50 MB each.
    pub fn keeping(most: usize) -> Self {
        Self { most: most.max(1), kept: Mutex::default() }
    }

    /// The replay of a bag; `name` is what its file is called for people, where that is not the name that it has here.
    /// One is read at a time, which bounds the memory.
    ///
    /// # Errors
    /// As [`Replay::open`].
    pub fn show(&self, path: &Path, name: Option<&str>) -> Result<Shown, ReplayError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let metadata =
            fs::metadata(path).map_err(|source| ReplayError::Io { action: "read", path: path.into(), source })?;
        let edition = Edition { path: path.into(), length: metadata.len(), modified: metadata.modified().ok() };
        let found = match kept.iter().position(|(known, _)| *known == edition) {
            Some(at) => kept.remove(at).1,
            None => {
                let replay = Replay::open(path)?;
                Shown::from(match name {
                    Some(name) => replay.called(name),
                    None => replay,
                })
            }
        };
        kept.retain(|(known, _)| known.path != path);
        if kept.len() >= self.most {
            kept.remove(0);
        }
        kept.push((edition, found.clone()));
        Ok(found)
    }
}

impl From<Replay> for Shown {
    fn from(replay: Replay) -> Self {
        let document = Bytes::from(replay.document_json());
        let (meshes, track) = replay.into_bytes();
        Self { document, meshes: meshes.into(), track: track.into() }
    }
}
