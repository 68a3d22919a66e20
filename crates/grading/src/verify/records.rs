//! The records of a session that is verified, in order: what a recorder would write.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use fiatlux_access::RowsKey;
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::limits::{MAX_SERVER_MESSAGE, MAX_TRUTHS_PER_REQUEST};
use fiatlux_proto::v3::{StepRecord, StepRecordRequest};
use fiatlux_proto::{Bytes, Message, decode, encoding};
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::{Session, Wait};

/// Records that came before an earlier one; with more of them that one is asked for.
const MAX_AHEAD: usize = 64;

/// An answer takes no longer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// A record is asked for so often.
const TRIES: u32 = 4;

/// Records that have not come this long after the episode's end are lost.
const PATIENCE: Duration = Duration::from_secs(10);

/// A session's records. It acknowledges nothing: a session that is verified does not wait for a recorder.
pub(super) struct Records {
    link: Session,
    keys: SessionKeys,
    rows: RowsKey,
    inbox: Receiver<Bytes>,
    /// By their number.
    ahead: BTreeMap<u64, StepRecord>,
    next_seq: u64,
    _subscriber: Option<Subscriber<()>>,
}

impl Records {
    /// All from the session's first one on, if it is not reset before, or those alone that are asked for.
    pub fn of(link: &Session, keys: SessionKeys, rows: RowsKey, all: bool) -> Result<Self, zenoh::Error> {
        let (sender, inbox) = channel();
        let receive = move |sample: zenoh::sample::Sample| {
            // Whoever followed may be gone.
            let _ = sender.send(sample.payload().to_bytes().into_owned().into());
        };
        let subscribe = || link.declare_subscriber(keys.truth_row()).callback(receive).wait();
        let subscriber = all.then(subscribe).transpose()?;
        Ok(Self { link: link.clone(), keys, rows, inbox, ahead: BTreeMap::new(), next_seq: 0, _subscriber: subscriber })
    }

    /// The next record, where it has come.
    pub fn next(&mut self) -> Option<StepRecord> {
        while let Ok(bytes) = self.inbox.try_recv() {
            self.take(bytes);
        }
        if self.ahead.len() > MAX_AHEAD && !self.ahead.contains_key(&self.next_seq) {
            self.ask(MAX_TRUTHS_PER_REQUEST);
        }
        let record = self.ahead.remove(&self.next_seq)?;
        self.next_seq += 1;
        Some(record)
    }

    /// The record of that number, asked for; `None` where the server does not keep it any more.
    pub fn get(&mut self, seq: u64) -> Option<StepRecord> {
        self.next_seq = seq;
        for _ in 0..TRIES {
            self.ask(1);
            if let Some(record) = self.next() {
                return Some(record);
            }
        }
        None
    }

    /// The next record, waited for; `None` where it is lost.
    pub fn wait(&mut self) -> Option<StepRecord> {
        let start = Instant::now();
        loop {
            if let Some(record) = self.next() {
                return Some(record);
            }
            match self.inbox.recv_timeout(Duration::from_millis(200)) {
                Ok(bytes) => self.take(bytes),
                Err(_) if start.elapsed() > PATIENCE => return None,
                Err(_) => self.ask(MAX_TRUTHS_PER_REQUEST),
            }
        }
    }

    fn take(&mut self, bytes: Bytes) {
        let Some(record) = self.rows.open(&bytes) else {
            return tracing::debug!("a record that is not of this session is dropped");
        };
        match decode::<StepRecord>(&record, MAX_SERVER_MESSAGE) {
            Ok(record) if record.seq >= self.next_seq => drop(self.ahead.insert(record.seq, record)),
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "a record is dropped; does the server speak this version?"),
        }
    }

    /// Asks for what is missing, and waits for the answer.
    fn ask(&mut self, count: u64) {
        let request = StepRecordRequest { from_seq: self.next_seq, count }.encode_to_vec();
        let proof = self.rows.prove("rows", &request).to_vec();
        let asked = self.link.get(self.keys.truth_rows()).payload(request).attachment(proof).target(QueryTarget::All);
        let asked = asked.encoding(encoding("StepRecordRequest")).consolidation(ConsolidationMode::None);
        let Ok(replies) = asked.timeout(ANSWER_TIMEOUT).wait() else { return };
        while let Ok(reply) = replies.recv() {
            if let Some(bytes) = payload(&reply) {
                self.take(bytes);
            }
        }
    }
}

fn payload(reply: &Reply) -> Option<Bytes> {
    reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned().into())
}
