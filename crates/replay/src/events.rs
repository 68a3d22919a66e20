//! What happened in an episode.

use fiatlux_bag::Bag;
use serde::Serialize;

use crate::text::short;

/// Most events that are shown.
const MOST_EVENTS: usize = 1000;
/// Changes of criteria are seen in the conditions of each row.
const CRITERION: &str = "criterion";

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Happening {
    /// The step in which it did.
    pub step: u64,
    /// Its kind, such as `attachment`.
    pub kind: String,
    /// What it is about, such as `old_bulb`.
    pub subject: String,
    /// What changed, such as `released`.
    pub change: String,
    /// More of it.
    pub detail: String,
}

/// The events of a bag but those of criteria, as far as they can be read.
pub(crate) fn happenings(bag: &Bag, notes: &mut Vec<String>) -> Vec<Happening> {
    let mut found = Vec::new();
    for event in bag.events() {
        let event = match event {
            Ok(event) => event,
            Err(error) => {
                let note = format!("Events cannot be read to the end: {}.", short(&error.to_string()));
                // The rows say so too where they are in the same chunk.
                notes.push(note);
                break;
            }
        };
        if event.kind == CRITERION {
            continue;
        }
        if found.len() >= MOST_EVENTS {
            notes.push(format!("Events after the first {MOST_EVENTS} are left out."));
            break;
        }
        found.push(Happening {
            step: event.step,
            kind: short(&event.kind),
            subject: short(&event.subject),
            change: short(&event.change),
            detail: short(&event.detail),
        });
    }
    found
}
