//! Queries as they arrive, and replies to them.

use std::fmt;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration, Instant};

use fiatlux_proto::Bytes;

use crate::{CarrierError, Message};

/// A reply: a message, or the payload of an error.
pub type Reply = Result<Message, Bytes>;

/// Sends replies to one query. When it is dropped, the query gets no further reply.
pub trait Respond: Send + Sync {
    /// Replies on a key.
    ///
    /// # Errors
    /// The asker is gone.
    fn reply(&self, key: &str, message: &str, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError>;

    /// Replies with an error.
    ///
    /// # Errors
    /// The asker is gone.
    fn refuse(&self, message: &str, payload: Bytes) -> Result<(), CarrierError>;
}

/// A query as it arrives. The asker waits until all copies are dropped.
#[derive(Clone)]
pub struct Query {
    /// Key that was asked; it may have `*` for several peers.
    pub key: String,
    /// Encoded content.
    pub payload: Bytes,
    /// Proof of the sender; may be empty.
    pub attachment: Bytes,
    responder: Arc<dyn Respond>,
}

impl Query {
    /// A query that arrived over a transport.
    pub fn new(key: String, payload: Bytes, attachment: Bytes, responder: impl Respond + 'static) -> Self {
        Self { key, payload, attachment, responder: Arc::new(responder) }
    }

    /// Replies on a key.
    ///
    /// # Errors
    /// The asker is gone.
    pub fn reply(&self, key: &str, message: &str, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        self.responder.reply(key, message, payload, attachment)
    }

    /// Replies with an error.
    ///
    /// # Errors
    /// The asker is gone.
    pub fn refuse(&self, message: &str, payload: Bytes) -> Result<(), CarrierError> {
        self.responder.refuse(message, payload)
    }
}

impl fmt::Debug for Query {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Query").field("key", &self.key).field("bytes", &self.payload.len()).finish_non_exhaustive()
    }
}

/// Replies to a query, as they arrive.
#[derive(Debug)]
pub struct Replies {
    replies: Receiver<Reply>,
    until: Instant,
}

impl Replies {
    /// The sender of replies, which end at the timeout at the latest.
    pub(crate) fn within(timeout: Duration) -> (Sender<Reply>, Self) {
        let (sender, replies) = mpsc::channel();
        (sender, Self { replies, until: Instant::now() + timeout })
    }
}

impl Iterator for Replies {
    type Item = Reply;

    fn next(&mut self) -> Option<Reply> {
        self.replies.recv_timeout(self.until.saturating_duration_since(Instant::now())).ok()
    }
}
