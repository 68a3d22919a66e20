//! Which file of a folder is which link's.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use fiatlux_robot::Robot;

use crate::error::MeshError;

/// Files whose names are not those of their links: name without ending, link.
const ALIASES: &str = include_str!("aliases.txt");

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Stl,
    Obj,
}

/// A file that is named after a link.
#[derive(Debug)]
pub(super) struct MeshFile {
    pub name: String,
    pub path: PathBuf,
    pub link: usize,
    pub format: Format,
    /// Numbers behind `_rev_`; none is the earliest.
    revision: Vec<u32>,
}

/// The files that are used, sorted by name: of each link the one of the latest revision.
pub(super) fn files(folder: &Path, robot: &Robot) -> Result<Vec<MeshFile>, MeshError> {
    let unreadable = |source| MeshError::Folder { path: folder.into(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        // Only plain files, also at the end of a link: another kind might never end.
        if let Some(file) = MeshFile::of(path, robot)
            && file.path.is_file()
        {
            found.push(file);
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    let mut chosen: BTreeMap<usize, MeshFile> = BTreeMap::new();
    let mut twins = BTreeMap::new();
    for file in found {
        match chosen.get(&file.link) {
            Some(other) if other.revision > file.revision => continue,
            Some(other) if other.revision == file.revision => {
                twins.insert(file.link, [other.name.clone(), file.name.clone()]);
            }
            _ => {
                twins.remove(&file.link);
                chosen.insert(file.link, file);
            }
        }
    }
    if let Some((link, files)) = twins.pop_first() {
        let link = robot.links()[link].name.clone();
        return Err(MeshError::Twice { folder: folder.into(), link, files });
    }
    if chosen.is_empty() {
        return Err(MeshError::NoLink { folder: folder.into(), robot: robot.name().into(), expected: expected(robot) });
    }
    let mut files: Vec<MeshFile> = chosen.into_values().collect();
    files.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(files)
}

impl MeshFile {
    /// None for a file that is not named after a link.
    fn of(path: PathBuf, robot: &Robot) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_owned();
        let (stem, ending) = name.rsplit_once('.')?;
        let format = match ending.to_ascii_lowercase().as_str() {
            "stl" => Format::Stl,
            "obj" => Format::Obj,
            _ => return None,
        };
        let (link, revision) = match robot.link_index(stem).or_else(|| robot.link_index(alias(stem)?)) {
            Some(link) => (link, Vec::new()),
            None => {
                let (base, revision) = stem.rsplit_once("_rev_")?;
                let numbers: Result<_, _> = revision.split('_').map(str::parse).collect();
                (robot.link_index(base)?, numbers.ok()?)
            }
        };
        Some(Self { name, path, link, format, revision })
    }
}

/// The link that the file is meant for.
fn alias(stem: &str) -> Option<&'static str> {
    let mut pairs = ALIASES.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_once(' '));
    pairs.find(|(name, _)| *name == stem).map(|(_, link)| link)
}

/// Some names that a file could have.
fn expected(robot: &Robot) -> String {
    let links = robot.links().iter().filter(|link| link.mass > 0.01);
    links.take(4).map(|link| format!("{}.stl", link.name)).collect::<Vec<_>>().join(", ")
}
