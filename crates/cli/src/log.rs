use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use tracing_subscriber::EnvFilter;

use crate::print::has_colour;

/// Warnings of everything except Zenoh, and the activity of our own programs. Zenoh warns of every attempt to connect
/// and of every query that a lost link ended, with places in its source, and calls a handshake that is refused an error; our
/// own messages report the outcome. DDS warns of each sample that a peer without multicast gets another way.
const DEFAULT_FILTER: &str = "warn,zenoh=error,zenoh_transport::unicast::establishment=off,rustdds=off,\
    fiatlux=info,sim_server=info,recorder=info,policy_client=info,scorer=info";

/// The same without the activity of our own programs.
const QUIET_FILTER: &str = "warn,zenoh=error,zenoh_transport::unicast::establishment=off,rustdds=off";

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
    // A closed stderr does not stop the program.
    let log = log.log_internal_errors(false);
    let log = log.with_ansi(has_colour(&std::io::stderr()));
    // This fails only if a log has already been set up.
    let _ = log.try_init();
}

/// True if a text is to be logged for the first time in this process: a message about a whole link or a policy is not
/// repeated for each session.
pub fn is_news(text: &str) -> bool {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    SAID.lock().unwrap_or_else(PoisonError::into_inner).insert(text.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_news_once() {
        assert_eq!(["a", "b", "a"].map(|text| is_news(&format!("a_text_is_news_once {text}"))), [true, true, false]);
    }
}
