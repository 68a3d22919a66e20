//! Rows of a bag that can be drawn, and the choice of those that become frames.

use fiatlux_bag::{Bag, Messages};
use fiatlux_proto::v3::State;
use fiatlux_rules::{CONTROL_DT, RobotLayout, Row};
use fiatlux_wire::read_row;
use nalgebra::{Isometry3, Vector3};

/// Rows a second.
pub const ROW_RATE: u32 = 50;
/// Farther from the origin, m, or larger, rad, than anything in an episode.
const ABSURD: f64 = 1000.0;
/// A quaternion of a row is a unit one within this.
const UNIT: f64 = 1e-3;

/// What is wrong with the rows of a bag.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Faults {
    /// Rows that cannot be drawn: incomplete, or with numbers that are no place.
    pub undrawable: u64,
    /// Rows that stand after a later one.
    pub misplaced: u64,
    /// Rows that are not there, between others.
    pub missing: u64,
    /// Where reading stopped before the end.
    pub broken: Option<String>,
}

impl Faults {
    /// As phrases.
    pub fn phrases(&self) -> Vec<String> {
        let counts = [
            (self.undrawable, "cannot be drawn and were left out"),
            (self.misplaced, "stand after later ones and were left out"),
            (self.missing, "are missing between others"),
        ];
        let rows = |count: u64| if count == 1 { "row" } else { "rows" };
        let counted = counts.iter().filter(|(count, _)| *count > 0);
        let phrases = counted.map(|(count, what)| format!("{count} {} {what}", rows(*count)));
        phrases.chain(self.broken.clone()).collect()
    }
}

/// The rows of a bag that can be drawn, by rising step.
pub(super) struct Rows<'a> {
    states: Messages<'a, State>,
    layout: RobotLayout,
    /// The step after the last row.
    next: Option<u64>,
    pub faults: Faults,
}

impl<'a> Rows<'a> {
    pub fn new(bag: &'a Bag, layout: RobotLayout) -> Self {
        Self { states: bag.states(), layout, next: None, faults: Faults::default() }
    }
}

impl Iterator for Rows<'_> {
    type Item = Row;

    fn next(&mut self) -> Option<Row> {
        loop {
            let state = match self.states.next()? {
                Ok(state) => state,
                Err(error) => {
                    self.faults.broken = Some(error.to_string());
                    return None;
                }
            };
            let step = state.step;
            let missing = match self.next {
                Some(next) if step < next => {
                    self.faults.misplaced += 1;
                    continue;
                }
                Some(next) => step - next,
                None => 0,
            };
            self.faults.missing = self.faults.missing.saturating_add(missing);
            self.next = Some(step.saturating_add(1));
            match read_row(&state, self.layout) {
                Ok(row) if is_drawable(&row) => return Some(row),
                _ => self.faults.undrawable += 1,
            }
        }
    }
}

/// Whether every pose of a row is one and every joint has an angle.
fn is_drawable(row: &Row) -> bool {
    let is_number = |number: &f64| number.abs() < ABSURD;
    let is_pose = |pose: &Isometry3<f64>| {
        pose.translation.vector.iter().all(is_number) && (pose.rotation.quaternion().norm() - 1.0).abs() < UNIT
    };
    let poses = [&row.robot.pose, &row.ladder.pose, &row.bulbs[0].pose, &row.bulbs[1].pose, &row.fixture, &row.crate_];
    poses.iter().all(|pose| is_pose(pose)) && row.joint_position.iter().all(is_number)
}

/// What of a row a camera follows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spot {
    pub step: u64,
    pub pelvis: Isometry3<f64>,
    pub ladder: Isometry3<f64>,
    /// m, world, as the following.
    pub lamp: Vector3<f64>,
    pub fresh_bulb: Vector3<f64>,
    pub crate_: Vector3<f64>,
}

impl Spot {
    pub fn of(row: &Row) -> Self {
        Self {
            step: row.step,
            pelvis: row.robot.pose,
            ladder: row.ladder.pose,
            lamp: row.fixture.translation.vector,
            fresh_bulb: row.bulbs[1].pose.translation.vector,
            crate_: row.crate_.translation.vector,
        }
    }
}

/// Which rows become frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// First and last simulated time, s; none is the bag's own.
    pub from_s: Option<f64>,
    /// See `from_s`.
    pub to_s: Option<f64>,
    /// Every so many rows is one.
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
/// Where that is no whole number: what can be asked for.
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
        // 0.3 s and 0.1 s are no binary numbers, but they are steps 15 and 5.
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
