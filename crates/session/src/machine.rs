use std::time::Duration;

/// A peer of a session as a state machine without I/O, clock or threads. All three peers have this one shape.
///
/// Times are measured from an origin of the caller's choice. A caller gives each message to [`handle`](Machine::handle),
/// carries out what [`poll`](Machine::poll) returns until that is `None`, and sleeps until the next message or until
/// [`wake_at`](Machine::wake_at), when it gives a `Tick`.
pub trait Machine {
    /// Events of the peer: messages, answers, and time passing.
    type Input;
    /// Requests of the peer to its caller.
    type Output;

    /// Handles one input, and everything that is due at `now`.
    fn handle(&mut self, input: Self::Input, now: Duration);

    /// The next thing to do, in order. Do it before the next call: a machine may do work of its own between
    /// two outputs, while the other side acts on the first.
    fn poll(&mut self) -> Option<Self::Output>;

    /// When to give the machine a `Tick`, once nothing is left to poll; `None` if only a message can wake it.
    fn wake_at(&self) -> Option<Duration>;
}
