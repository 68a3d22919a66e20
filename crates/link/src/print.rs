//! Results on stdout.

use std::io::Write;

/// Writes text to stdout. A reader that has gone away, as `head` does, is no reason to stop.
pub fn print(text: impl AsRef<str>) {
    let mut stdout = std::io::stdout();
    let _ = stdout.write_all(text.as_ref().as_bytes()).and_then(|()| stdout.flush());
}
