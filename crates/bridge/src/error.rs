//! What can go wrong with a model server.

use std::time::Duration;

use thiserror::Error;

/// Why a model server cannot be used, or what it sent cannot.
#[derive(Debug, Error)]
pub enum BridgeError {
    /// The address cannot be read.
    #[error("cannot read '{given}' as the address of a model server; write {scheme}://HOST:PORT")]
    Address {
        /// As it was given.
        given: String,
        /// The scheme of the dialect.
        scheme: &'static str,
    },
    /// Nobody answers there.
    #[error("cannot connect to the model server at {address}; start it, or correct --model")]
    Connect {
        /// Host and port.
        address: String,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// The other side is not a server of this dialect.
    #[error("the server at {address} does not speak {transport}: {problem}; compare --dialect and --model with it")]
    Handshake {
        /// Host and port.
        address: String,
        /// `ZeroMQ` or `WebSocket`.
        transport: &'static str,
        /// What it said.
        problem: String,
    },
    /// It takes too long.
    #[error("the model server did not answer '{question}' within {:.1} s; give it more with --reply-timeout", waited.as_secs_f64())]
    Timeout {
        /// What it was asked.
        question: String,
        /// How long it was waited for.
        waited: Duration,
    },
    /// The connection broke.
    #[error("the connection to the model server was lost during '{question}': {problem}")]
    Lost {
        /// What it was asked.
        question: String,
        /// What happened.
        problem: String,
    },
    /// A message over the bound.
    #[error("the model server sends {size} bytes; at most {most} are read")]
    TooLarge {
        /// As it announced.
        size: u64,
        /// The bound.
        most: usize,
    },
    /// Bytes that are not what the dialect has.
    #[error("cannot read {what} of the model server: {problem}")]
    Malformed {
        /// What was read.
        what: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The server refuses, in its own words.
    #[error("the model server refuses '{question}': {text}")]
    Server {
        /// What it was asked.
        question: String,
        /// Its words, shortened.
        text: String,
    },
    /// A mapping or a file of hands that cannot be used.
    #[error("the mapping {name} cannot be used: {field}: {problem}")]
    Mapping {
        /// Its name or path.
        name: String,
        /// The field that is wrong.
        field: String,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// Mapping and server do not fit. Nothing has moved.
    #[error("the mapping {mapping} does not fit the model server; correct either:\n  {}", mismatches.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  "))]
    Contract {
        /// Name of the mapping.
        mapping: String,
        /// All that does not fit.
        mismatches: Vec<crate::Mismatch>,
    },
    /// The model speaks motion tokens, and nobody can read them.
    #[error(
        "the mapping {mapping} commands the body by motion tokens ('{key}', {width} numbers), and no decoder is given; name the \
         folder of the GEAR-SONIC decoder (ONNX, 994 inputs, 29 outputs) with --controller sonic:DIR"
    )]
    NoDecoder {
        /// Name of the mapping.
        mapping: String,
        /// The action key with the tokens.
        key: String,
        /// Numbers of a token.
        width: usize,
    },
    /// A number that the session does not give.
    #[error("the mapping needs {what}, which the session does not give; {remedy}")]
    Sensed {
        /// What is missing.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
}

impl BridgeError {
    /// Whether a new connection may help: nobody was there, or nobody answered.
    pub fn is_transient(&self) -> bool {
        matches!(self, Self::Connect { .. } | Self::Timeout { .. } | Self::Lost { .. })
    }

    pub(crate) fn malformed(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Malformed { what: what.into(), problem: problem.into() }
    }
}
