//! A view that is drawn over itself on a terminal.

use std::io::Write;
use std::process::{Command, Stdio};

use super::view::Style;

/// Between two looks, s.
const PERIOD_S: f64 = 0.2;
/// Columns and rows of a terminal that does not say its size.
const SIZE: [usize; 2] = [80, 24];

/// A place on a terminal where a view stands.
pub struct Screen<W: Write> {
    out: W,
    style: Style,
    rows: usize,
    /// Lines that stand there.
    drawn: usize,
    next_s: f64,
}

impl<W: Write> Screen<W> {
    /// On that terminal, in its width.
    pub fn new(out: W, color: bool) -> Self {
        let [columns, rows] = size();
        Self { out, style: Style { width: columns, color }, rows, drawn: 0, next_s: f64::NEG_INFINITY }
    }

    /// Draws the view anew if it is time to.
    pub fn show(&mut self, now_s: f64, draw: impl FnOnce(Style) -> String) {
        if now_s < self.next_s {
            return;
        }
        self.next_s = now_s + PERIOD_S;
        let text = draw(self.style);
        // The cursor cannot go up beyond the first row, and it stands below the last line.
        let lines: Vec<&str> = text.lines().take(self.rows.saturating_sub(1)).collect();
        let mut frame = self.start();
        for line in &lines {
            frame.push_str(line);
            frame.push_str("\x1b[K\n");
        }
        frame.push_str("\x1b[J");
        self.drawn = lines.len();
        self.write(&frame);
    }

    /// Wipes the view, for what is written next.
    pub fn clear(&mut self) {
        let frame = self.start() + "\x1b[J";
        self.drawn = 0;
        self.write(&frame);
    }

    fn start(&self) -> String {
        if self.drawn == 0 { String::new() } else { format!("\x1b[{}A\r", self.drawn) }
    }

    fn write(&mut self, frame: &str) {
        // A terminal that is gone is no reason to stop.
        let _ = self.out.write_all(frame.as_bytes()).and_then(|()| self.out.flush());
    }
}

/// Columns and rows: what the environment says, else what the terminal says.
pub fn size() -> [usize; 2] {
    let said = ["COLUMNS", "LINES"].map(|name| std::env::var(name).ok()?.parse().ok().filter(|&number| number > 0));
    if let [Some(columns), Some(rows)] = said {
        return [columns, rows];
    }
    let [columns, rows] = asked().unwrap_or(SIZE);
    [said[0].unwrap_or(columns), said[1].unwrap_or(rows)]
}

/// `stty` knows, where there is one.
fn asked() -> Option<[usize; 2]> {
    let terminal = std::fs::File::open("/dev/tty").ok()?;
    let output = Command::new("stty").arg("size").stdin(terminal).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let (rows, columns) = text.trim().split_once(' ')?;
    Some([columns.parse().ok()?, rows.parse().ok()?]).filter(|size| size.iter().all(|&number| number > 0))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn screen() -> Screen<Vec<u8>> {
        let style = Style { width: 80, color: false };
        Screen { out: Vec::new(), style, rows: 4, drawn: 0, next_s: 0.0 }
    }

    #[test]
    fn a_view_is_drawn_over_itself_when_it_is_due() {
        let mut screen = screen();
        screen.show(1.0, |_| "a\nb\n".into());
        screen.show(1.1, |_| unreachable!());
        screen.show(1.2, |_| "c\n".into());
        screen.clear();
        let text = String::from_utf8(screen.out).unwrap();
        assert_eq!(text, "a\x1b[K\nb\x1b[K\n\x1b[J\x1b[2A\rc\x1b[K\n\x1b[J\x1b[1A\r\x1b[J");
    }

    #[test]
    fn a_view_is_no_taller_than_the_terminal() {
        let mut screen = screen();
        screen.show(1.0, |_| "a\nb\nc\nd\ne\n".into());
        assert_eq!(screen.drawn, 3);
    }
}
