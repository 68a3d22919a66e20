//! The Zenoh session of our programs: its command-line options, its defaults, the log, and the signals that end a
//! program.
//!
//! Nothing leaves the loopback interface unless a flag or a config file asks for it: without them a server listens on
//! [`DEFAULT_ENDPOINT`], a client connects to it, and neither scouts.
//!
//! ```
//! use zenoh::Wait;
//!
//! // Two parts of one process; programs open a session with `LinkArgs::open` instead.
//! let link = fiatlux_link::embedded().expect("Zenoh starts");
//! let subscriber = link.declare_subscriber("example/greeting").wait().expect("a subscriber");
//! link.put("example/greeting", "hello").wait().expect("a publication");
//! let sample = subscriber.recv().expect("a message");
//! assert_eq!(sample.payload().try_to_string().expect("text"), "hello");
//! ```
mod args;
mod busy_wait;
mod config;
mod error;
mod exposure;
mod honoured;
mod in_full;
mod log;
mod parse;
mod ports;
mod print;
mod progress;
mod settings;
mod signal;

use zenoh::{Session, Wait};

pub use args::{LinkArgs, LinkMode, parse_endpoint};
pub use busy_wait::BusyWait;
pub use config::Role;
pub use error::LinkError;
pub use in_full::in_full;
pub use log::{init_log, init_quiet_log};
pub use parse::{check_whole_numbers, parse, whole};
pub use ports::choose_port;
pub use print::print;
pub use progress::ProgressLine;
pub use settings::{check_example, parse_with_settings, parse_with_settings_from};
pub use signal::{stop_on_signal, wait_for};

/// Default endpoint: where a server listens and a client looks for it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How long a client that starts waits for its server, s. A server keeps trying without limit.
pub const CONNECT_TIMEOUT_S: f64 = 5.0;

/// A session for one process: its parts talk to each other, and no network is used.
///
/// # Errors
/// [`LinkError::Open`]: Zenoh could not start its threads.
pub fn embedded() -> Result<Session, LinkError> {
    zenoh::open(config::embedded()?).wait().map_err(|source| LinkError::Open { reason: source.to_string() })
}
