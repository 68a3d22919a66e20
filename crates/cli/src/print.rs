//! Results on stdout, and errors on stderr.

use std::fmt::Display;
use std::io::{self, ErrorKind, IsTerminal, Write};
use std::process::ExitCode;

use fiatlux_proto::plain_lines;

/// Writes results to stdout, control characters of strangers' texts escaped. A reader that has closed it, as `head`
/// does, is no error.
pub fn print(text: impl AsRef<str>) -> io::Result<()> {
    write(&plain_lines(text.as_ref()))
}

/// As [`print()`], for a text whose first line is the result: a terminal shows that in bold.
pub fn print_headed(text: impl AsRef<str>) -> io::Result<()> {
    let text = plain_lines(text.as_ref());
    match text.split_once('\n') {
        Some((first, rest)) if has_colour(&io::stdout()) => write(&format!("\x1b[1m{first}\x1b[0m\n{rest}")),
        _ => write(&text),
    }
}

/// As [`print()`], for a text that a terminal shows in colours: `paint` puts them in.
pub fn print_painted(text: impl AsRef<str>, paint: impl FnOnce(&str) -> String) -> io::Result<()> {
    let text = plain_lines(text.as_ref());
    if has_colour(&io::stdout()) { write(&paint(&text)) } else { write(&text) }
}

/// Writes what is wrong with a command line to stderr, as clap does; returns the exit code.
pub fn usage(problem: impl Display) -> ExitCode {
    print_error(format!("{problem}\n\nFor more information, try '--help'."));
    ExitCode::from(2)
}

/// Writes an error to stderr, as clap does.
pub fn print_error(error: impl Display) {
    let label = if has_colour(&io::stderr()) { "\x1b[1;31merror:\x1b[0m" } else { "error:" };
    let _ = writeln!(io::stderr(), "{label} {}", plain_lines(&error.to_string()));
}

/// Writes the error that ended a program, with its sources; returns the exit code.
pub fn failure(error: impl Display) -> ExitCode {
    print_error(format!("{error:#}"));
    ExitCode::FAILURE
}

/// Writes a line to stderr, control characters of strangers' texts escaped. A closed stderr does not stop the program.
pub fn report(line: impl AsRef<str>) {
    let _ = writeln!(io::stderr(), "{}", plain_lines(line.as_ref()));
}

fn write(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(io::Error::new(error.kind(), format!("the results cannot be written to stdout: {error}"))),
        Ok(()) => Ok(()),
    }
}

/// True for a terminal that has colours, unless the variable `NO_COLOR` is set.
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
