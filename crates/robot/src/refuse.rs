//! Wording of refusals: which line, which part, which field, what to do.

use crate::locate::{Step, line_of};
use crate::{Joint, RobotError};

/// Largest number that a robot file may contain; keeps every later sum finite.
const LARGEST: f64 = 1e6;

/// Refuses things in one robot file.
pub(crate) struct Refuse<'a> {
    pub text: &'a str,
    pub robot: &'a str,
}

impl<'a> Refuse<'a> {
    /// Refuses the value at `path` in the name of the whole robot.
    pub fn at(&self, path: &[Step<'_>], field: &'static str, problem: String) -> RobotError {
        let line = line_of(self.text, path);
        RobotError::Value { line, part: "robot", name: self.robot.into(), field, problem }
    }

    /// Index of `name` in `names`, or a refusal of the list entry at `path`.
    pub fn find(
        &self,
        names: &[&str],
        name: &str,
        kind: &str,
        field: &'static str,
        path: &[Step<'_>],
    ) -> Result<usize, RobotError> {
        names.iter().position(|n| *n == name).ok_or_else(|| {
            self.at(path, field, format!("names {kind} '{name}', which the file does not have; correct or remove it"))
        })
    }

    /// Refuses a number for a joint whose angle its leader sets.
    pub fn follower(
        &self,
        joints: &[Joint],
        index: usize,
        field: &'static str,
        path: &[Step<'_>],
    ) -> Result<(), RobotError> {
        let Some(follows) = joints[index].follows else { return Ok(()) };
        let (name, leader) = (&joints[index].name, &joints[follows.leader].name);
        Err(self.at(path, field, format!("names joint '{name}', which follows '{leader}'; remove it")))
    }

    /// Entry `index` of the array of tables `table`.
    pub fn part(&self, table: &'static str, index: usize, name: &'a str) -> Part<'a> {
        Part { text: self.text, table, index, name }
    }
}

/// One table of the file, such as a `[[joint]]`.
pub(crate) struct Part<'a> {
    text: &'a str,
    table: &'static str,
    index: usize,
    name: &'a str,
}

impl Part<'_> {
    pub fn refuse(&self, field: &'static str, problem: impl Into<String>) -> RobotError {
        RobotError::Value {
            line: line_of(self.text, &[Step::Key(self.table), Step::Index(self.index), Step::Key(field)]),
            part: self.table,
            name: self.name.into(),
            field,
            problem: problem.into(),
        }
    }

    pub fn finite(&self, field: &'static str, values: &[f64]) -> Result<(), RobotError> {
        match values.iter().find(|v| !(-LARGEST..=LARGEST).contains(*v)) {
            Some(v) => {
                Err(self.refuse(field, format!("holds {v}; every number must be finite and at most 1e6 in size")))
            }
            None => Ok(()),
        }
    }

    pub fn not_negative(&self, field: &'static str, value: f64) -> Result<(), RobotError> {
        self.finite(field, &[value])?;
        if value < 0.0 { Err(self.refuse(field, format!("is {value}; it must not be negative"))) } else { Ok(()) }
    }

    pub fn positive(&self, field: &'static str, value: f64) -> Result<(), RobotError> {
        self.finite(field, &[value])?;
        if value > 0.0 { Ok(()) } else { Err(self.refuse(field, format!("is {value}; it must be positive"))) }
    }
}
