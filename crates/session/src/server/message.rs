//! Inputs and outputs of a server's session.

use std::time::Duration;

use fiatlux_proto::{Bytes, limits};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timeouts {
    /// Time within which a client is to use a new session. It has that long to show its token, even where the grace time is shorter.
    pub claim: Duration,
    /// Time for which the session waits for a client whose token is gone.
    pub grace: Duration,
    /// Time for which the session waits for an action in real time.
    pub action: Duration,
    /// The same in lockstep, for a client that is there: it may think for long, but not keep its place for ever.
    pub lockstep: Duration,
    /// Time without an observation after which a client should send its action again.
    pub resend: Duration,
    /// Time for which the session waits for a recorder that makes no progress.
    pub recorder: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            claim: Duration::from_secs(5),
            grace: Duration::from_secs(10),
            action: Duration::from_secs(60),
            lockstep: Duration::from_secs(600),
            resend: Duration::from_millis(100),
            recorder: limits::RECORDER_TIMEOUT,
        }
    }
}

/// An input of a session. `R` says where a reply goes.
#[derive(Debug)]
pub enum Input<R> {
    /// An [`Action`](fiatlux_proto::v3::Action) of the client.
    Action(Bytes),
    /// Query `reset`: its payload, and where the reply goes.
    Reset(Bytes, R),
    /// Query `close`: its payload, and where the reply goes.
    Close(Bytes, R),
    /// Query `observation`, which asks for the last one again.
    Observation(R),
    /// Query `look`: its payload, and where the reply goes.
    Look(Bytes, R),
    /// The client's liveliness token has appeared.
    ClientSeen,
    /// The client's liveliness token is gone.
    ClientGone,
    /// A recorder's acknowledgement of records: a [`StepRecordAck`](fiatlux_proto::v3::StepRecordAck).
    Ack(Bytes),
    /// Query `truth/rows` of a recorder.
    StepRecords(Bytes, R),
    /// This many messages of the client were dropped because the inbox was full.
    Dropped(u64),
    /// A message of the client was too large to read; its size in bytes.
    TooLarge(usize),
    /// The server wants the session to end, for this reason.
    Terminate(&'static str),
    /// Nothing has arrived; only time has passed.
    Tick,
}

/// Requests of a session to its caller.
#[derive(Debug)]
pub enum Output<R> {
    /// Publish an [`Observation`](fiatlux_proto::v3::Observation) on `observation`.
    Observation(Bytes),
    /// Publish a [`Notice`](fiatlux_proto::v3::Notice) on `notice`.
    Notice(Bytes),
    /// Publish a [`StepRecord`](fiatlux_proto::v3::StepRecord) on `truth/row`.
    StepRecord(Bytes),
    /// Reply to a query with these messages of this type.
    Reply(R, &'static str, Vec<Bytes>),
    /// Reply to a query with a [`Refusal`](fiatlux_proto::v3::Refusal) as a Zenoh error, since its reply has no field for one.
    Refuse(R, Bytes),
    /// The client is done with the session, which now only waits for its recorder.
    Closed,
    /// The session is over; drop it.
    Done,
}
