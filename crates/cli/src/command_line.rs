//! The command line that a program reads.

use std::ffi::OsString;
use std::sync::OnceLock;

static GIVEN: OnceLock<Vec<OsString>> = OnceLock::new();

/// Sets the command line that the programs of this process read, in place of the one with which the process was started. The first word
/// is the program's name. For a program inside an interpreter, whose own command line is another. Only the first call counts.
pub fn set_command_line(words: Vec<OsString>) {
    let _ = GIVEN.set(words);
}

/// The command line of the program, with its name first.
pub fn command_line() -> Vec<OsString> {
    GIVEN.get().cloned().unwrap_or_else(|| std::env::args_os().collect())
}
