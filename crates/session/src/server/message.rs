//! What goes into a server's session and what comes out of it.

use std::time::Duration;

use fiatlux_proto::{Bytes, limits};

/// Spans that a session keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timeouts {
    /// How long it waits for a client that is gone.
    pub grace: Duration,
    /// How long it waits for an action.
    pub action: Duration,
    /// After this long without an observation a client sends its action again.
    pub resend: Duration,
    /// How long it waits for a recorder that makes no progress.
    pub recorder: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            grace: Duration::from_secs(10),
            action: Duration::from_secs(60),
            resend: Duration::from_millis(100),
            recorder: limits::RECORDER_TIMEOUT,
        }
    }
}

/// What reaches a session. `R` is where a reply goes.
#[derive(Debug)]
pub enum Input<R> {
    /// An [`Action`](fiatlux_proto::v3::Action) of the client.
    Action(Bytes),
    /// Query `reset`: its payload, and where the reply goes.
    Reset(Bytes, R),
    /// Query `close`: its payload, and where the reply goes.
    Close(Bytes, R),
    /// Query `observation`, for the last one.
    Observation(R),
    /// Query `look`: its payload, and where the reply goes.
    Look(Bytes, R),
    /// The client's liveliness token is there.
    ClientSeen,
    /// The client's liveliness token is gone.
    ClientGone,
    /// A recorder's acknowledgement of records: a [`StepRecordAck`](fiatlux_proto::v3::StepRecordAck).
    Ack(Bytes),
    /// Query `truth/rows` of a recorder.
    StepRecords(Bytes, R),
    /// That many messages of the client found the inbox full and were dropped.
    Dropped(u64),
    /// A message of the client that is too large to be read, with its size in bytes.
    TooLarge(usize),
    /// The session has to end, for this reason.
    Terminate(&'static str),
    /// Nothing but the time.
    Tick,
}

/// What a session wants sent.
#[derive(Debug)]
pub enum Output<R> {
    /// Publish an [`Observation`](fiatlux_proto::v3::Observation) on `observation`.
    Observation(Bytes),
    /// Publish a [`Notice`](fiatlux_proto::v3::Notice) on `notice`.
    Notice(Bytes),
    /// Publish a [`StepRecord`](fiatlux_proto::v3::StepRecord) on `truth/row`.
    StepRecord(Bytes),
    /// Reply to a query, with the name of the replies' message.
    Reply(R, &'static str, Vec<Bytes>),
    /// Reply to a query with a [`Refusal`](fiatlux_proto::v3::Refusal) as an error: it has no other form for one.
    Refuse(R, Bytes),
    /// No client has this session any more; it only waits for its recorder.
    Closed,
    /// Nothing is left to do.
    Done,
}
