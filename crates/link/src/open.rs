//! Opens the session that the options of the command line describe.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use zenoh::Wait;

use crate::config::{self, Role};
use crate::{Link, LinkArgs, LinkError, WaitLog, exposure, rules};

/// Time between two checks for a signal while the session opens.
const POLL: Duration = Duration::from_millis(20);

impl LinkArgs {
    /// Opens the session. Blocks for at most [`crate::CONNECT_TIMEOUT_S`] if a client has to connect first, and until
    /// somebody answers if a server has to; a long wait is logged. A connection that is lost later recovers by itself.
    pub fn open(&self, role: Role) -> Result<Link, LinkError> {
        self.open_unless(role, &AtomicBool::new(false))
    }

    /// As [`LinkArgs::open`]; setting `stop` ends the wait with an error.
    pub fn open_unless(&self, role: Role, stop: &AtomicBool) -> Result<Link, LinkError> {
        let mut config = config::layered(self, role)?;
        if let Some(server) = &self.serves {
            config::drop_forged(&mut config, server)?;
        }
        for endpoint in exposure::exposed(&config) {
            tracing::warn!("{}", exposure::warning(&endpoint, self.asks_tokens));
        }
        let plan = config::EndpointPlan::of(&config);
        // Zenoh tries without end if a server has to connect, so another thread does it.
        let (opened, session) = mpsc::channel();
        let open = move || opened.send(zenoh::open(config).wait());
        let thread = std::thread::Builder::new().name("open".into()).spawn(open);
        thread.map_err(|source| LinkError::Open { reason: source.to_string() })?;
        let mut waiting = WaitLog::default();
        loop {
            match session.recv_timeout(POLL) {
                Ok(session) => return session.map(Link).map_err(|source| plan.explain(&source.to_string())),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(LinkError::Open { reason: "a thread panicked".into() });
                }
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Err(plan.stopped()),
                Err(RecvTimeoutError::Timeout) if plan.is_patient() => waiting.say(|| plan.peers()),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// True if the config's access rules let the program receive what is published on a key.
    ///
    /// # Errors
    /// The config cannot be read.
    pub fn may_subscribe(&self, key: &str, role: Role) -> Result<bool, LinkError> {
        config::layered(self, role).map(|config| rules::may_subscribe(&config, key))
    }

    /// The place where others find a program with these options: `listening on ENDPOINT` or `connected to ENDPOINT`.
    pub fn place(&self, role: Role) -> Result<String, LinkError> {
        config::layered(self, role).map(|config| config::place(&config))
    }
}
