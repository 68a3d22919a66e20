//! Carries messages between peers, over any transport.
//!
//! A [`Carrier`] has what a session needs: publications, queries with any number of replies, and liveliness tokens, on
//! keys such as `fiatlux/v3/lab/s/7/action`. In a key that is subscribed to or asked, `*` stands for one part and `**`
//! for any number of them. [`memory`] carries messages between the threads of one process; `fiatlux-link` carries them
//! over Zenoh. Another transport implements [`Transport`].
//!
//! Nothing is guaranteed to arrive: messages carry their episode and step, and peers ask again.
//!
//! ```
//! use fiatlux_carrier::{Carrier, Quality, Reach};
//!
//! let carrier = fiatlux_carrier::memory();
//! let (sender, inbox) = std::sync::mpsc::channel();
//! let _subscription = carrier.subscribe("example/*", Reach::Everywhere, move |message| drop(sender.send(message)))?;
//! let publisher = carrier.publisher("example/greeting", "Text", Quality::default(), Reach::Everywhere)?;
//! publisher.put("hello".into(), Vec::new())?;
//! assert_eq!(inbox.recv().unwrap().payload, "hello");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
mod busy_wait;
mod memory;
mod query;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use fiatlux_proto::Bytes;
use thiserror::Error;

pub use busy_wait::BusyWait;
pub use memory::{Memory, memory};
pub use query::{Query, Replies, Reply, Respond};

/// A transport refuses a key or a message.
#[derive(Debug, Clone, Error)]
#[error("{0}")]
pub struct CarrierError(pub String);

/// A message as it arrives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Key on which it was sent.
    pub key: String,
    /// Encoded content.
    pub payload: Bytes,
    /// Proof of its sender; may be empty.
    pub attachment: Bytes,
}

/// Peers that a message may come from or go to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Reach {
    /// Peers that use the same carrier in this process.
    ThisProcess,
    /// Peers in other processes.
    OtherProcesses,
    /// All of them.
    #[default]
    Everywhere,
}

/// The order in which messages are sent when a link is full.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Priority {
    /// Before everything else.
    RealTime,
    /// Before records.
    Interactive,
    /// In the order of arrival.
    #[default]
    Data,
}

/// The way messages are sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Quality {
    /// The order when a link is full.
    pub priority: Priority,
    /// Send each message at once, rather than several in a packet.
    pub express: bool,
    /// Wait for a full link, rather than drop the message.
    pub blocking: bool,
}

/// A query to be sent.
#[derive(Debug, Clone, Default)]
pub struct Question {
    /// Key of the peers that are asked.
    pub key: String,
    /// Name of the payload's message; empty if it has none.
    pub message: String,
    /// Encoded content.
    pub payload: Bytes,
    /// Proof of the sender; may be empty.
    pub attachment: Vec<u8>,
    /// Time in which peers may reply.
    pub timeout: Duration,
    /// Use the priority of actions, so that it stays in order among them.
    pub is_urgent: bool,
    /// The peers that are asked.
    pub reach: Reach,
}

type OnMessage = Box<dyn Fn(Message) + Send + Sync>;
type OnQuery = Box<dyn Fn(Query) + Send + Sync>;
type OnReply = Box<dyn FnMut(Reply) + Send>;
type OnToken = Box<dyn Fn(&str, bool) + Send + Sync>;

/// Something declared on a carrier, such as a subscription or a token. Dropping it withdraws the declaration.
pub struct Declaration(#[expect(dead_code, reason = "held for its Drop")] Box<dyn Send + Sync>);

impl Declaration {
    /// Wraps what a transport has declared.
    pub fn new(declared: impl Send + Sync + 'static) -> Self {
        Self(Box::new(declared))
    }
}

impl fmt::Debug for Declaration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Declaration")
    }
}

/// Carries messages. Callbacks may run in any thread, also in that of a caller; they must not block.
pub trait Transport: Send + Sync {
    /// Identifies this peer among all that it can reach.
    fn id(&self) -> String;

    /// True where messages are delivered in the thread that sends them, which can then do what they ask for.
    fn delivers_in_place(&self) -> bool {
        false
    }

    /// Prepares to publish messages of one type on a key.
    ///
    /// # Errors
    /// The transport refuses the key.
    fn publisher(
        &self,
        key: &str,
        message: &str,
        quality: Quality,
        reach: Reach,
    ) -> Result<Box<dyn Publish>, CarrierError>;

    /// Calls back with each message that arrives on a key.
    ///
    /// # Errors
    /// The transport refuses the key.
    fn subscribe(&self, key: &str, from: Reach, on_message: OnMessage) -> Result<Declaration, CarrierError>;

    /// Calls back with each query that arrives on a key.
    ///
    /// # Errors
    /// The transport refuses the key.
    fn serve(&self, key: &str, from: Reach, on_query: OnQuery) -> Result<Declaration, CarrierError>;

    /// Sends a query to all peers that serve its key. The callback is dropped when no further reply can arrive.
    ///
    /// # Errors
    /// The transport refuses the query.
    fn ask(&self, question: Question, on_reply: OnReply) -> Result<(), CarrierError>;

    /// Declares a liveliness token, which goes when the declaration or the whole peer does.
    ///
    /// # Errors
    /// The transport refuses the key.
    fn token(&self, key: &str) -> Result<Declaration, CarrierError>;

    /// Calls back with the key of each present token, and of each that appears (`true`) or disappears (`false`).
    ///
    /// # Errors
    /// The transport refuses the key.
    fn watch_tokens(&self, key: &str, on_token: OnToken) -> Result<Declaration, CarrierError>;

    /// Keys of all present tokens; looks for at most `timeout`.
    ///
    /// # Errors
    /// The transport refuses the key.
    fn tokens(&self, key: &str, timeout: Duration) -> Result<Vec<String>, CarrierError>;
}

/// Publishes on one key.
pub trait Publish: Send + Sync {
    /// Sends a message.
    ///
    /// # Errors
    /// The transport is closed.
    fn put(&self, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError>;

    /// True if somebody is subscribed to the key.
    fn has_subscribers(&self) -> bool;
}

/// A transport, shared by all parts of a program.
#[derive(Clone)]
pub struct Carrier(Arc<dyn Transport>);

impl fmt::Debug for Carrier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Carrier({})", self.0.id())
    }
}

/// A key on which one type of message is published.
pub struct Publisher(Box<dyn Publish>);

impl fmt::Debug for Publisher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Publisher")
    }
}

impl Publisher {
    /// Sends a message.
    ///
    /// # Errors
    /// The transport is closed.
    pub fn put(&self, payload: Bytes, attachment: Vec<u8>) -> Result<(), CarrierError> {
        self.0.put(payload, attachment)
    }

    /// True if somebody is subscribed to the key.
    pub fn has_subscribers(&self) -> bool {
        self.0.has_subscribers()
    }
}

/// The methods of [`Transport`], which document their errors.
#[allow(clippy::missing_errors_doc)]
impl Carrier {
    /// A carrier over a transport.
    pub fn new(transport: impl Transport + 'static) -> Self {
        Self(Arc::new(transport))
    }

    /// Identifies this peer among all that it can reach.
    pub fn id(&self) -> String {
        self.0.id()
    }

    /// As [`Transport::delivers_in_place`].
    pub fn delivers_in_place(&self) -> bool {
        self.0.delivers_in_place()
    }

    /// As [`Transport::publisher`].
    pub fn publisher(
        &self,
        key: &str,
        message: &str,
        quality: Quality,
        reach: Reach,
    ) -> Result<Publisher, CarrierError> {
        self.0.publisher(key, message, quality, reach).map(Publisher)
    }

    /// As [`Transport::subscribe`].
    pub fn subscribe(
        &self,
        key: &str,
        from: Reach,
        on_message: impl Fn(Message) + Send + Sync + 'static,
    ) -> Result<Declaration, CarrierError> {
        self.0.subscribe(key, from, Box::new(on_message))
    }

    /// As [`Transport::serve`].
    pub fn serve(
        &self,
        key: &str,
        from: Reach,
        on_query: impl Fn(Query) + Send + Sync + 'static,
    ) -> Result<Declaration, CarrierError> {
        self.0.serve(key, from, Box::new(on_query))
    }

    /// As [`Transport::ask`].
    pub fn ask(&self, question: Question, on_reply: impl FnMut(Reply) + Send + 'static) -> Result<(), CarrierError> {
        self.0.ask(question, Box::new(on_reply))
    }

    /// Asks, and returns the replies as they arrive; they end at the question's timeout.
    pub fn ask_all(&self, question: Question) -> Result<Replies, CarrierError> {
        let timeout = question.timeout;
        let (sender, replies) = Replies::within(timeout);
        self.ask(question, move |reply| drop(sender.send(reply)))?;
        Ok(replies)
    }

    /// As [`Transport::token`].
    pub fn token(&self, key: &str) -> Result<Declaration, CarrierError> {
        self.0.token(key)
    }

    /// As [`Transport::watch_tokens`].
    pub fn watch_tokens(
        &self,
        key: &str,
        on_token: impl Fn(&str, bool) + Send + Sync + 'static,
    ) -> Result<Declaration, CarrierError> {
        self.0.watch_tokens(key, Box::new(on_token))
    }

    /// As [`Transport::tokens`].
    pub fn tokens(&self, key: &str, timeout: Duration) -> Result<Vec<String>, CarrierError> {
        self.0.tokens(key, timeout)
    }
}
