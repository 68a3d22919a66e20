//! The action that led to the row.

use crate::Setup;
use crate::sensor::{Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "last_action",
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, _, out| {
        out.extend(&view.row.action);
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.last_action = ENTRY.numbers(view, devices)?;
        Ok(())
    },
};

fn terms(setup: &Setup) -> Vec<Term> {
    let meaning = "the action that led here, as received";
    vec![Term::new("last_action", "last_action", &[setup.layout.joints], "", meaning)]
}
