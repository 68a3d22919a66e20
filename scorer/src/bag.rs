//! Reads one bag through the grader.

use std::path::Path;

use fiatlux_bag::{Bag, Completeness};
use fiatlux_link::in_full;
use fiatlux_wire::{layout_of, read_row};

use crate::GradeOptions;
use crate::assemble::Content;
use crate::episode::Grader;
use crate::results::Fault;

/// Grades a bag as far as it goes.
pub(crate) fn read(path: &Path, options: &GradeOptions) -> Result<Content, (Fault, String)> {
    // What is said of a bag must not depend on the folder from which it was graded.
    let folder = path.parent().map(|folder| folder.join("").display().to_string()).filter(|folder| !folder.is_empty());
    let in_full = |error: &dyn std::error::Error| match &folder {
        Some(folder) => in_full(error).replace(folder, ""),
        None => in_full(error),
    };
    let unreadable = |error: &dyn std::error::Error| (Fault::Unreadable, in_full(error));
    let bag = Bag::open(path).map_err(|error| unreadable(&error))?;
    let header = bag.header();
    let mut grader =
        Grader::new(header, &options.set, options.published_counting).map_err(|error| unreadable(&error))?;
    let layout = layout_of(header).map_err(|error| unreadable(&error))?;
    let mut cut = match bag.completeness() {
        Completeness::Whole => None,
        Completeness::Cut { reason, .. } => Some(reason.clone()),
    };
    let mut states = bag.states();
    while let Some(state) = states.next() {
        let row = match state {
            Ok(state) => {
                let row = read_row(&state, layout).map_err(|error| in_full(&error));
                states.reuse(state);
                row
            }
            Err(error) => Err(in_full(&error)),
        };
        match row {
            Ok(row) => grader.push(&row),
            Err(why) => {
                cut.get_or_insert(why);
                break;
            }
        }
    }
    Ok(Content { header: header.clone(), cut, graded: grader.finish(bag.result()) })
}
