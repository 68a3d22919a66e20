//! Finds bags, and names them in a way that does not depend on where the scorer was started.

use std::path::{Component, Path, PathBuf};

use fiatlux_bag::run::journals;

use crate::ScoreError;

/// Bags, recordings that were never finished, and runs.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Found {
    /// `*.mcap`, and files that were named one by one.
    pub bags: Vec<PathBuf>,
    /// `*.mcap.part`.
    pub unfinished: Vec<PathBuf>,
    /// Folders that have the journal of a run; what is in them is found as well.
    pub runs: Vec<PathBuf>,
}

impl Found {
    /// The run that all of it belongs to; `None` where there are loose bags only.
    pub fn run(&self) -> Result<Option<&Path>, ScoreError> {
        let Some(first) = self.runs.first() else { return Ok(None) };
        let is_inside = |path: &PathBuf| path.starts_with(first);
        match self.runs.len() == 1 && self.bags.iter().chain(&self.unfinished).all(is_inside) {
            true => Ok(Some(first)),
            false => Err(ScoreError::Runs(self.runs.clone())),
        }
    }
}

/// Looks through files and folders, folders to any depth. Sorted, each file once.
pub(crate) fn find(paths: &[PathBuf]) -> Result<Found, ScoreError> {
    let mut found = Found::default();
    for path in paths {
        let fail = |source| ScoreError::Path { path: path.clone(), source };
        if path.metadata().map_err(fail)?.is_dir() {
            search(path, &mut found)?;
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
    if found.bags.is_empty() && found.unfinished.is_empty() && found.runs.is_empty() {
        let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
        return Err(ScoreError::NoBags(names.join(", ")));
    }
    Ok(found)
}

fn search(folder: &Path, found: &mut Found) -> Result<(), ScoreError> {
    let fail = |source| ScoreError::Path { path: folder.to_path_buf(), source };
    if !journals(folder)?.is_empty() {
        found.runs.push(folder.to_path_buf());
    }
    for entry in folder.read_dir().map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        // A link to a folder above would never end.
        let is_link = entry.file_type().map_err(fail)?.is_symlink();
        if path.is_dir() {
            if !is_link {
                search(&path, found)?;
            }
        } else if is_unfinished(&path) {
            found.unfinished.push(path);
        } else if path.extension().is_some_and(|extension| extension == "mcap") {
            found.bags.push(path);
        }
    }
    Ok(())
}

fn is_unfinished(path: &Path) -> bool {
    path.to_string_lossy().ends_with(".mcap.part")
}

/// A path as seen from a folder, with `/` between its parts; as it is where the two have no common root.
pub(crate) fn relative(path: &Path, folder: &Path) -> String {
    let absolute = |path: &Path| path.canonicalize().or_else(|_| std::path::absolute(path));
    let (Ok(target), Ok(base)) = (absolute(path), absolute(folder)) else {
        return path.to_string_lossy().into_owned();
    };
    let (target, base): (Vec<Component<'_>>, Vec<Component<'_>>) =
        (target.components().collect(), base.components().collect());
    let common = target.iter().zip(&base).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return path.to_string_lossy().into_owned();
    }
    let up = base[common..].iter().map(|_| "..".to_owned());
    let down = target[common..].iter().map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_searched() {
        let root = std::env::temp_dir().join(format!("fiatlux-find-{}", std::process::id()));
        let deep = root.join("S01/seed 0");
        std::fs::create_dir_all(&deep).expect("a folder");
        for name in ["b.mcap", "a.mcap", "c.mcap.part", "notes.txt"] {
            std::fs::write(deep.join(name), "").expect("a file");
        }
        let found = find(&[root.clone(), deep.join("a.mcap")]).expect("found");
        assert_eq!(found.bags, [deep.join("a.mcap"), deep.join("b.mcap")]);
        assert_eq!(found.unfinished, [deep.join("c.mcap.part")]);
        assert_eq!(relative(&found.bags[0], &root), "S01/seed 0/a.mcap");
        assert_eq!(relative(&root.join("x.mcap"), &deep), "../../x.mcap");
        let error = find(&[root.join("none")]).expect_err("missing").to_string();
        assert!(error.contains("none; check that it exists"), "{error}");
        std::fs::remove_file(deep.join("a.mcap")).expect("removed");
        for name in ["b.mcap", "c.mcap.part"] {
            std::fs::remove_file(deep.join(name)).expect("removed");
        }
        assert!(matches!(find(std::slice::from_ref(&root)), Err(ScoreError::NoBags(_))));
        std::fs::remove_dir_all(root).expect("removed");
    }
}
