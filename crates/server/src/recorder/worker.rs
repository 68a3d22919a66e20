//! A thread that writes the bags of some of the sessions. What reaches it are records that their servers have sealed, each once.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use fiatlux_proto::Bytes;
use fiatlux_session::Machine;
use fiatlux_session::recorder::{Input, Output};
use tracing::{debug, warn};

use super::RecorderState;
use super::greeter::ToGreeter;
use super::inlet::{Followed, WorkerEvent};

/// Time between two checks of all sessions.
const TICK: Duration = Duration::from_millis(50);

/// Pause in which records gather, so that one waking serves several: to wake this thread costs a session more than to encode
/// a record.
const GATHERING: Duration = Duration::from_millis(2);

/// State of a worker's thread.
pub(super) struct Worker {
    pub shared: Arc<RecorderState>,
    pub inbox: Receiver<WorkerEvent>,
    pub greeter: ToGreeter,
}

impl Worker {
    /// Follows sessions until it is told to stop; returns the files of unfinished bags.
    pub fn run(self) -> Vec<PathBuf> {
        let mut sessions: BTreeMap<Arc<str>, Followed> = BTreeMap::new();
        let mut tick_at = Duration::ZERO;
        let mut gathers = false;
        loop {
            let event = self.inbox.try_recv().or_else(|_| {
                if std::mem::take(&mut gathers) {
                    std::thread::sleep(GATHERING);
                }
                self.inbox.recv_timeout(TICK)
            });
            gathers |= matches!(event, Ok(WorkerEvent::StepRecord(..)));
            let now = self.shared.start.elapsed();
            match event {
                Ok(WorkerEvent::Stop) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(event) => self.handle(&mut sessions, event, now),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if now >= tick_at {
                tick_at = now + TICK;
                let is_due = |session: &Followed| session.state.wake_at().is_some_and(|at| now >= at);
                sessions.retain(|_, session| !is_due(session) || self.advance(session, Input::Tick, now));
            }
        }
        sessions.into_values().filter_map(|session| session.bags.leave()).collect()
    }

    fn handle(&self, sessions: &mut BTreeMap<Arc<str>, Followed>, event: WorkerEvent, now: Duration) {
        let (key, input) = match event {
            WorkerEvent::Follow(session) => {
                let key = Arc::clone(&session.inlet.key);
                debug!(%key, "recording a session");
                let is_gone = session.inlet.is_gone.load(Ordering::Relaxed);
                sessions.insert(Arc::clone(&key), *session);
                (key, if is_gone { Input::ServerGone } else { Input::ServerSeen })
            }
            WorkerEvent::Live(key) if !sessions.contains_key(&key) => return self.greeter.again(key),
            WorkerEvent::Live(key) => (key, Input::ServerSeen),
            WorkerEvent::Gone(key) => (key, Input::ServerGone),
            WorkerEvent::StepRecord(key, record) => {
                let Some(session) = sessions.get_mut(&key) else { return };
                session.inlet.is_dequeued();
                if session.inlet.is_gone.load(Ordering::Relaxed) {
                    // Whoever withdrew the token: the server is gone once it has been silent for that long.
                    session.state.handle(Input::ServerSeen, now);
                    session.state.handle(Input::ServerGone, now);
                }
                (key, Input::StepRecord(record))
            }
            WorkerEvent::Answered(key) => (key, Input::Answered),
            WorkerEvent::Stop => return,
        };
        if let Some(session) = sessions.get_mut(&key)
            && !self.advance(session, input, now)
        {
            sessions.remove(&key);
        }
    }

    /// Gives a session an input and carries out what it asks for; returns whether it continues.
    fn advance(&self, session: &mut Followed, input: Input, now: Duration) -> bool {
        session.state.handle(input, now);
        while let Some(output) = session.state.poll() {
            match output {
                Output::Request(request) => self.greeter.ask(&session.inlet, request),
                Output::Ack(ack) => acknowledge(session, ack),
                Output::Lost(records) => (self.shared.on_loss)(&session.inlet.key, records),
                Output::Done => return false,
                Output::Write(write) => {
                    let written = match session.bags.write(write) {
                        Ok(()) => Input::OnDisk(session.bags.next_step_on_disk()),
                        Err(error) => Input::WriteFailed(root_cause(&error)),
                    };
                    session.state.handle(written, now);
                }
            }
        }
        true
    }
}

fn acknowledge(session: &Followed, ack: Bytes) {
    let proof = session.inlet.seal.as_ref().map(|rows| rows.prove("ack", &ack).to_vec()).unwrap_or_default();
    if let Err(error) = session.acks.put(ack, proof) {
        warn!(key = %session.inlet.key, %error, "cannot acknowledge records");
    }
}

/// Why a bag cannot be written, without its path: clients get to know it.
fn root_cause(error: &dyn Error) -> String {
    error.source().map_or_else(|| error.to_string(), root_cause)
}
