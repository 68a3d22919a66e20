//! What happened in an episode, as recorded.

use fiatlux_bag::Bag;
use serde::Serialize;

use crate::text::short;

/// Largest number of events to show.
const MOST_EVENTS: usize = 1000;
/// Kind of events to leave out: the flags of each row show how criteria change.
const CRITERION: &str = "criterion";

/// A recorded event of an episode.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Happening {
    /// Control step in which it happened.
    pub step: u64,
    /// Kind of event, such as `attachment`.
    pub kind: String,
    /// What it happened to, such as `old_bulb`.
    pub subject: String,
    /// What changed, such as `released`.
    pub change: String,
    /// Details, such as a number; may be empty.
    pub detail: String,
}

/// All events of a bag except those of criteria, as far as they can be read.
pub(crate) fn happenings(bag: &Bag, notes: &mut Vec<String>) -> Vec<Happening> {
    let mut found = Vec::new();
    for event in bag.events() {
        let event = match event {
            Ok(event) => event,
            Err(error) => {
                let note = format!("Events cannot be read to the end: {}.", short(&error.to_string()));
                // If rows share the damaged chunk, they report it too.
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
