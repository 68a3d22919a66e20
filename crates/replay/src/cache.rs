//! Replays in compressed form, with a cache of recent ones.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use fiatlux_bag::Patience;

use crate::track::MAX_KEPT_ROWS;
use crate::{Packed, Replay, ReplayError};

/// Default maximum of replays in memory, of at most 30 MB each.
const MAX_REPLAYS: usize = 2;

/// Maximum number of blocks of shapes in memory, of at most 1 MB each.
const BLOCKS: usize = 32;

/// A replay in the compressed form that is sent to a browser.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PackedReplay {
    /// The document as JSON, see [`Replay::document_json`].
    pub document: Packed,
    /// Shapes that other episodes may have too, by their digests, see [`Block`](crate::Block).
    pub blocks: [(String, Packed); 2],
    /// Vertices and indices, see [`Replay::meshes`].
    pub meshes: Packed,
    /// The rows as bytes, see [`Replay::track`].
    pub track: Packed,
    pub joints: Packed,
    /// The cameras' pictures as bytes, see [`Replay::pictures`].
    pub pictures: Packed,
}

/// The state of the file that a replay was made from: a bag may still be growing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct FileState {
    path: PathBuf,
    length: u64,
    modified: Option<SystemTime>,
}

#[derive(Debug)]
pub struct ReplayCache {
    max_replays: usize,
    /// Replays in memory, most recently requested last.
    kept: Mutex<Vec<(FileState, PackedReplay)>>,
    /// Shapes of recently opened replays, by digest.
    blocks: Mutex<VecDeque<(String, Packed)>>,
}

impl Default for ReplayCache {
    fn default() -> Self {
        Self::keeping(MAX_REPLAYS)
    }
}

impl ReplayCache {
    /// Caches up to `max_replays`, of at most 30 MB each.
    pub fn keeping(max_replays: usize) -> Self {
        Self { max_replays: max_replays.max(1), kept: Mutex::default(), blocks: Mutex::default() }
    }

    /// The replay of a bag, shown as `name` if its file has another name here. Only one is read at a time, to limit the
    /// memory, and reading is limited by `patience`.
    pub fn show(
        &self,
        path: &Path,
        name: Option<&str>,
        patience: Option<Patience>,
    ) -> Result<PackedReplay, ReplayError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let metadata =
            fs::metadata(path).map_err(|source| ReplayError::Io { action: "read", path: path.into(), source })?;
        let state = FileState { path: path.into(), length: metadata.len(), modified: metadata.modified().ok() };
        let found = match kept.iter().position(|(known, _)| *known == state) {
            Some(at) => kept.remove(at).1,
            None => {
                let replay = Replay::open_with(path, MAX_KEPT_ROWS, patience)?;
                PackedReplay::from(match name {
                    Some(name) => replay.called(name),
                    None => replay,
                })
            }
        };
        kept.retain(|(known, _)| known.path != path);
        if kept.len() >= self.max_replays {
            kept.remove(0);
        }
        kept.push((state, found.clone()));
        let mut blocks = self.blocks.lock().unwrap_or_else(PoisonError::into_inner);
        for block in &found.blocks {
            blocks.retain(|(known, _)| *known != block.0);
            blocks.push_back(block.clone());
        }
        let surplus = blocks.len().saturating_sub(BLOCKS);
        blocks.drain(..surplus);
        Ok(found)
    }

    /// Shapes by their digest, if a replay that has them was opened recently.
    pub fn block(&self, digest: &str) -> Option<Packed> {
        let blocks = self.blocks.lock().unwrap_or_else(PoisonError::into_inner);
        blocks.iter().find(|(known, _)| known == digest).map(|(_, block)| block.clone())
    }
}

impl From<Replay> for PackedReplay {
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
