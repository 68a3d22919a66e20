use std::time::Duration;

/// A peer of a session as a state machine without I/O, clock or threads. All three peers have this one shape.
///
/// Times are measured from an origin of the caller's choice. A caller gives each message to [`handle`](Machine::handle),
/// carries out what [`poll`](Machine::poll) returns until that is `None`, and sleeps until the next message or until
/// [`wake_at`](Machine::wake_at), when it gives a `Tick`.
pub trait Machine {
    /// What reaches the peer.
    type Input;
    /// What the peer wants done.
    type Output;

    /// Takes one input, and whatever the time has brought.
    fn handle(&mut self, input: Self::Input, now: Duration);

    /// What is to be done next, in this order. Carry it out before the next call: a machine may do work of its own between
    /// two outputs, while the other side acts on the first.
    fn poll(&mut self) -> Option<Self::Output>;

    /// When the machine has to be shown the time, once nothing is left to poll.
    fn wake_at(&self) -> Option<Duration>;
}
