//! The records of a session that is verified, in order: what a recorder would write.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::limits::{MAX_SERVER_MESSAGE, MAX_TRUTHS_PER_REQUEST};
use fiatlux_proto::v3::{StepRecord, StepRecordRequest};
use fiatlux_proto::{Bytes, Message, decode, encoding};
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::{Session, Wait};

/// Records that came before an earlier one; with more of them that one is asked for.
const MAX_AHEAD: usize = 64;

/// An answer takes no longer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// Records that have not come this long after the episode's end are lost.
const PATIENCE: Duration = Duration::from_secs(10);

/// Follows a session's records. It acknowledges nothing: a session that is verified does not wait for a recorder.
pub(super) struct Records {
    link: Session,
    keys: SessionKeys,
    inbox: Receiver<Bytes>,
    /// By their number.
    ahead: BTreeMap<u64, StepRecord>,
    next_seq: u64,
    _subscriber: Subscriber<()>,
}

impl Records {
    /// From the session's first record on, if it is not reset before.
    pub fn follow(link: &Session, keys: SessionKeys) -> Result<Self, zenoh::Error> {
        let (sender, inbox) = channel();
        let receive = move |sample: zenoh::sample::Sample| {
            // Whoever followed may be gone.
            let _ = sender.send(sample.payload().to_bytes().into_owned().into());
        };
        let subscriber = link.declare_subscriber(keys.truth_row()).callback(receive).wait()?;
        Ok(Self { link: link.clone(), keys, inbox, ahead: BTreeMap::new(), next_seq: 0, _subscriber: subscriber })
    }

    /// The next record, where it has come.
    pub fn next(&mut self) -> Option<StepRecord> {
        while let Ok(bytes) = self.inbox.try_recv() {
            self.take(bytes);
        }
        if self.ahead.len() > MAX_AHEAD && !self.ahead.contains_key(&self.next_seq) {
            self.ask();
        }
        let record = self.ahead.remove(&self.next_seq)?;
        self.next_seq += 1;
        Some(record)
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
                Err(_) => self.ask(),
            }
        }
    }

    fn take(&mut self, bytes: Bytes) {
        match decode::<StepRecord>(&bytes, MAX_SERVER_MESSAGE) {
            Ok(record) if record.seq >= self.next_seq => drop(self.ahead.insert(record.seq, record)),
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "a record is dropped; does the server speak this version?"),
        }
    }

    /// Asks for what is missing, and waits for the answer.
    fn ask(&mut self) {
        let request = StepRecordRequest { from_seq: self.next_seq, count: MAX_TRUTHS_PER_REQUEST };
        let asked = self.link.get(self.keys.truth_rows()).payload(request.encode_to_vec());
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
