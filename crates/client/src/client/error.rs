//! Errors between a client and its server.

use fiatlux_carrier::CarrierError;
use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Refusal, Version};
use fiatlux_proto::{DecodeError, PROTOCOL, plain};
use fiatlux_session::SessionFailure;
use thiserror::Error;

use crate::PolicyError;

/// Why a client cannot continue.
#[derive(Debug, Error)]
#[allow(missing_docs)] // The messages say it.
pub enum ClientError {
    #[error("no server was found within {waited_s} s; start `sim-server`, or give its address with -e tcp/HOST:PORT")]
    NoServer { waited_s: f64 },
    #[error("found several servers: {}; choose one with --server NAME", found.join(", "))]
    SeveralServers { found: Vec<String> },
    #[error("server '{}' was not found within {waited_s} s; found {}", plain(name), if found.is_empty() { "none".into() } else { found.join(", ") })]
    NotThere { name: String, found: Vec<String>, waited_s: f64 },
    #[error(
        "server {} is of an older version, which cannot speak protocol {PROTOCOL}; update it to this client's version",
        found.join(", ")
    )]
    OldServer { found: Vec<String> },
    #[error("server {server} refuses{}: {message}", if field.is_empty() { String::new() } else { format!(" '{field}'") })]
    Refused {
        server: String,
        code: Code,
        /// Field of the request that is wrong; may be empty.
        field: String,
        message: String,
    },
    #[error(
        "server {server} speaks protocol {found}, but this client speaks {PROTOCOL}; use a client of the server's version"
    )]
    Version { server: String, found: Version },
    #[error("cannot decode the reply of server {server}; use server and client of the same version")]
    Unreadable { server: String, source: DecodeError },
    #[error(
        "server {server} closed the session before it was used: others open more sessions than it has places; try again, or \
         have its owner start it with --tokens or a larger --capacity"
    )]
    Crowded { server: String },
    #[error("cannot use the server's session: {reason}; use server and client of the same version")]
    Session { reason: String },
    #[error(
        "{key} was not answered within {waited_s} s; check that the server runs (`policy-client list`) and try again"
    )]
    Unanswered { key: String, waited_s: f64 },
    #[error("the handshake with server {server} failed")]
    Handshake { server: String, source: fiatlux_access::HandshakeError },
    #[error(
        "server {server} is not in the file of known servers; add a line '{server} ed25519:...' with the key that it prints, or \
         one for a group such as 'lab-* ed25519:...'"
    )]
    UnknownServer { server: String },
    /// The episode cannot continue.
    #[error(transparent)]
    Episode(#[from] SessionFailure),
    /// The policy cannot be made or cannot continue.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    #[error("stopped")]
    Stopped,
    #[error("the link fails; check it (RUST_LOG=zenoh=debug shows more) and start again")]
    Carrier(#[from] CarrierError),
}

impl ClientError {
    pub(crate) fn handshake(server: &str) -> impl FnOnce(fiatlux_access::HandshakeError) -> Self {
        move |source| Self::Handshake { server: server.into(), source }
    }

    pub(crate) fn unreadable(server: &str) -> impl FnOnce(DecodeError) -> Self {
        move |source| Self::Unreadable { server: server.into(), source }
    }

    pub(crate) fn refused(server: &str, refusal: Refusal) -> Self {
        let [field, message] = [&refusal.field, &refusal.message].map(|text| plain(text).into_owned());
        Self::Refused { server: server.into(), code: refusal.code(), field, message }
    }
}
