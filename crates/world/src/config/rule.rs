//! Refusals of values that a config may not have.

use std::fmt::Debug;

use crate::SceneError;

pub(super) type Checked = Result<(), SceneError>;

pub(super) fn refuse(field: &'static str, value: &impl Debug, rule: impl Into<String>) -> Checked {
    Err(SceneError::Value { field, line: None, value: format!("{value:?}"), rule: rule.into() })
}

pub(super) fn ensure(ok: bool, field: &'static str, value: &impl Debug, rule: &str) -> Checked {
    if ok { Ok(()) } else { refuse(field, value, rule) }
}

/// Refuses what is not finite or outside the bounds.
pub(super) fn within(field: &'static str, values: &[f64], low: f64, high: f64) -> Checked {
    match values.iter().find(|v| !(low..=high).contains(*v)) {
        Some(value) => refuse(field, value, format!("it must be between {low} and {high}")),
        None => Ok(()),
    }
}
