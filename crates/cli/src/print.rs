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
    colours(stream.is_terminal(), |name| std::env::var(name).ok())
}

fn colours(is_terminal: bool, variable: impl Fn(&str) -> Option<String>) -> bool {
    let forbids = variable("NO_COLOR").is_some_and(|value| !value.is_empty());
    is_terminal && !forbids && variable("TERM").is_none_or(|term| term != "dumb")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_is_for_terminals_that_want_it() {
        let with =
            |name: &'static str, value: &'static str| move |asked: &str| (asked == name).then(|| value.to_owned());
        assert!(colours(true, with("TERM", "xterm")) && colours(true, with("NO_COLOR", "")));
        assert!(!colours(false, with("TERM", "xterm")) && !colours(true, with("NO_COLOR", "1")));
        assert!(!colours(true, with("TERM", "dumb")));
    }
}
