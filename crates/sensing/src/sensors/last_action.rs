//! The action that led to the observation; at first the staged posture in action units.

use crate::Setup;
use crate::sensor::{Class, Entry, Needs, Term};

pub(crate) const ENTRY: Entry = Entry {
    name: "last_action",
    class: Class::Standard,
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
