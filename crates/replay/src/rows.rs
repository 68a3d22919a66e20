//! Reads the rows of a bag that can be drawn.

use fiatlux_bag::{Bag, Messages};
use fiatlux_proto::v3::State;
use fiatlux_rules::{RobotLayout, Row};
use fiatlux_wire::read_row;
use nalgebra::Isometry3;

/// Positions (m) and angles (rad) beyond this are not from an episode.
const ABSURD: f64 = 1000.0;
/// Tolerance on the length of a row's quaternions.
const UNIT: f64 = 1e-3;

/// Faults in the rows of a bag; the numbers count rows.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    /// Rows that cannot be drawn: incomplete, or with impossible poses.
    pub undrawable: u64,
    /// Rows after one of a later step.
    pub misplaced: u64,
    pub missing: u64,
    /// The error that stopped reading before the end.
    pub broken: Option<String>,
}

impl Faults {
    /// Each fault as a phrase, for notes and errors.
    pub fn phrases(&self) -> Vec<String> {
        let counts = [
            (self.undrawable, "that cannot be drawn, left out"),
            (self.misplaced, "out of order, left out"),
            (self.missing, "missing between others"),
        ];
        let rows = |count: u64| if count == 1 { "row" } else { "rows" };
        let counted = counts.iter().filter(|(count, _)| *count > 0);
        let phrases = counted.map(|(count, what)| format!("{count} {} {what}", rows(*count)));
        phrases.chain(self.broken.clone()).collect()
    }
}

/// The rows of a bag that can be drawn, by rising step. [`Rows::faults`] counts those left out.
pub struct Rows<'a> {
    states: Messages<'a, State>,
    layout: RobotLayout,
    next: Option<u64>,
    pub faults: Faults,
}

impl<'a> Rows<'a> {
    /// Reads rows of these sizes; others cannot be drawn.
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

/// True if every pose of a row is valid and every joint has a finite angle.
fn is_drawable(row: &Row) -> bool {
    let is_number = |number: &f64| number.abs() < ABSURD;
    let is_pose = |pose: &Isometry3<f64>| {
        pose.translation.vector.iter().all(is_number) && (pose.rotation.quaternion().norm() - 1.0).abs() < UNIT
    };
    let mut bodies = [&row.robot].into_iter().chain(&row.things);
    bodies.all(|body| is_pose(&body.pose)) && row.joint_position.iter().all(is_number)
}
