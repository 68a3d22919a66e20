//! Errors of model servers, mappings and their contracts.

use std::time::Duration;

use thiserror::Error;

/// Why a model server, a mapping or a message cannot be used.
#[derive(Debug, Error)]
pub enum BridgeError {
    /// The address cannot be parsed.
    #[error(
        "cannot read '{given}' as the address of a model server; write {scheme}://HOST:PORT{}",
        if given.starts_with("wss:") { "; for TLS run a proxy on this side, and name the server with --model-host" } else { "" }
    )]
    Address { given: String, scheme: &'static str },
    /// Nobody accepts a connection at the address.
    #[error("cannot connect to the model server at {address}; start it, or correct --model")]
    Connect {
        address: String,
        /// The system's error, which says why.
        #[source]
        source: std::io::Error,
    },
    /// The other side does not complete the dialect's handshake.
    #[error("the server at {address} does not speak {transport}: {problem}; compare --dialect and --model with it")]
    Handshake {
        address: String,
        /// Transport of the dialect: `ZeroMQ` or `WebSocket`.
        transport: &'static str,
        problem: String,
    },
    /// The other side accepts a connection, and does not complete the handshake within the time-out.
    #[error(
        "the server at {address} accepted a connection and did not complete the {transport} handshake within {:.1} s; a \
         server that computes or compiles answers late: allow more with --reply-timeout. If it is idle, compare --dialect \
         and --model with it",
        waited.as_secs_f64()
    )]
    Silent {
        address: String,
        /// Transport of the dialect: `ZeroMQ` or `WebSocket`.
        transport: &'static str,
        waited: Duration,
    },
    /// No answer to the question before the first episode.
    #[error(
        "the model server did not answer the question before the first episode within {:.0} s; if it compiles for longer, allow \
         more with --warm-up-timeout",
        waited.as_secs_f64()
    )]
    ColdStart { waited: Duration },
    /// No answer within the time-out.
    #[error("the model server did not answer '{question}' within {:.1} s; allow more with --reply-timeout", waited.as_secs_f64())]
    Timeout { question: String, waited: Duration },
    /// The connection broke during a request.
    #[error("the connection to the model server was lost during '{question}': {problem}")]
    Lost { question: String, problem: String },
    /// The server announced a message over the limit.
    #[error("the model server sends {size} bytes; the limit is {most}")]
    TooLarge {
        /// Size that the server announced, bytes.
        size: u64,
        /// Largest size that is accepted, bytes.
        most: usize,
    },
    /// A message is not in the form of the dialect.
    #[error("cannot read {what} from the model server: {problem}")]
    Malformed {
        /// Which part of the message was being read.
        what: String,
        problem: String,
    },
    /// The server reports an error.
    #[error("the model server refuses '{question}': {text}")]
    Server {
        question: String,
        /// The server's own words, shortened.
        text: String,
    },
    /// A mapping or a file of hands cannot be used.
    #[error("the mapping {name} cannot be used: {field}: {problem}")]
    Mapping {
        /// Its name, or the path of its file.
        name: String,
        field: String,
        /// What is wrong, and how to correct it.
        problem: String,
    },
    /// Mapping and server do not match. Nothing has moved.
    #[error("the mapping {mapping} does not fit the model server; correct either:\n  {}", mismatches.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  "))]
    Contract {
        mapping: String,
        /// Everything that does not match, by key.
        mismatches: Vec<crate::Mismatch>,
    },
    /// The model outputs motion tokens, but no decoder is loaded.
    #[error(
        "the mapping {mapping} commands the body by motion tokens ('{key}', {width} numbers), but no decoder is given; \
         name the folder of the GEAR-SONIC decoder (ONNX, 994 inputs, 29 outputs) with --controller sonic:DIR"
    )]
    NoDecoder { mapping: String, key: String, width: usize },
    /// The session lacks something that the mapping needs.
    #[error("the mapping needs {what}, which the session does not provide; {remedy}")]
    Sensed { what: String, remedy: &'static str },
}

impl BridgeError {
    /// Whether a new connection may help: nobody accepted one, or nobody answered in time.
    pub fn is_transient(&self) -> bool {
        matches!(self, Self::Connect { .. } | Self::Silent { .. } | Self::Timeout { .. } | Self::Lost { .. })
    }

    pub(crate) fn malformed(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Malformed { what: what.into(), problem: problem.into() }
    }
}
