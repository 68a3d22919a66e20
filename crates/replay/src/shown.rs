//! Replays in the form that is sent, with a cache of recent ones.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use fiatlux_bag::Patience;

use crate::track::MOST_KEPT as MOST_ROWS;
use crate::{Packed, Replay, ReplayError};

/// Default number of replays to keep in memory, of at most 75 MB each.
const MOST_KEPT: usize = 2;

/// Number of blocks of shapes to keep, of at most 1 MB each.
const BLOCKS: usize = 32;

/// A replay in the form that is sent to a browser.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shown {
    /// The document as JSON, see [`Replay::document_json`].
    pub document: Packed,
    /// Shapes that other episodes may have too, by their digests, see [`Block`](crate::Block).
    pub blocks: [(String, Packed); 2],
    /// Vertices and indices, see [`Replay::meshes`].
    pub meshes: Packed,
    /// The rows as bytes, see [`Replay::track`].
    pub track: Packed,
    /// The joints as bytes, see [`Replay::joints`].
    pub joints: Packed,
    /// The head camera's pictures as bytes, see [`Replay::pictures`].
    pub pictures: Packed,
}

/// The file that a replay was made of, and its state then: a bag may still be growing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Edition {
    path: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

/// Reads replays, and keeps recent ones in memory.
#[derive(Debug)]
pub struct Desk {
    most: usize,
    /// Replays in memory, most recently requested last.
    kept: Mutex<Vec<(Edition, Shown)>>,
    /// Shapes of the replays that were opened last, by digest.
    blocks: Mutex<VecDeque<(String, Packed)>>,
}

impl Default for Desk {
    fn default() -> Self {
        Self::keeping(MOST_KEPT)
    }
}

impl Desk {
    /// Keeps up to `most` replays, of at most 75 MB each.
    pub fn keeping(most: usize) -> Self {
        Self { most: most.max(1), kept: Mutex::default(), blocks: Mutex::default() }
    }

    /// The replay of a bag, shown under `name` if its file has another name here. Only one is read at a time, to limit
    /// the memory, and no longer than its `patience`.
    ///
    /// # Errors
    /// As for [`Replay::open`].
    pub fn show(&self, path: &Path, name: Option<&str>, patience: Option<Patience>) -> Result<Shown, ReplayError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let metadata =
            fs::metadata(path).map_err(|source| ReplayError::Io { action: "read", path: path.into(), source })?;
        let edition = Edition { path: path.into(), length: metadata.len(), modified: metadata.modified().ok() };
        let found = match kept.iter().position(|(known, _)| *known == edition) {
            Some(at) => kept.remove(at).1,
            None => {
                let replay = Replay::open_with(path, MOST_ROWS, patience)?;
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
        let mut blocks = self.blocks.lock().unwrap_or_else(PoisonError::into_inner);
        for block in &found.blocks {
            blocks.retain(|(known, _)| *known != block.0);
            blocks.push_back(block.clone());
        }
        let surplus = blocks.len().saturating_sub(BLOCKS);
        blocks.drain(..surplus);
        Ok(found)
    }

    /// Shapes by their digest, if a replay that has them was opened lately.
    pub fn block(&self, digest: &str) -> Option<Packed> {
        let blocks = self.blocks.lock().unwrap_or_else(PoisonError::into_inner);
        blocks.iter().find(|(known, _)| known == digest).map(|(_, block)| block.clone())
    }
}

impl From<Replay> for Shown {
    fn from(replay: Replay) -> Self {
        Self {
            document: Packed::new(replay.document_json().as_bytes()),
            blocks: [0, 1].map(|part| {
                let stage = &replay.document().stage;
                (stage.blocks[part].digest.clone(), Packed::new(&stage.block_bytes[part]))
            }),
            meshes: Packed::new(replay.meshes()),
            track: Packed::new(replay.track()),
            joints: Packed::new(replay.joints()),
            pictures: Packed::new(replay.pictures()),
        }
    }
}
