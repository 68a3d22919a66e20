//! Sessions for policies over Zenoh.
//!
//! [`Server`] puts them on a Zenoh session, in one process with its clients or on the network. A session itself is a
//! state machine without I/O (`session`), which a fixed pool of workers runs (`pool`, `actor`); Zenoh's callbacks only put
//! messages into inboxes (`shell`). What goes wrong in a session stays in it.

mod actor;
mod info;
mod networks;
mod notices;
mod plan;
mod pool;
mod record;
mod scenes;
mod session;
mod shared;
mod shell;
mod window;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub use info::joints;
pub use shell::{Server, ServerError, ServerOptions};

/// A lock that outlives a panic elsewhere: what it guards is then closed, not shared.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
