//! Rows of a bag that can be drawn.

use fiatlux_bag::{Bag, Messages};
use fiatlux_proto::v3::State;
use fiatlux_rules::{RobotLayout, Row};
use fiatlux_wire::read_row;
use nalgebra::Isometry3;

/// Farther from the origin, m, or larger, rad, than anything in an episode.
const ABSURD: f64 = 1000.0;
/// A quaternion of a row is a unit one within this.
const UNIT: f64 = 1e-3;

/// What is wrong with the rows of a bag.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    /// Rows that cannot be drawn: incomplete, or with numbers that cannot be a pose.
    pub undrawable: u64,
    /// Rows that stand after a later one.
    pub misplaced: u64,
    /// Rows that are missing between others.
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

/// The rows of a bag that can be drawn, by rising step. What is left out is counted in [`Rows::faults`].
pub struct Rows<'a> {
    states: Messages<'a, State>,
    layout: RobotLayout,
    /// The step after the last row.
    next: Option<u64>,
    /// What was wrong with the rows so far.
    pub faults: Faults,
}

impl<'a> Rows<'a> {
    /// Rows of these sizes; others cannot be drawn.
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
