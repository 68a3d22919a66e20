//! What can go wrong between a client and its server.

use fiatlux_proto::v3::refusal::Code;
use fiatlux_proto::v3::{Refusal, Version};
use fiatlux_proto::{DecodeError, PROTOCOL};
use fiatlux_session::SessionFailure;
use thiserror::Error;

use crate::PolicyError;

/// Why a client cannot go on.
#[derive(Debug, Error)]
pub enum ClientError {
    /// No server answers within the time.
    #[error("no server was found within {waited_s} s; start `sim-server`, or name where it is with -e tcp/HOST:PORT")]
    NoServer {
        /// How long was looked, s.
        waited_s: f64,
    },
    /// More than one answers.
    #[error("there are several servers: {}; choose one with --server NAME", found.join(", "))]
    SeveralServers {
        /// Names of the servers that answer.
        found: Vec<String>,
    },
    /// Others answer, but not the one asked for.
    #[error("server '{name}' was not found within {waited_s} s; there is {}", if found.is_empty() { "none".into() } else { found.join(", ") })]
    NotThere {
        /// The name that was asked for.
        name: String,
        /// Names of the servers that answer.
        found: Vec<String>,
        /// How long was looked, s.
        waited_s: f64,
    },
    /// Servers of an older version are there, and no other.
    #[error(
        "server {} is of an older version, which does not speak protocol {PROTOCOL}; update it to this client's version",
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
        /// Field of the request; may be empty.
        field: String,
        /// The server's words, with what to do.
        message: String,
    },
    /// The server speaks another major version of the protocol.
    #[error("server {server} speaks protocol {found}, this client {PROTOCOL}; use a client of the server's version")]
    Version {
        /// Name of the server.
        server: String,
        /// Version that the server speaks.
        found: Version,
    },
    /// A reply cannot be read.
    #[error("the reply of server {server} cannot be read; use server and client of the same version")]
    Unreadable {
        /// Name of the server.
        server: String,
        /// What the decoder says.
        #[source]
        source: DecodeError,
    },
    /// The server describes a session that cannot be.
    #[error("the server's session cannot be used: {reason}; use server and client of the same version")]
    Session {
        /// What is wrong with its description.
        reason: String,
    },
    /// No answer to a query.
    #[error(
        "{key} was not answered within {waited_s} s; check that the server runs (`policy-client list`) and try again"
    )]
    Unanswered {
        /// Key of the query.
        key: String,
        /// How long was waited, s.
        waited_s: f64,
    },
    /// Somebody answers in its place, or it has another key.
    #[error("server {server} is not greeted")]
    Handshake {
        /// Name of the server.
        server: String,
        /// What is wrong with its answer.
        #[source]
        source: fiatlux_access::HandshakeError,
    },
    /// It is not among the known ones.
    #[error(
        "server {server} is not in the file of known servers; add a line '{server} ed25519:...' with the key that it prints"
    )]
    UnknownServer {
        /// Name of the server.
        server: String,
    },
    /// The episode cannot go on.
    #[error(transparent)]
    Episode(#[from] SessionFailure),
    /// The policy gives up.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A stop was asked for.
    #[error("stopped")]
    Stopped,
    /// Zenoh reports a failure.
    #[error("Zenoh fails: {reason}; check the link (RUST_LOG=zenoh=debug shows more) and start again")]
    Zenoh {
        /// What Zenoh says about it.
        reason: String,
    },
}

impl ClientError {
    pub(crate) fn zenoh(source: zenoh::Error) -> Self {
        Self::Zenoh { reason: source.to_string() }
    }

    pub(crate) fn handshake(server: &str) -> impl FnOnce(fiatlux_access::HandshakeError) -> Self {
        move |source| Self::Handshake { server: server.into(), source }
    }

    pub(crate) fn unreadable(server: &str) -> impl FnOnce(DecodeError) -> Self {
        move |source| Self::Unreadable { server: server.into(), source }
    }

    pub(crate) fn refused(server: &str, refusal: Refusal) -> Self {
        Self::Refused { server: server.into(), code: refusal.code(), field: refusal.field, message: refusal.message }
    }
}
