//! Feasibility trials of objects.

use std::path::PathBuf;

use fiatlux_assets::trials;
use fiatlux_world::Object;
use pyo3::prelude::*;

use crate::fault::{FiatluxError, refused};

/// Makes all trials of the objects in some folders; returns them as JSON.
#[pyfunction]
pub(crate) fn asset_trials(py: Python<'_>, folders: Vec<PathBuf>) -> PyResult<String> {
    let objects: Result<Vec<Object>, _> = folders.iter().map(|folder| Object::read(folder)).collect();
    let objects = objects.map_err(|error| refused(&error))?;
    let done = py.detach(|| trials(&objects)).map_err(|error| refused(&error))?;
    serde_json::to_string(&done).map_err(|error| FiatluxError::new_err(error.to_string()))
}
