//! Answers as tables of numbers.

use super::ModelChunk;
use crate::{BridgeError, Tensor};

/// Reads a table of an answer: shape (rows, width) or (1, rows, width), all numbers finite.
pub(super) fn table(key: &str, tensor: &Tensor) -> Result<(String, usize, usize, Vec<f64>), BridgeError> {
    let what = || format!("the action '{key}'");
    let (rows, width) = match *tensor.shape() {
        [rows, width] | [1, rows, width] => (rows, width),
        [width] => (1, width),
        ref other => {
            return Err(BridgeError::malformed(what(), format!("its shape is {other:?}, not (rows, numbers)")));
        }
    };
    if rows == 0 || width == 0 {
        return Err(BridgeError::malformed(what(), "it is empty"));
    }
    let numbers = tensor.numbers();
    if let Some(at) = numbers.iter().position(|number| !number.is_finite()) {
        let (row, column) = (at / width, at % width);
        return Err(BridgeError::malformed(what(), format!("number {column} of row {row} is {}", numbers[at])));
    }
    Ok((key.into(), rows, width, numbers))
}

/// Joins tables into a chunk; all must have the same number of rows.
pub(super) fn chunk(
    tables: Vec<(String, usize, usize, Vec<f64>)>,
    server_s: Option<f64>,
) -> Result<ModelChunk, BridgeError> {
    let Some(&(_, rows, ..)) = tables.first() else {
        return Err(BridgeError::malformed("an answer", "it has no actions"));
    };
    if let Some((key, other, ..)) = tables.iter().find(|(_, other, ..)| *other != rows) {
        return Err(BridgeError::malformed("an answer", format!("'{key}' has {other} rows, others have {rows}")));
    }
    let parts = tables.into_iter().map(|(key, _, width, numbers)| (key, width, numbers)).collect();
    Ok(ModelChunk { rows, parts, server_s: server_s.filter(|time| time.is_finite() && *time >= 0.0) })
}
