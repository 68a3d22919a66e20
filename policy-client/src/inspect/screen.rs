//! A view that redraws itself in place on a terminal.

use std::io::{IsTerminal, Write, stderr, stdout};

use terminal_size::{Height, Width};

use super::view::Style;

/// Time between two drawings, s.
const PERIOD_S: f64 = 0.2;
/// Columns and rows to assume if the terminal does not say.
const SIZE: [usize; 2] = [80, 24];
/// Characters in a line when the output is not a terminal.
const WIDTH: usize = 100;

/// Stdout or stderr, where views are drawn.
pub type Terminal = Box<dyn Write + Send>;

/// A view on a terminal.
pub struct Screen<W: Write> {
    out: W,
    style: Style,
    rows: usize,
    /// Number of lines on the screen now.
    drawn: usize,
    next_s: f64,
}

impl Screen<Terminal> {
    /// A view on the terminal of this process; `None` if it has no terminal.
    pub fn on_terminal(color: bool) -> Option<Self> {
        let out: Terminal = match [stdout().is_terminal(), stderr().is_terminal()] {
            [true, _] => Box::new(stdout()),
            [false, true] => Box::new(stderr()),
            _ => return None,
        };
        let [width, rows] = size();
        Some(Self { out, style: Style { width, color }, rows, drawn: 0, next_s: f64::NEG_INFINITY })
    }
}

impl<W: Write> Screen<W> {
    /// Redraws the view if enough time has passed.
    pub fn show(&mut self, now_s: f64, draw: impl FnOnce(Style) -> String) {
        if now_s < self.next_s {
            return;
        }
        self.next_s = now_s + PERIOD_S;
        let text = draw(self.style);
        // The cursor cannot move above the first row, and it is below the last line.
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

    /// Clears the view, so that other text can follow.
    pub fn clear(&mut self) {
        let frame = self.start() + "\x1b[J";
        self.drawn = 0;
        self.write(&frame);
    }

    fn start(&self) -> String {
        if self.drawn == 0 { String::new() } else { format!("\x1b[{}A\r", self.drawn) }
    }

    fn write(&mut self, frame: &str) {
        // A closed terminal does not stop the program.
        let _ = self.out.write_all(frame.as_bytes()).and_then(|()| self.out.flush());
    }
}

/// Columns and rows, from the environment or else from the terminal.
fn size() -> [usize; 2] {
    let asked = terminal_size::terminal_size().map(|(Width(columns), Height(rows))| [columns, rows].map(usize::from));
    let [columns, rows] = asked.unwrap_or(SIZE);
    [said("COLUMNS").unwrap_or(columns), said("LINES").unwrap_or(rows)]
}

fn said(name: &str) -> Option<usize> {
    std::env::var(name).ok()?.parse().ok().filter(|&number| number > 0)
}

/// Characters in a line of the final text.
pub fn width() -> usize {
    if stdout().is_terminal() { size()[0] } else { said("COLUMNS").unwrap_or(WIDTH) }
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
