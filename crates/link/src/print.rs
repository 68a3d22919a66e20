//! Results on stdout.

use std::io::Write;

/// Writes text to stdout. A reader that has gone away, as `head` does, does not stop the program.
pub fn print(text: impl AsRef<str>) {
    let mut stdout = std::io::stdout();
    let _ = stdout.write_all(text.as_ref().as_bytes()).and_then(|()| stdout.flush());
}
