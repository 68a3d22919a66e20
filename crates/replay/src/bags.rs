//! The episodes that are shown, and what is known of each without reading its rows.

use std::path::{Path, PathBuf};

use fiatlux_bag::{Bag, BagFiles, Completeness};
use fiatlux_proto::v3::Judgement;
use fiatlux_rules::CONTROL_DT;
use serde::Serialize;

use crate::text::short;
use crate::{EpisodeInfo, ReplayError};

/// Most bags that are listed: opening one takes about a millisecond.
const MOST_LISTED: usize = 2000;

/// The bags of a file or folder, unfinished ones among them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bags {
    folder: PathBuf,
    files: Vec<PathBuf>,
}

/// What a rulebook said of an episode when it was recorded.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedRuling {
    /// Cause of the end; empty where the rows stop before.
    pub cause: String,
    /// Gate progress, 0 to 1.
    pub progress: f64,
}

/// A bag of the list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entry {
    /// Its index, which is its address.
    pub index: usize,
    /// Path inside of the folder.
    pub name: String,
    /// Task and its name.
    pub title: String,
    /// Name of the policy.
    pub policy: String,
    /// Layout seed, in decimal digits.
    pub seed: String,
    /// What the strict rulebook said; none where there is no result, or where it was played by the published one.
    pub strict: Option<RecordedRuling>,
    /// What the published rulebook said.
    pub published: Option<RecordedRuling>,
    /// Length, s; none where there is no result.
    pub seconds: Option<f64>,
    /// What a viewer should know, such as that it is cut.
    pub note: String,
    /// Why it cannot be opened; none where it can.
    pub error: Option<String>,
}

/// The list of episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Listing {
    /// The folder, as it was named.
    pub folder: String,
    /// The bags, by path.
    pub entries: Vec<Entry>,
    /// Bags that are not in the list, because they are too many.
    pub left_out: usize,
}

impl Bags {
    /// The bags of a folder, to any depth, or the one of a file.
    ///
    /// # Errors
    /// [`ReplayError`]: a path that is missing or may not be read, or a folder without bags.
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

    /// Number of bags, at least 1.
    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// A bag's file.
    pub fn file(&self, index: usize) -> Option<&Path> {
        self.files.get(index).map(PathBuf::as_path)
    }

    /// Reads header and result of each bag.
    pub fn list(&self) -> Listing {
        let entry = |(index, path): (usize, &PathBuf)| self.entry(index, path);
        Listing {
            folder: short(&self.folder.display().to_string()),
            entries: self.files.iter().take(MOST_LISTED).enumerate().map(entry).collect(),
            left_out: self.files.len().saturating_sub(MOST_LISTED),
        }
    }

    fn entry(&self, index: usize, path: &Path) -> Entry {
        let name = path.strip_prefix(&self.folder).unwrap_or(path);
        let mut entry = Entry {
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
