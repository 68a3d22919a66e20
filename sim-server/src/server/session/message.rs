//! What goes into a session and what comes out of it.

use std::time::Duration;

use fiatlux_proto::Message;
use fiatlux_proto::v3::refusal::Code as RefusalCode;
use fiatlux_proto::v3::{LookReply, Observation, Refusal, ResetReply, look_reply, reset_reply};
use zenoh::bytes::ZBytes;

use crate::server::plan::refusal;

/// Spans that a session keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::server) struct Times {
    pub grace: Duration,
    pub action_timeout: Duration,
    pub resend: Duration,
    pub recorder_timeout: Duration,
}

/// What reaches a session. `R` is where a reply goes.
#[derive(Debug)]
pub(in crate::server) enum Input<R> {
    Action(ZBytes),
    Reset(ZBytes, R),
    Close(ZBytes, R),
    /// Asks for the last observation.
    Observation(R),
    /// Asks for sensors at the present step.
    Look(ZBytes, R),
    /// The client's liveliness token.
    ClientSeen,
    ClientGone,
    /// A recorder's acknowledgement.
    Ack(ZBytes),
    /// A recorder asks for truths.
    StepRecords(ZBytes, R),
    /// Messages of the client that found the inbox full.
    PassedOver(u64),
    /// A message of the client that is too large to be read, of so many bytes.
    TooLarge(usize),
    /// Nothing but the time.
    Tick,
    /// The server shuts down.
    Shutdown,
    /// A fault of ours.
    #[cfg(test)]
    Panic,
}

/// What a session sends.
#[derive(Debug)]
pub(in crate::server) enum Output<R> {
    Observation(ZBytes),
    Notice(ZBytes),
    StepRecord(ZBytes),
    /// Replies to a query, with the name of their message.
    Reply(R, &'static str, Vec<ZBytes>),
    /// A [`Refusal`] as the error reply to a query that has no other form for it.
    Refuse(R, ZBytes),
    /// No client has this session any more; it only waits for its recorder.
    Closed,
    /// Nothing is left to do.
    Done,
}

pub(in crate::server) type Sink<'a, R> = &'a mut dyn FnMut(Output<R>);

pub(super) fn closed() -> Refusal {
    refusal(RefusalCode::Closed, "", "the session is closed; open another one")
}

pub(super) fn refuse<R>(to: R, refusal: &Refusal, out: Sink<'_, R>) {
    out(Output::Refuse(to, refusal.encode_to_vec().into()));
}

pub(super) fn reset_refused<R>(to: R, refusal: Refusal, out: Sink<'_, R>) {
    let reply = ResetReply { reply: Some(reset_reply::Reply::Refusal(refusal)) };
    out(Output::Reply(to, "ResetReply", vec![reply.encode_to_vec().into()]));
}

/// Answers a look.
pub(super) fn looked<R>(to: R, seen: Result<Observation, Refusal>, out: Sink<'_, R>) {
    let reply = seen.map_or_else(look_reply::Reply::Refusal, look_reply::Reply::Observation);
    out(Output::Reply(to, "LookReply", vec![LookReply { reply: Some(reply) }.encode_to_vec().into()]));
}

/// Answers with an observation.
pub(super) fn reset_replied<R>(to: R, observation: Observation, out: Sink<'_, R>) {
    let reply = ResetReply { reply: Some(reset_reply::Reply::Observation(observation)) };
    out(Output::Reply(to, "ResetReply", vec![reply.encode_to_vec().into()]));
}
