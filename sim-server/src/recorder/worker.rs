//! A thread that follows some of the sessions: Zenoh's callbacks only put into its queue, it writes bags.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::limits::{ACK_PERIOD_S, MAX_SERVER_MESSAGE, RECORDER_TIMEOUT_S};
use fiatlux_proto::v3::{StepRecord, StepRecordAck, StepRecordRequest};
use fiatlux_proto::{Message, decode, encoding};
use tracing::{debug, info, warn};
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::sample::Sample;
use zenoh::{Session as Zenoh, Wait};

use super::Shared;
use super::bags::Bags;
use super::order::MAX_WAITING;
use super::track::{Track, Write};

/// Between two looks at all sessions.
const TICK: Duration = Duration::from_millis(50);

/// An answer takes no longer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// An acknowledgement that can wait does so until it covers so many truths, or half of the longest time allowed.
const TRUTHS_PER_ACK: u64 = 64;

/// What event; sessions go by the key of their token.
pub(super) enum WorkerEvent {
    /// The token of a session is there.
    Live(Arc<str>),
    /// It is gone.
    Gone(Arc<str>),
    /// A truth, sent or asked for.
    StepRecord(Arc<str>, ZBytes),
    /// The answer to a session's request is complete.
    Answered(Arc<str>),
    /// End, after what is in the queue.
    Stop,
}

/// Puts a session's truths into the queue. One too many is dropped: it is asked for again.
#[derive(Clone)]
struct Inlet {
    key: Arc<str>,
    queue: Sender<WorkerEvent>,
    queued: Arc<AtomicUsize>,
}

impl Inlet {
    fn push(&self, sample: &Sample) {
        if self.queued.fetch_add(1, Ordering::Relaxed) >= MAX_WAITING {
            self.queued.fetch_sub(1, Ordering::Relaxed);
            return;
        }
        // The worker may be gone.
        let _ = self.queue.send(WorkerEvent::StepRecord(Arc::clone(&self.key), sample.payload().clone()));
    }
}

/// Tells the worker that Zenoh has dropped the callback of a request: no answer follows.
struct AnswerEnd(Inlet);

impl Drop for AnswerEnd {
    fn drop(&mut self) {
        let _ = self.0.queue.send(WorkerEvent::Answered(Arc::clone(&self.0.key)));
    }
}

/// A session that is followed.
struct Followed {
    keys: SessionKeys,
    inlet: Inlet,
    track: Track,
    bags: Bags,
    /// Since when its token is gone.
    gone_at: Option<Duration>,
    acked: u64,
    ack_at: Duration,
    _truths: Subscriber<()>,
}

/// A worker's thread.
pub(super) struct Worker {
    pub zenoh: Zenoh,
    pub shared: Arc<Shared>,
    pub inbox: Receiver<WorkerEvent>,
    pub queue: Sender<WorkerEvent>,
    pub start: Instant,
}

impl Worker {
    /// Follows sessions until it is told to stop; returns the files of unfinished bags.
    pub fn run(self) -> Vec<PathBuf> {
        let mut sessions: BTreeMap<Arc<str>, Followed> = BTreeMap::new();
        let mut tick_at = Duration::ZERO;
        loop {
            let event = self.inbox.recv_timeout(TICK);
            let now = self.start.elapsed();
            match event {
                Ok(WorkerEvent::Stop) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(event) => self.handle(&mut sessions, event, now),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if now >= tick_at {
                tick_at = now + TICK;
                sessions.values_mut().for_each(|session| self.advance(session, now));
                sessions.retain(|_, session| !session.is_done(now));
            }
        }
        sessions.into_values().filter_map(|session| session.bags.leave()).collect()
    }

    fn handle(&self, sessions: &mut BTreeMap<Arc<str>, Followed>, event: WorkerEvent, now: Duration) {
        match event {
            WorkerEvent::Live(key) => {
                if let Some(session) = sessions.get_mut(&key) {
                    session.gone_at = None;
                } else if let Some(session) = self.follow(&key, now) {
                    sessions.insert(key, session);
                }
            }
            WorkerEvent::Gone(key) => {
                if let Some(session) = sessions.get_mut(&key) {
                    session.gone_at = session.gone_at.or(Some(now));
                }
            }
            WorkerEvent::StepRecord(key, bytes) => {
                let Some(session) = sessions.get_mut(&key) else { return };
                session.inlet.queued.fetch_sub(1, Ordering::Relaxed);
                match decode::<StepRecord>(&bytes.to_bytes(), MAX_SERVER_MESSAGE) {
                    Ok(truth) => session.track.take(truth, now),
                    Err(error) => warn!(%key, %error, "a truth is passed over; does the server speak this version?"),
                }
                self.advance(session, now);
            }
            WorkerEvent::Answered(key) => {
                let Some(session) = sessions.get_mut(&key) else { return };
                session.track.answered(now);
                self.advance(session, now);
            }
            WorkerEvent::Stop => {}
        }
    }

    fn follow(&self, key: &Arc<str>, now: Duration) -> Option<Followed> {
        let (keys, server, session) = SessionKeys::of(key)?;
        let mut bags = Bags::new(&self.shared, server, session);
        let track = match bags.resume(server, session) {
            Some((header, next_step)) => {
                info!(%key, next_step, "an unfinished bag is taken up");
                Track::resume(header, next_step, now)
            }
            None => Track::new(now),
        };
        let inlet = Inlet { key: Arc::clone(key), queue: self.queue.clone(), queued: Arc::default() };
        let heard = inlet.clone();
        let truths = self.zenoh.declare_subscriber(keys.truth_row()).callback(move |sample| heard.push(&sample)).wait();
        let truths = truths.map_err(|error| warn!(%key, %error, "a session is not recorded")).ok()?;
        debug!(%key, "a session is recorded");
        Some(Followed { keys, inlet, track, bags, gone_at: None, acked: 0, ack_at: now, _truths: truths })
    }

    /// Writes what can be written, asks for what is missing and acknowledges what is on disk.
    fn advance(&self, session: &mut Followed, now: Duration) {
        let mut bag_ended = false;
        while let Some(write) = session.track.next_write() {
            bag_ended |= matches!(write, Write::Finish(_) | Write::Cut(_));
            if !session.bags.write(write) {
                session.track.give_up();
            }
        }
        if let Some(request) = session.track.request(now) {
            self.ask(session, &request);
        }
        let next_seq = session.track.next_seq(session.bags.next_step_on_disk());
        let is_due = bag_ended || next_seq >= session.acked + TRUTHS_PER_ACK;
        if is_due && next_seq != session.acked || now >= session.ack_at {
            session.acked = next_seq;
            session.ack_at = now + Duration::from_secs_f64(ACK_PERIOD_S / 2.0);
            self.acknowledge(session, next_seq);
        }
        let is_over = session.gone_at.is_some_and(|at| now >= at + Duration::from_secs_f64(RECORDER_TIMEOUT_S));
        if is_over && session.track.has_open_bag() {
            session.bags.write(Write::Cut("the server went away before the episode ended".into()));
            session.track.give_up();
        }
    }

    fn ask(&self, session: &Followed, request: &StepRecordRequest) {
        let end = AnswerEnd(session.inlet.clone());
        let take = move |reply: Reply| {
            if let Ok(sample) = reply.result() {
                end.0.push(sample);
            }
        };
        let asked = self.zenoh.get(session.keys.truth_rows());
        let asked = asked.payload(request.encode_to_vec()).encoding(Encoding::from(encoding("StepRecordRequest")));
        // All replies have one key, and each counts.
        let asked = asked.consolidation(ConsolidationMode::None).timeout(ANSWER_TIMEOUT);
        if let Err(error) = asked.callback(take).wait() {
            warn!(key = %session.inlet.key, %error, "cannot ask for truths");
        }
    }

    fn acknowledge(&self, session: &Followed, next_seq: u64) {
        let ack = StepRecordAck { recorder: self.shared.name.clone(), next_seq };
        let put = self.zenoh.put(session.keys.truth_ack(), ack.encode_to_vec());
        if let Err(error) = put.encoding(Encoding::from(encoding("StepRecordAck"))).wait() {
            warn!(key = %session.inlet.key, %error, "cannot acknowledge truths");
        }
    }
}

impl Followed {
    /// Nothing more comes, and no bag is open.
    fn is_done(&self, now: Duration) -> bool {
        // What was sent before the token went may still be on its way.
        self.gone_at.is_some_and(|at| now >= at + Duration::from_secs_f64(ACK_PERIOD_S)) && !self.track.has_open_bag()
    }
}
