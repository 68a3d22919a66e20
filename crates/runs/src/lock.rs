//! Allows one evaluation at a time in a folder.

use std::fs::File;
use std::path::Path;

use fiatlux_bag::lock_folder;

use crate::job::{EvaluateError, folder};

const NAME: &str = "evaluate.lock";

/// Locks a folder while an evaluation runs.
///
/// # Errors
/// Another evaluation holds it, or the file cannot be made.
pub(super) fn lock(out: &Path) -> Result<File, EvaluateError> {
    let taken = "another evaluation is at work in it; wait for its end, or name another folder with --out";
    lock_folder(out, NAME).map_err(|error| folder(&out.join(NAME), error))?.ok_or_else(|| folder(out, taken))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_taken_folder_is_named_with_the_remedy() {
        let out = std::env::temp_dir().join(format!("fiatlux-evaluate-lock-{}", std::process::id()));
        std::fs::create_dir_all(&out).expect("makes a folder");
        let _first = lock(&out).expect("it is free");
        let error = lock(&out).expect_err("it is taken").to_string();
        assert!(error.contains("another evaluation is at work in it") && error.contains("--out"), "{error}");
        std::fs::remove_dir_all(out).expect("removes");
    }
}
