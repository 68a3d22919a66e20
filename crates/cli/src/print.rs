//! Results on stdout.

use std::io::Write;

/// Writes text to stdout. If the reader has closed it, as `head` does, the program continues.
pub fn print(text: impl AsRef<str>) {
    let mut stdout = std::io::stdout();
    let _ = stdout.write_all(text.as_ref().as_bytes()).and_then(|()| stdout.flush());
}
