//! Results on stdout, errors on stderr.

use std::fmt::Display;
use std::io::{IsTerminal, Write};

/// Writes text to stdout. If the reader has closed it, as `head` does, the program continues.
pub fn print(text: impl AsRef<str>) {
    let mut stdout = std::io::stdout();
    let _ = stdout.write_all(text.as_ref().as_bytes()).and_then(|()| stdout.flush());
}

/// A text for stdout whose first line is the result: a terminal shows that in bold.
pub fn headed(text: String) -> String {
    match text.split_once('\n') {
        Some((first, rest)) if has_colour(&std::io::stdout()) => format!("\x1b[1m{first}\x1b[0m\n{rest}"),
        _ => text,
    }
}

/// Writes an error to stderr, as clap does.
pub fn print_error(error: impl Display) {
    let label = if has_colour(&std::io::stderr()) { "\x1b[1;31merror:\x1b[0m" } else { "error:" };
    let _ = writeln!(std::io::stderr(), "{label} {error}");
}

/// Whether to write colours: to a terminal that has them, unless the variable `NO_COLOR` is set.
pub(crate) fn has_colour(stream: &impl IsTerminal) -> bool {
    let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    stream.is_terminal() && !is_set("NO_COLOR") && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}
