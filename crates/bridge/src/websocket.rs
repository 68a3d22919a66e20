//! A WebSocket connection to a model server: binary and text frames, no TLS, no compression.

use std::io;

use tungstenite::client::IntoClientRequest;
use tungstenite::client::client_with_config;
use tungstenite::http::HeaderValue;
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Error, HandshakeError, Message, WebSocket};

use crate::BridgeError;
use crate::net::{Address, DeadlineStream, MAX_REPLY, Timeouts, broken};

/// Maximum length of a server's text that is repeated in an error, characters.
pub(crate) const MAX_WORDS: usize = 400;

#[derive(Debug, PartialEq)]
pub(crate) enum Frame {
    Binary(Vec<u8>),
    Text(String),
}

/// An open connection. It cannot be used after an error.
#[derive(Debug)]
pub(crate) struct Socket {
    socket: WebSocket<DeadlineStream>,
    timeouts: Timeouts,
}

impl Socket {
    /// Connects, and sends an API key if there is one. `host` is the server's name, if the address is that of a tunnel
    /// or proxy.
    pub fn connect(
        address: &Address,
        timeouts: Timeouts,
        host: Option<&str>,
        key: Option<&str>,
    ) -> Result<Self, BridgeError> {
        let mut stream = address.connect(timeouts.connect)?;
        // A server that is computing for another client accepts late.
        stream.allow(timeouts.reply);
        let refused = |problem: String| BridgeError::Handshake {
            address: address.to_string(),
            transport: "WebSocket",
            problem: shortened(&problem),
        };
        let late =
            || BridgeError::Silent { address: address.to_string(), transport: "WebSocket", waited: timeouts.reply };
        let url = format!("ws://{address}{}", address.path());
        let mut request = url.into_client_request().map_err(|error| refused(error.to_string()))?;
        let key = key.map(|key| format!("Api-Key {key}"));
        for (name, value) in [("Authorization", key.as_deref()), ("Host", host)] {
            let Some(value) = value else { continue };
            let value = HeaderValue::from_str(value)
                .map_err(|_| refused(format!("our header {name} has characters that HTTP does not allow")))?;
            request.headers_mut().insert(name, value);
        }
        let config = WebSocketConfig::default().max_message_size(Some(MAX_REPLY)).max_frame_size(Some(MAX_REPLY));
        let opened = client_with_config(request, stream, Some(config));
        let (socket, _) = opened.map_err(|error| match error {
            HandshakeError::Failure(Error::Io(error)) if error.kind() == io::ErrorKind::TimedOut => late(),
            HandshakeError::Failure(Error::Io(error)) => broken(&error, "greeting", timeouts.reply),
            HandshakeError::Failure(error) => refused(error.to_string()),
            HandshakeError::Interrupted(_) => late(),
        })?;
        Ok(Self { socket, timeouts })
    }

    pub fn send(&mut self, name: &str, question: Vec<u8>) -> Result<(), BridgeError> {
        self.socket.get_mut().allow(self.timeouts.reply);
        self.socket.send(Message::binary(question)).map_err(|error| self.failed(error, name))
    }

    /// Waits for the next message, and answers pings meanwhile.
    pub fn receive(&mut self, name: &str) -> Result<Frame, BridgeError> {
        self.socket.get_mut().allow(self.timeouts.reply);
        loop {
            match self.socket.read() {
                Ok(Message::Binary(bytes)) => return Ok(Frame::Binary(bytes.into())),
                Ok(Message::Text(text)) => return Ok(Frame::Text(text.as_str().into())),
                Ok(Message::Close(frame)) => {
                    let reason = frame.map(|frame| format!("the server closed it: {} {}", frame.code, frame.reason));
                    let problem = shortened(&reason.unwrap_or_else(|| "the server closed it".into()));
                    return Err(BridgeError::Lost { question: name.into(), problem });
                }
                Ok(_) => {}
                Err(error) => return Err(self.failed(error, name)),
            }
        }
    }

    fn failed(&self, error: Error, name: &str) -> BridgeError {
        match error {
            Error::Io(error) => broken(&error, name, self.timeouts.reply),
            Error::Capacity(tungstenite::error::CapacityError::MessageTooLong { size, max_size }) => {
                BridgeError::TooLarge { size: size as u64, most: max_size }
            }
            Error::Capacity(error) => BridgeError::malformed("a frame", error.to_string()),
            Error::Utf8(_) => BridgeError::malformed("a text frame", "it is not UTF-8"),
            error => BridgeError::Lost { question: name.into(), problem: shortened(&error.to_string()) },
        }
    }
}

/// Shortens a server's text from the front: a traceback gives the reason at its end.
pub(crate) fn shortened(text: &str) -> String {
    let text = text.trim();
    let count = text.chars().count();
    if count <= MAX_WORDS {
        return text.into();
    }
    let tail: String = text.chars().skip(count - MAX_WORDS).collect();
    format!("... {tail}")
}
