use std::time::Duration;

use thiserror::Error;

#[derive(Debug, Error)]
pub enum BridgeError {
    #[error(
        "cannot read '{given}' as the address of a model server; write {scheme}://HOST:PORT{}",
        if given.starts_with("wss:") { "; for TLS run a proxy on this side, and name the server with --model-host" } else { "" }
    )]
    Address { given: String, scheme: &'static str },
    #[error("cannot read '{given}' as the address of a tracked body; write stream=tcp://HOST:PORT")]
    Stream { given: String },
    #[error("cannot connect to the model server at {address}; start it, or correct --model")]
    Connect { address: String, source: std::io::Error },
    #[error("the server at {address} does not speak {transport}: {problem}; compare --dialect and --model with it")]
    Handshake { address: String, transport: &'static str, problem: String },
    #[error(
        "the server at {address} accepted a connection and did not complete the {transport} handshake within {:.1} s; a \
         server that computes or compiles answers late: allow more with --reply-timeout. If it is idle, compare --dialect \
         and --model with it",
        waited.as_secs_f64()
    )]
    Silent { address: String, transport: &'static str, waited: Duration },
    #[error(
        "the model server did not answer the question before the first episode within {:.0} s; if it compiles for longer, allow \
         more with --warm-up-timeout",
        waited.as_secs_f64()
    )]
    ColdStart { waited: Duration },
    #[error("the model server did not answer '{question}' within {:.1} s; allow more with --reply-timeout", waited.as_secs_f64())]
    Timeout { question: String, waited: Duration },
    #[error("the connection to the model server was lost during '{question}': {problem}")]
    Lost { question: String, problem: String },
    #[error("the model server sends {size} bytes; the limit is {most}")]
    TooLarge { size: u64, most: usize },
    #[error("cannot read {what} from the model server: {problem}")]
    Malformed { what: String, problem: String },
    #[error("the model server refuses '{question}': {text}")]
    Server { question: String, text: String },
    #[error("the mapping {name} cannot be used: {field}: {problem}")]
    Mapping { name: String, field: String, problem: String },
    #[error("the mapping {mapping} does not fit the model server; correct either:\n  {}", mismatches.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  "))]
    Contract { mapping: String, mismatches: Vec<crate::Mismatch> },
    #[error(
        "the mapping {mapping} commands the body by motion tokens ('{key}', {width} numbers), but no decoder is given; \
         name the folder of the GEAR-SONIC decoder (ONNX, 994 inputs, 29 outputs) with --controller sonic:DIR"
    )]
    NoDecoder { mapping: String, key: String, width: usize },
    #[error("the mapping needs {what}, which the session does not provide; {remedy}")]
    Sensed { what: String, remedy: &'static str },
}

impl BridgeError {
    /// True if a new connection may help: nobody accepted one, or nobody answered in time.
    pub fn is_transient(&self) -> bool {
        matches!(self, Self::Connect { .. } | Self::Silent { .. } | Self::Timeout { .. } | Self::Lost { .. })
    }

    pub(crate) fn malformed(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Malformed { what: what.into(), problem: problem.into() }
    }
}
