//! Messages over Zenoh: the options of a program on the command line, their defaults, and the [`Carrier`] that sessions
//! use. No other library names a type of Zenoh's.
//!
//! Nothing leaves the loopback interface unless a flag or a config file asks for it: without them a server listens on
//! [`DEFAULT_ENDPOINT`], a client connects to it, and neither scouts.
#![allow(missing_docs)] // Used in this repository alone.
mod args;
mod config;
mod endpoints;
mod error;
mod exposure;
mod honoured;
mod open;
mod over_zenoh;
mod ports;
mod rules;
mod waiting;

use fiatlux_carrier::Carrier;
use zenoh::{Session, Wait};

use error::reason_of;

pub use args::{LinkArgs, LinkMode, parse_endpoint};
pub use config::Role;
pub use error::LinkError;
pub use ports::choose_port;
pub use waiting::WaitLog;

/// Default endpoint: servers listen on it and clients connect to it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Time limit for a client that connects to its server, s. A server keeps trying without limit.
pub const CONNECT_TIMEOUT_S: f64 = 5.0;

/// Carries the messages of sessions over a Zenoh session that was opened elsewhere.
pub fn carrier(session: &Session) -> Carrier {
    Carrier::new(over_zenoh::ZenohTransport(session.clone()))
}

/// A Zenoh session, open until it is closed or dropped.
#[derive(Debug, Clone)]
pub struct Link(Session);

impl Link {
    /// A Zenoh session that stays within the process, for tests of code that uses Zenoh itself. The parts of our
    /// programs use [`fiatlux_carrier::memory`].
    pub fn embedded() -> Result<Self, LinkError> {
        let session = zenoh::open(config::embedded()?).wait();
        session.map(Self).map_err(|source| LinkError::Open { reason: reason_of(&source) })
    }

    pub fn carrier(&self) -> Carrier {
        carrier(&self.0)
    }

    /// The session itself, for what concerns Zenoh alone.
    pub fn session(&self) -> &Session {
        &self.0
    }

    /// Closes the session, after all messages sent before.
    pub fn close(self) -> Result<(), LinkError> {
        self.0.close().wait().map_err(|source| LinkError::Close { reason: reason_of(&source) })
    }
}
