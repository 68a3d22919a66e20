//! The log of a program.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// Warnings of everything except Zenoh, and the activity of our own programs. Zenoh warns of every attempt to connect
/// and of every query that a lost link ended, with places in its source; our own messages report the outcome.
const DEFAULT_FILTER: &str = "warn,zenoh=error,\
    fiatlux=info,sim_server=info,recorder=info,policy_client=info,scorer=info";

/// The same without the activity of our own programs.
const QUIET_FILTER: &str = "warn,zenoh=error";

/// Sends the log to stderr, so that stdout holds only results. The environment variable `RUST_LOG` chooses what is
/// logged; by default, errors of Zenoh and the activity of our own programs. A second call does nothing.
pub fn init_log() {
    init(DEFAULT_FILTER);
}

/// As [`init_log`], for a program that shows its progress: by default only warnings.
pub fn init_quiet_log() {
    init(QUIET_FILTER);
}

fn init(default: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    let log = log.with_ansi(std::io::stderr().is_terminal());
    // This fails only if a log has already been set up.
    let _ = log.try_init();
}
