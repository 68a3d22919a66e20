//! Results on stdout, and errors on stderr.

use std::io::{self, ErrorKind, Write};

use fiatlux_proto::plain_lines;

/// Writes results to stdout, control characters of strangers' texts escaped. It is no error if the reader has closed it, as
/// `head` does.
///
/// # Errors
/// They cannot be written, for example because the disk is full.
pub fn print(text: impl AsRef<str>) -> io::Result<()> {
    write(&plain_lines(text.as_ref()))
}

/// As [`print`], for text that has colours of our own.
///
/// # Errors
/// As [`print`].
pub fn print_styled(text: impl AsRef<str>) -> io::Result<()> {
    write(text.as_ref())
}

fn write(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("the results cannot be written to stdout: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// Writes a line to stderr, control characters of strangers' texts escaped. A closed stderr does not stop the program.
pub fn report(line: impl AsRef<str>) {
    let _ = writeln!(io::stderr(), "{}", plain_lines(line.as_ref()));
}
