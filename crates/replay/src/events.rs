//! The recorded events of an episode.

use fiatlux_bag::Bag;
use serde::Serialize;

use crate::text::short;

const MAX_EVENTS: usize = 1000;
/// Kind of events to leave out: the flags of each row show how criteria change.
const CRITERION: &str = "criterion";

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecordedEvent {
    pub step: u64,
    /// Kind of event, such as `attachment`.
    pub kind: String,
    /// The thing that it concerns, such as `old_bulb`.
    pub subject: String,
    /// The change, such as `released`.
    pub change: String,
    pub detail: String,
}

/// All events of a bag except those of criteria, up to the first that cannot be read.
pub(crate) fn recorded_events(bag: &Bag, notes: &mut Vec<String>) -> Vec<RecordedEvent> {
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
        if found.len() >= MAX_EVENTS {
            notes.push(format!("Events after the first {MAX_EVENTS} are left out."));
            break;
        }
        found.push(RecordedEvent {
            step: event.step,
            kind: short(&event.kind),
            subject: short(&event.subject),
            change: short(&event.change),
            detail: short(&event.detail),
        });
    }
    found
}
