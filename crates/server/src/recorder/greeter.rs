//! The recorder's talk with sessions: which ones there are, and requests to them. A thread of its own, since anybody can
//! declare tokens, and a network can be slow to take a request.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use fiatlux_access::RowsKey;
use fiatlux_carrier::{Carrier, Message as Sample, Question};
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::v3::StepRecordRequest;
use fiatlux_proto::{Bytes, Message, decode, limits};
use tracing::warn;

use super::RecorderState;
use super::inlet::{Inlet, Outlets};
use super::shelf::rows_of;

/// Longest wait for an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// A session that has announced itself is asked for a record after this time, and then after twice as long each time.
const FIRST_PROBE: Duration = Duration::from_secs(1);
const LAST_PROBE: Duration = Duration::from_secs(60);

/// Sessions asked for their first record in one go, and the time from one go to the next.
const PROBES: usize = 20;
const PROBE_PERIOD: Duration = Duration::from_millis(50);

/// Sessions whose token is gone that are asked in one go. Anybody can open sessions that end at once, and each question costs
/// the whole network; one whose token a stranger has withdrawn still has its turn.
const GONE_PROBES: usize = 1;

/// Pause between two requests to a session; it doubles with each request that brought nothing, up to the longest.
const PAUSE: Duration = Duration::from_millis(5);
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// Sessions without a record that are remembered. Beyond it the ones that were asked most often are forgotten: whoever
/// declares tokens of former sessions again keeps no new one out.
const MAX_SILENT: usize = 16_384;

/// A session without a record whose token is gone for this time is forgotten.
const FORGET: Duration = Duration::from_secs(10);

/// Events for the greeter.
pub(super) enum Greeting {
    /// A token has appeared (`true`) or gone.
    Token(String, bool),
    /// A token of a session for its client has appeared.
    Open(String),
    /// A worker does not follow this session, whose token has appeared.
    Again(Arc<str>),
    /// Ask the session for records, with this [`StepRecordRequest`].
    Ask(Arc<Inlet>, Bytes),
    Stop,
}

/// Servers whose sessions are watched for tokens that recorders get, and the time after which the log tells of one without.
const MAX_SERVERS: usize = 64;
const UNANNOUNCED: Duration = Duration::from_secs(5);

/// A server with open sessions.
#[derive(Clone, Copy)]
enum Server {
    /// It has announced none to recorders since this time.
    Unannounced(Duration),
    /// It announces them, or the log has told that it does not.
    Known,
}

/// A session that has sent no record.
struct Silent {
    inlet: Arc<Inlet>,
    probe_at: Duration,
    probes: u32,
    gone_at: Option<Duration>,
}

/// The requests to one session.
#[derive(Default)]
struct Asked {
    /// Records of the session at the last request, and how many requests since have brought none.
    heard: u64,
    fruitless: u32,
    at: Duration,
}

pub(super) struct Greeter {
    pub carrier: Carrier,
    pub shared: Arc<RecorderState>,
    pub inbox: Receiver<Greeting>,
    /// For each worker.
    pub outlets: Vec<Outlets>,
}

/// Tells the session's worker that the carrier has dropped the callback of a request: no answer follows.
struct AnswerEnd(Arc<Inlet>);

impl Drop for AnswerEnd {
    fn drop(&mut self) {
        self.0.end_answer();
    }
}

impl Greeter {
    /// Greets and asks until it is told to stop; the body of a thread.
    pub fn run(self) {
        let mut silent: BTreeMap<Arc<str>, Silent> = BTreeMap::new();
        let mut asked: BTreeMap<Arc<str>, Asked> = BTreeMap::new();
        // By the time at which they are due.
        let mut asks: BTreeMap<(Duration, u64), (Arc<Inlet>, Bytes)> = BTreeMap::new();
        let mut servers: BTreeMap<String, Server> = BTreeMap::new();
        let (mut number, mut probe_at) = (0, Duration::ZERO);
        loop {
            let now = self.shared.start.elapsed();
            let due = asks.first_key_value().map_or(probe_at, |((at, _), _)| probe_at.min(*at));
            let event = self.inbox.recv_timeout(due.saturating_sub(now));
            let now = self.shared.start.elapsed();
            match event {
                Ok(Greeting::Stop) | Err(RecvTimeoutError::Disconnected) => return,
                Ok(Greeting::Token(key, is_there)) => {
                    if let Some(server) = SessionKeys::of(&key).and_then(|(_, server, _)| servers.get_mut(server)) {
                        *server = Server::Known;
                    }
                    self.token(&mut silent, &key, is_there, now);
                }
                Ok(Greeting::Open(key)) => {
                    if let Some((_, server, _)) = SessionKeys::of(&key)
                        && servers.len() < MAX_SERVERS
                    {
                        servers.entry(server.into()).or_insert(Server::Unannounced(now));
                    }
                }
                Ok(Greeting::Again(key)) => {
                    // The worker has just let the session go; its key is the one that its token had.
                    if self.shared.inlets.get(&key).is_none()
                        && let Some((_, server, session)) = SessionKeys::of(&key)
                        && let Ok(rows) = RowsKey::of_recorder(&self.shared.key, server, session)
                    {
                        self.announce(&mut silent, key, rows, now);
                    }
                }
                Ok(Greeting::Ask(inlet, request)) => {
                    let state = asked.entry(Arc::clone(&inlet.key)).or_default();
                    let heard = inlet.heard();
                    state.fruitless = if heard > state.heard { 0 } else { (state.fruitless + 1).min(16) };
                    let pause = (PAUSE * 2_u32.pow(state.fruitless.saturating_sub(1))).min(LONGEST_PAUSE);
                    (state.heard, state.at) = (heard, now.max(state.at + pause));
                    number += 1;
                    asks.insert((state.at, number), (inlet, request));
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
            while let Some(first) = asks.first_entry().filter(|first| first.key().0 <= now) {
                let (inlet, request) = first.remove();
                self.ask(&inlet, request);
            }
            if now >= probe_at {
                probe_at = now + PROBE_PERIOD;
                self.probe(&mut silent, now);
                tell_of_unannounced(&mut servers, now);
                if asked.len() > MAX_SILENT {
                    asked.retain(|key, _| self.shared.inlets.get(key).is_some());
                }
            }
        }
    }

    fn token(&self, silent: &mut BTreeMap<Arc<str>, Silent>, token: &str, is_there: bool, now: Duration) {
        let Some((key, rows)) = rows_of(&self.shared, token) else { return self.shared.tell_of_strangers(token) };
        if let Some(inlet) = self.shared.inlets.get(&key) {
            if let Some(silent) = silent.get_mut(&key) {
                silent.gone_at = (!is_there).then_some(now);
            }
            inlet.token(is_there);
        } else if is_there {
            self.announce(silent, key, rows, now);
        }
    }

    fn announce(&self, silent: &mut BTreeMap<Arc<str>, Silent>, key: Arc<str>, rows: RowsKey, now: Duration) {
        if silent.len() >= MAX_SILENT {
            let most = silent.iter().max_by_key(|(_, session)| session.probes).map(|(key, _)| Arc::clone(key));
            if let Some(session) = most.and_then(|key| silent.remove(&key)) {
                self.shared.inlets.remove(&session.inlet);
            }
        }
        // A session always goes to the same worker.
        let place = key.bytes().fold(0_usize, |sum, byte| sum.wrapping_mul(31).wrapping_add(byte.into()));
        let outlets = self.outlets[place % self.outlets.len()].clone();
        let inlet = Arc::new(Inlet::new(Arc::clone(&key), self.shared.is_sealed.then_some(rows), outlets));
        self.shared.inlets.add(&inlet);
        silent.insert(key, Silent { inlet, probe_at: now + FIRST_PROBE, probes: 0, gone_at: None });
    }

    /// Asks sessions for their first record: those that wait for a recorder publish nothing.
    fn probe(&self, silent: &mut BTreeMap<Arc<str>, Silent>, now: Duration) {
        silent.retain(|_, session| {
            let is_over = session.gone_at.is_some_and(|at| now >= at + FORGET);
            if is_over {
                self.shared.inlets.remove(&session.inlet);
            }
            !is_over && session.inlet.is_silent()
        });
        // The one that has waited longest first, then by key.
        let mut due: Vec<_> = silent.values_mut().filter(|session| now >= session.probe_at).collect();
        due.sort_by_key(|session| (session.probes, session.probe_at));
        let (gone, open): (Vec<_>, Vec<_>) = due.into_iter().partition(|session| session.gone_at.is_some());
        for session in open.into_iter().take(PROBES).chain(gone.into_iter().take(GONE_PROBES)) {
            session.probes += 1;
            session.probe_at = now + (FIRST_PROBE * 2_u32.pow(session.probes.min(8))).min(LAST_PROBE);
            self.probe_one(&session.inlet);
        }
    }

    fn probe_one(&self, inlet: &Arc<Inlet>) {
        let request = StepRecordRequest { from_seq: 0, count: 1 };
        let taker = Arc::clone(inlet);
        self.send(inlet, request.encode_to_vec().into(), move |record| taker.take_reply(record));
    }

    fn ask(&self, inlet: &Arc<Inlet>, request: Bytes) {
        if let Ok(StepRecordRequest { from_seq, count }) = decode(&request, limits::MAX_CLIENT_MESSAGE) {
            inlet.expect(from_seq, count);
        }
        let end = AnswerEnd(Arc::clone(inlet));
        self.send(inlet, request, move |record| end.0.take_reply(record));
    }

    fn send(&self, inlet: &Arc<Inlet>, request: Bytes, mut take: impl FnMut(&Bytes) + Send + 'static) {
        let Some((keys, ..)) = SessionKeys::of(&inlet.key) else { return };
        let proof = inlet.seal.as_ref().map(|rows| rows.prove("rows", &request).to_vec());
        let question = Question {
            key: keys.truth_rows(),
            message: "StepRecordRequest".into(),
            payload: request,
            attachment: proof.unwrap_or_default(),
            timeout: ANSWER_TIMEOUT,
            is_urgent: false,
            reach: self.shared.reach,
        };
        let take = move |reply| {
            if let Ok(Sample { payload, .. }) = reply {
                take(&payload);
            }
        };
        if let Err(error) = self.carrier.ask(question, take) {
            warn!(key = %inlet.key, %error, "cannot ask for records");
        }
    }
}

/// Logs which servers have open sessions and announce none to recorders.
fn tell_of_unannounced(servers: &mut BTreeMap<String, Server>, now: Duration) {
    for (name, server) in servers {
        if matches!(server, Server::Unannounced(since) if now >= *since + UNANNOUNCED) {
            *server = Server::Known;
            warn!(
                "server {name} has open sessions, and this recorder sees none that is for recorders: start the server with \
                 --recorder-key, and this recorder with a config whose role may record (recorder.json5 of `fiatlux keys`, not \
                 policy.json5)"
            );
        }
    }
}

/// Tells a greeter what a worker needs.
#[derive(Clone)]
pub(super) struct ToGreeter(pub Sender<Greeting>);

impl ToGreeter {
    pub fn ask(&self, inlet: &Arc<Inlet>, request: Bytes) {
        // The greeter may be gone.
        let _ = self.0.send(Greeting::Ask(Arc::clone(inlet), request));
    }

    pub fn again(&self, key: Arc<str>) {
        let _ = self.0.send(Greeting::Again(key));
    }
}
