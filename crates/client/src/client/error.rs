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
pub enum ClientError {
    /// No server answers in time.
    #[error("no server was found within {waited_s} s; start `sim-server`, or give its address with -e tcp/HOST:PORT")]
    NoServer {
        /// Time for which the client looked, s.
        waited_s: f64,
    },
    /// Several servers answer, and none was chosen.
    #[error("found several servers: {}; choose one with --server NAME", found.join(", "))]
    SeveralServers {
        /// Names of the servers that answer.
        found: Vec<String>,
    },
    /// Only other servers answer.
    #[error("server '{}' was not found within {waited_s} s; found {}", plain(name), if found.is_empty() { "none".into() } else { found.join(", ") })]
    NotThere {
        /// The name that was requested.
        name: String,
        /// Names of the servers that answer.
        found: Vec<String>,
        /// Time for which the client looked, s.
        waited_s: f64,
    },
    /// Only servers of an older version exist.
    #[error(
        "server {} is of an older version, which cannot speak protocol {PROTOCOL}; update it to this client's version",
        found.join(", ")
    )]
    OldServer {
        /// Names of the servers.
        found: Vec<String>,
    },
    /// The server refuses a request.
    #[error("server {server} refuses{}: {message}", if field.is_empty() { String::new() } else { format!(" '{field}'") })]
    Refused {
        /// Name of the server.
        server: String,
        /// Kind of the refusal.
        code: Code,
        /// Field of the request that is wrong; may be empty.
        field: String,
        /// The server's reason and remedy.
        message: String,
    },
    /// The server speaks another major version of the protocol.
    #[error(
        "server {server} speaks protocol {found}, but this client speaks {PROTOCOL}; use a client of the server's version"
    )]
    Version {
        /// Name of the server.
        server: String,
        /// Version that the server speaks.
        found: Version,
    },
    /// A reply cannot be decoded.
    #[error("cannot decode the reply of server {server}; use server and client of the same version")]
    Unreadable {
        /// Name of the server.
        server: String,
        /// The decoder's error, which names the field.
        #[source]
        source: DecodeError,
    },
    /// The server closes sessions before they are used.
    #[error(
        "server {server} closed the session before it was used: others open more sessions than it has places; try again, or \
         have its owner start it with --tokens or a larger --capacity"
    )]
    Crowded {
        /// Name of the server.
        server: String,
    },
    /// The server describes a session that is not valid.
    #[error("cannot use the server's session: {reason}; use server and client of the same version")]
    Session {
        /// Fault of the description.
        reason: String,
    },
    /// A query got no answer.
    #[error(
        "{key} was not answered within {waited_s} s; check that the server runs (`policy-client list`) and try again"
    )]
    Unanswered {
        /// Key of the query.
        key: String,
        /// Time for which the client waited, s.
        waited_s: f64,
    },
    /// The handshake failed: another program answers, or the server has another key.
    #[error("the handshake with server {server} failed")]
    Handshake {
        /// Name of the server.
        server: String,
        /// The error in the server's answer.
        #[source]
        source: fiatlux_access::HandshakeError,
    },
    /// The server is not in the file of known servers.
    #[error(
        "server {server} is not in the file of known servers; add a line '{server} ed25519:...' with the key that it prints"
    )]
    UnknownServer {
        /// Name of the server.
        server: String,
    },
    /// The episode cannot continue.
    #[error(transparent)]
    Episode(#[from] SessionFailure),
    /// The policy cannot be made or cannot continue.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The caller asked to stop.
    #[error("stopped")]
    Stopped,
    /// The carrier reports a failure.
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
