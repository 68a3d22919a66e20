//! Lines of limited width, and short forms of numbers.

/// How to draw a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Style {
    /// Largest number of characters in a line.
    pub width: usize,
    pub color: bool,
}

const BOLD: &str = "\x1b[1m";
const GREEN: &str = "\x1b[32m";
const PLAIN: &str = "\x1b[0m";

/// A text that grows line by line.
pub struct Lines {
    style: Style,
    text: String,
}

impl Lines {
    /// A text that has no lines yet.
    pub fn new(style: Style) -> Self {
        Self { style, text: String::new() }
    }

    /// The whole text, with a line feed after each line.
    pub fn text(self) -> String {
        self.text
    }

    /// Largest number of characters in a line.
    pub fn width(&self) -> usize {
        self.style.width
    }

    pub fn blank(&mut self) {
        self.text.push('\n');
    }

    /// Adds a line, and cuts it if it is too long.
    pub fn row(&mut self, line: String) {
        self.push(None, &line);
    }

    pub fn title(&mut self, line: String) {
        self.push(Some(BOLD), &line);
    }

    /// Adds a line, highlighted if `holds`.
    pub fn marked(&mut self, holds: bool, line: String) {
        self.push(holds.then_some(GREEN), &line);
    }

    /// As [`Lines::prose`], with one level of indentation.
    pub fn note(&mut self, text: &str) {
        self.prose("  ", text);
    }

    /// Adds a text that is wrapped at the width.
    pub fn prose(&mut self, indent: &str, text: &str) {
        let mut line = indent.to_owned();
        for word in text.split_whitespace() {
            let length = line.chars().count();
            if length > indent.len() && length + 1 + word.chars().count() > self.style.width {
                self.push(None, &line);
                line = indent.to_owned();
            }
            if line.len() > indent.len() {
                line.push(' ');
            }
            line.push_str(word);
        }
        self.push(None, &line);
    }

    fn push(&mut self, code: Option<&str>, line: &str) {
        let clean = line.trim_end().replace(char::is_control, "?");
        let code = code.filter(|_| self.style.color);
        self.text.push_str(code.unwrap_or_default());
        self.text.push_str(&cut(&clean, self.style.width));
        self.text.push_str(code.map_or("", |_| PLAIN));
        self.text.push('\n');
    }
}

fn cut(line: &str, width: usize) -> String {
    if line.chars().count() <= width {
        return line.to_owned();
    }
    let mut short: String = line.chars().take(width.saturating_sub(1)).collect();
    short.push('…');
    short
}

/// A number with about three significant digits.
pub fn number(number: f64) -> String {
    let size = number.abs();
    let text = match size {
        _ if number == number.round() && size < 1e6 => format!("{number:.0}"),
        _ if size >= 100.0 => format!("{number:.0}"),
        _ if size >= 10.0 => format!("{number:.1}"),
        _ => format!("{number:.2}"),
    };
    // A number too small to show has no sign.
    if text.trim_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').to_owned() } else { text }
}

/// A time in a suitable unit.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 1e-6 => "< 1 us".into(),
        s if s < 1e-3 => format!("{:.0} us", 1e6 * s),
        s if s < 1e-2 => format!("{:.1} ms", 1e3 * s),
        s if s < 1.0 => format!("{:.0} ms", 1e3 * s),
        s => format!("{s:.1} s"),
    }
}

/// A size in a suitable unit.
pub fn bytes(bytes: f64) -> String {
    match bytes {
        b if b < 1e3 => format!("{b:.0} B"),
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b => format!("{:.1} MB", b / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let cases =
            [(0.0, "0"), (-0.001, "0.00"), (0.126, "0.13"), (-9.876, "-9.88"), (12.34, "12.3"), (-250.4, "-250")];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
        assert_eq!([12e-6, 1.26e-3, 0.0846, 2.5].map(duration), ["12 us", "1.3 ms", "85 ms", "2.5 s"]);
        assert_eq!([12.0, 23_044.0, 2e6].map(bytes), ["12 B", "23.0 kB", "2.0 MB"]);
    }

    #[test]
    fn lines_are_cut_or_go_on() {
        let mut lines = Lines::new(Style { width: 10, color: true });
        lines.row("0123456789".into());
        lines.title("0123456789a".into());
        lines.prose("  ", "one two three four");
        lines.row("\x1b[2J".into());
        let expected = "0123456789\n\x1b[1m012345678…\x1b[0m\n  one two\n  three\n  four\n?[2J\n";
        assert_eq!(lines.text(), expected);
    }
}
