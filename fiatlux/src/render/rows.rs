//! The choice of the rows that become frames.

use fiatlux_rules::CONTROL_DT;

/// Rows of a bag in a simulated second.
pub const ROW_RATE: u32 = 50;

/// Which rows become frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// First simulated time, s; none is the bag's own.
    pub from_s: Option<f64>,
    /// Last simulated time, s; none is the bag's own.
    pub to_s: Option<f64>,
    /// One row in this many becomes a frame.
    pub stride: u64,
}

impl Span {
    /// Indices of the rows with these steps that become frames.
    pub(super) fn chosen(&self, steps: impl Iterator<Item = u64>) -> Vec<usize> {
        // A time that is written in decimals is a step within rounding.
        let step_of = |seconds: f64| seconds / CONTROL_DT;
        let first = self.from_s.map_or(0, |from| (step_of(from) - 1e-6).ceil().max(0.0) as u64);
        let last = self.to_s.map_or(u64::MAX, |to| (step_of(to) + 1e-6).floor().max(0.0) as u64);
        let chosen = |step: u64| (first..=last).contains(&step) && (step - first).is_multiple_of(self.stride.max(1));
        steps.enumerate().filter(|(_, step)| chosen(*step)).map(|(index, _)| index).collect()
    }
}

/// Rows from one frame to the next, for a video of `fps` frames a second that plays at `speed` times real time.
///
/// # Errors
/// Where that is not a whole number: what can be asked for.
pub fn stride(fps: u32, speed: f64) -> Result<u64, String> {
    let rows = f64::from(ROW_RATE) * speed / f64::from(fps.max(1));
    let whole = rows.round();
    if whole >= 1.0 && (rows - whole).abs() < 1e-9 && whole < 1e6 {
        return Ok(whole as u64);
    }
    let fits = |fps: &u32| {
        let rows = f64::from(ROW_RATE) * speed / f64::from(*fps);
        rows >= 1.0 && (rows - rows.round()).abs() < 1e-9
    };
    let possible: Vec<String> = (1..=ROW_RATE).rev().filter(fits).map(|fps| fps.to_string()).collect();
    let rate = format!("a bag has {ROW_RATE} rows a second, so that {fps} frames a second at speed {speed} would need");
    let what = format!("{rate} {rows:.3} rows a frame");
    Err(match possible.is_empty() {
        true => format!("{what}; use a speed such as 0.5, 1, 2 or 4"),
        false => format!("{what}; at this speed use --fps {}", possible.join(", ")),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_a_span() {
        let all = Span { from_s: None, to_s: None, stride: 2 };
        assert_eq!(all.chosen(0..6), [0, 2, 4]);
        // 0.3 s and 0.1 s are not binary fractions, but they are steps 15 and 5.
        let part = Span { from_s: Some(0.1), to_s: Some(0.3), stride: 5 };
        assert_eq!(part.chosen(0..100), [5, 10, 15]);
        let between = Span { from_s: Some(0.03), to_s: Some(0.05), stride: 1 };
        assert_eq!(between.chosen(0..100), [2]);
        // A bag that begins later, and one with a hole.
        assert_eq!(part.chosen([9, 10, 11, 15].into_iter()), [1, 3]);
        let absurd = Span { from_s: Some(1e300), to_s: Some(-1.0), stride: 0 };
        assert!(absurd.chosen([0, 7, u64::MAX].into_iter()).is_empty());
    }

    #[test]
    fn whole_rows_a_frame() {
        for (fps, speed, rows) in [(25, 1.0, 2), (50, 1.0, 1), (10, 1.0, 5), (25, 0.5, 1), (30, 0.6, 1), (25, 4.0, 8)] {
            assert_eq!(stride(fps, speed), Ok(rows), "{fps} at {speed}");
        }
        assert!(stride(30, 1.0).unwrap_err().ends_with("use --fps 50, 25, 10, 5, 2, 1"));
        assert!(stride(60, 1.0).unwrap_err().contains("0.833 rows a frame"));
        assert!(stride(25, 0.01).unwrap_err().contains("use a speed such as"));
    }
}
