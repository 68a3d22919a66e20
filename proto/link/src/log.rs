//! The log of a program.

use tracing_subscriber::EnvFilter;

/// Warnings of everything, and what our own programs do.
const DEFAULT_FILTER: &str = "warn,fiatlux=info,sim_server=info,recorder=info,policy_client=info,scorer=info";

/// Sends the log to stderr, so that stdout holds results alone. The environment variable `RUST_LOG` chooses what is
/// logged; without it, warnings of Zenoh and what our own programs do. A second call does nothing.
pub fn init_log() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    // Only a log that is there already is refused.
    let _ = log.try_init();
}
