//! Finds bags in folders.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::leftover::is_leftover;
use crate::run::is_journal;

/// Folder of the bags of an evaluation, below its own.
pub const BAGS: &str = "bags";

/// File name of the bag of an episode that belongs to no run: `TASK-sSEED-eEPISODE.mcap`.
pub fn bag_name(task: &str, seed: u64, episode: u64) -> String {
    format!("{task}-s{seed}-e{episode}.mcap")
}

#[derive(Debug, Error)]
#[error("cannot look into {}; check that it exists and may be read", path.display())]
pub struct FindError {
    pub path: PathBuf,
    #[source]
    pub source: io::Error,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BagFiles {
    /// `*.mcap`, and files named explicitly.
    pub bags: Vec<PathBuf>,
    /// Recordings that were never finished, `*.mcap.part`.
    pub unfinished: Vec<PathBuf>,
    /// Folders with the journal of a run; the files in them are listed as well.
    pub runs: Vec<PathBuf>,
}

impl BagFiles {
    /// Looks through files and folders, folders to any depth. Each list is sorted and has each file once. What file systems and
    /// file managers leave in folders is ignored: `._NAME` of macOS, recycle bins, and other hidden ones.
    pub fn find(paths: &[PathBuf]) -> Result<Self, FindError> {
        let mut found = Self::default();
        for path in paths {
            if path.metadata().map_err(of(path))?.is_dir() {
                found.search(path)?;
            } else if is_unfinished(path) {
                found.unfinished.push(path.clone());
            } else {
                found.bags.push(path.clone());
            }
        }
        for list in [&mut found.bags, &mut found.unfinished, &mut found.runs] {
            list.sort();
            list.dedup();
        }
        Ok(found)
    }

    fn search(&mut self, folder: &Path) -> Result<(), FindError> {
        let mut is_run = false;
        for entry in fs::read_dir(folder).map_err(of(folder))? {
            let entry = entry.map_err(of(folder))?;
            let path = entry.path();
            if is_leftover(&path) {
                continue;
            }
            // A link to a folder above would never end.
            let is_link = entry.file_type().map_err(of(&path))?.is_symlink();
            is_run |= is_journal(&path);
            if path.is_dir() {
                if !is_link {
                    self.search(&path)?;
                }
            } else if is_unfinished(&path) {
                self.unfinished.push(path);
            } else if path.extension().is_some_and(|extension| extension == "mcap") {
                self.bags.push(path);
            }
        }
        if is_run {
            self.runs.push(folder.to_path_buf());
        }
        Ok(())
    }
}

fn of(path: &Path) -> impl FnOnce(io::Error) -> FindError {
    move |source| FindError { path: path.into(), source }
}

fn is_unfinished(path: &Path) -> bool {
    path.to_string_lossy().ends_with(".mcap.part")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards that the folder of a run is the same folder after it has been on another computer's disk.
    #[test]
    fn leftovers_of_file_systems_are_ignored() {
        let root = std::env::temp_dir().join(format!("fiatlux-leftovers-{}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        let write = |name: &str| {
            let path = root.join(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, "x").expect("written");
        };
        ["a.mcap", "lab.run.jsonl", "b.mcap.part"].into_iter().for_each(write);
        let kept = BagFiles::find(std::slice::from_ref(&root)).expect("found");
        assert_eq!((kept.bags.len(), kept.unfinished.len(), kept.runs.len()), (1, 1, 1));
        let leftovers = [
            "._a.mcap",
            "._lab.run.jsonl",
            "._b.mcap.part",
            ".nfs0001.mcap",
            ".DS_Store",
            ".Trash-1000/files/c.mcap",
            "$RECYCLE.BIN/S-1-5/$R1.mcap",
            "$I1.mcap",
            "lost+found/d.mcap",
            "__MACOSX/._a.mcap",
            "__MACOSX/e.mcap",
            "@eaDir/a.mcap/x.mcap",
            "@Recycle/a.mcap",
            "#recycle/a.mcap",
            "#snapshot/daily/a.mcap",
            "~$a.mcap",
            "System Volume Information/f.mcap",
            "Thumbs.db",
            "desktop.ini",
        ];
        leftovers.into_iter().for_each(write);
        assert_eq!(BagFiles::find(std::slice::from_ref(&root)).expect("found"), kept);
        assert_eq!(crate::run::journals(&root).expect("read").len(), 1);
        // One that is named is meant.
        let named = BagFiles::find(&[root.join("._a.mcap")]).expect("found");
        assert_eq!(named.bags.len(), 1);
        fs::remove_dir_all(root).expect("removed");
    }
}
