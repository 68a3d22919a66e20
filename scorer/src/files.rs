//! Bags that are graded, and files that are written, for several commands.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fiatlux_cli::ProgressLine;
use fiatlux_grading::{GradeOptions, Results, grade};

/// Grades bags, with a line of progress.
pub fn graded(paths: &[PathBuf], options: &GradeOptions) -> Result<Results> {
    let line = ProgressLine::default();
    let graded = grade(paths, options, &|progress| {
        let left = || line.left(progress.bytes_done, progress.bytes);
        line.show(|| format!("{} of {} bags, {} left", progress.bags_done, progress.bags, left()));
    });
    line.clear();
    Ok(graded?)
}

/// Makes a folder; one without a name is the current one.
pub fn make(folder: &Path) -> Result<()> {
    if folder.as_os_str().is_empty() {
        return Ok(());
    }
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create the folder {}", folder.display()))
}

/// Writes a whole file, or none.
pub fn write(file: &Path, text: &str) -> Result<()> {
    fiatlux_cli::write_whole(file, text).with_context(|| format!("cannot write {}", file.display()))
}
