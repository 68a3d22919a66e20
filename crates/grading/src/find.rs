//! Finds bags, and names them independently of the folder in which the scorer was started.

use std::path::{Component, Path, PathBuf};

use fiatlux_bag::BagFiles;

use crate::ScoreError;

/// All bags, runs and unfinished recordings in these files and folders, to any depth.
pub fn find_bags(paths: &[PathBuf]) -> Result<BagFiles, ScoreError> {
    let found = BagFiles::find(paths)?;
    if found.bags.is_empty() && found.unfinished.is_empty() && found.runs.is_empty() {
        let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
        return Err(ScoreError::NoBags(names.join(", ")));
    }
    Ok(found)
}

/// The folders of runs that all paths belong to; `None` if there are only loose bags.
pub(crate) fn runs_of(found: &BagFiles) -> Result<Option<&[PathBuf]>, ScoreError> {
    if found.runs.is_empty() {
        return Ok(None);
    }
    let is_inside = |path: &PathBuf| found.runs.iter().any(|run| path.starts_with(run));
    match found.bags.iter().chain(&found.unfinished).all(is_inside) {
        true => Ok(Some(&found.runs)),
        false => Err(ScoreError::Runs(found.runs.clone())),
    }
}

/// A path relative to a folder, with `/` between its parts; unchanged if the two have no common root.
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
        let found = find_bags(&[root.clone(), deep.join("a.mcap")]).expect("found");
        assert_eq!(found.bags, [deep.join("a.mcap"), deep.join("b.mcap")]);
        assert_eq!(found.unfinished, [deep.join("c.mcap.part")]);
        assert_eq!(relative(&found.bags[0], &root), "S01/seed 0/a.mcap");
        assert_eq!(relative(&root.join("x.mcap"), &deep), "../../x.mcap");
        let error = find_bags(&[root.join("none")]).expect_err("missing").to_string();
        assert!(error.contains("none; check that it exists"), "{error}");
        std::fs::remove_file(deep.join("a.mcap")).expect("removed");
        for name in ["b.mcap", "c.mcap.part"] {
            std::fs::remove_file(deep.join(name)).expect("removed");
        }
        assert!(matches!(find_bags(std::slice::from_ref(&root)), Err(ScoreError::NoBags(_))));
        std::fs::remove_dir_all(root).expect("removed");
    }
}
