//! The policy `replay`, as a program makes it.

use std::path::Path;

use fiatlux_client::Replay;

use crate::entry::Entry;

pub(crate) const ENTRY: Entry = Entry {
    name: "replay:BAG",
    does: "sends the actions of a recorded episode again, exactly as they were received",
    make: |bag| Ok(Box::new(Replay::open(Path::new(bag))?)),
};
