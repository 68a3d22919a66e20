//! The list of episodes, made from headers and results without reading rows.

use std::path::{Path, PathBuf};

use fiatlux_bag::{Bag, BagFiles, Completeness};
use fiatlux_proto::v3::Judgement;
use fiatlux_rules::CONTROL_DT;
use serde::Serialize;

use crate::text::short;
use crate::{EpisodeInfo, ReplayError};

/// Maximum number of bags in a list: opening one takes about a millisecond.
const MAX_LISTED: usize = 2000;

/// The bags of a file or folder, including unfinished ones.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bags {
    folder: PathBuf,
    files: Vec<PathBuf>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedRuling {
    /// Cause of the end; empty if the rows stop before it.
    pub cause: String,
    pub progress: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BagEntry {
    /// Index of the bag, from 0, which is part of its address.
    pub index: usize,
    pub name: String,
    /// Id and name of the task, such as `S07 Approach New Bulb`.
    pub title: String,
    pub policy: String,
    /// Layout seed, in decimal digits.
    pub seed: String,
    /// Verdict of the strict judge; `None` without a result, or if the published judge was in force.
    pub strict: Option<RecordedRuling>,
    /// Verdict of the published judge; `None` without a result.
    pub published: Option<RecordedRuling>,
    /// Length of the episode, s; `None` without a result.
    pub seconds: Option<f64>,
    /// Remark for the viewer, for example that the bag is cut; may be empty.
    pub note: String,
    pub error: Option<String>,
}

/// The list of episodes, as JSON for the page.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Listing {
    pub folder: String,
    pub entries: Vec<BagEntry>,
    /// Number of bags that exceed the limit of the list.
    pub left_out: usize,
}

impl Bags {
    /// Finds the bags of a folder, to any depth, or takes the one of a file.
    pub fn find(path: &Path) -> Result<Self, ReplayError> {
        let found = BagFiles::find(&[path.to_path_buf()])?;
        let mut files = found.bags;
        files.extend(found.unfinished);
        files.sort();
        if files.is_empty() {
            return Err(ReplayError::NoBags { folder: path.into() });
        }
        Ok(Self { folder: path.into(), files })
    }

    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// Path of the bag at an index; `None` if there are fewer.
    pub fn file(&self, index: usize) -> Option<&Path> {
        self.files.get(index).map(PathBuf::as_path)
    }

    pub fn list(&self) -> Listing {
        let entry = |(index, path): (usize, &PathBuf)| self.entry(index, path);
        Listing {
            folder: short(&self.folder.display().to_string()),
            entries: self.files.iter().take(MAX_LISTED).enumerate().map(entry).collect(),
            left_out: self.files.len().saturating_sub(MAX_LISTED),
        }
    }

    fn entry(&self, index: usize, path: &Path) -> BagEntry {
        let name = path.strip_prefix(&self.folder).unwrap_or(path);
        let mut entry = BagEntry {
            index,
            name: short(&name.display().to_string()),
            title: String::new(),
            policy: String::new(),
            seed: String::new(),
            strict: None,
            published: None,
            seconds: None,
            note: String::new(),
            error: None,
        };
        let bag = match Bag::open(path) {
            Ok(bag) => bag,
            Err(error) => {
                entry.error = Some(short(&error.to_string()));
                return entry;
            }
        };
        let info = EpisodeInfo::new(bag.header(), path);
        entry.title = match info.name.as_str() {
            "" => info.task,
            name if name.eq_ignore_ascii_case(&info.task) => info.name,
            name => format!("{} {name}", info.task),
        };
        (entry.policy, entry.seed) = (info.policy, info.seed);
        if let Some(result) = bag.result() {
            (entry.strict, entry.published) = (ruling(&result.strict), ruling(&result.published));
            entry.seconds = result.end.as_ref().map(|end| end.steps as f64 * CONTROL_DT);
        }
        if let Completeness::Cut { .. } = bag.completeness() {
            "cut".clone_into(&mut entry.note);
        }
        entry
    }
}

fn ruling(judgement: &Option<Judgement>) -> Option<RecordedRuling> {
    let judgement = judgement.as_ref()?;
    let progress = if judgement.gate_progress.is_finite() { judgement.gate_progress } else { 0.0 };
    Some(RecordedRuling { cause: short(&judgement.cause), progress })
}
