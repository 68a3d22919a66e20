//! The log of a program.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// Warnings of everything but Zenoh, and what our own programs do. Zenoh warns of each try to connect and of each query
/// that a cut ended, with places in its source; our own messages say what came of it.
const DEFAULT_FILTER: &str = "warn,zenoh=error,\
    fiatlux=info,sim_server=info,recorder=info,policy_client=info,scorer=info";

/// Without what our own programs do.
const QUIET_FILTER: &str = "warn,zenoh=error";

/// Sends the log to stderr, so that stdout holds results alone. The environment variable `RUST_LOG` chooses what is
/// logged; without it, errors of Zenoh and what our own programs do. A second call does nothing.
pub fn init_log() {
    init(DEFAULT_FILTER);
}

/// As [`init_log`], for a program that shows its progress: without `RUST_LOG`, warnings alone.
pub fn init_quiet_log() {
    init(QUIET_FILTER);
}

fn init(default: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    let log = log.with_ansi(std::io::stderr().is_terminal());
    // Only a log that is there already is refused.
    let _ = log.try_init();
}
