//! Errors of a batch, as Python has them.

use fiatlux_batch::BatchError;
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;

use crate::fault::{failed, refused};

pub(crate) fn error(error: BatchError) -> PyErr {
    match error {
        BatchError::Config { field, found, rule } => {
            // As the arguments are called in Python.
            let field = match field {
                "worlds" => "num_envs",
                "threads" => "num_threads",
                other => other,
            };
            PyValueError::new_err(format!("{field} is {found}; {rule}"))
        }
        BatchError::Memory { .. } => PyMemoryError::new_err(error.to_string().replace("worlds:", "num_envs:")),
        BatchError::Ended { world } => {
            let remedy = "call reset(options={\"reset_mask\": terminated | truncated}) before the next step";
            PyValueError::new_err(format!("the episode of world {world} has ended; {remedy}"))
        }
        BatchError::Row { world, problem } => {
            PyValueError::new_err(format!("like: world {world} cannot begin there: {problem}"))
        }
        BatchError::StartRow { problem, .. } => {
            PyValueError::new_err(format!("starts: no world starts there: {problem}"))
        }
        BatchError::World { .. }
        | BatchError::Forked { .. }
        | BatchError::Task { .. }
        | BatchError::Panicked { .. }
        | BatchError::Stopped
        | BatchError::Torn
        | BatchError::Thread(_) => failed(&error),
        _ => refused(&error),
    }
}
