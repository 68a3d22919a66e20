//! The records of a session under verification, in order, as a recorder would write them.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use fiatlux_access::RowsKey;
use fiatlux_carrier::{Carrier, CarrierError, Declaration, Question, Reach};
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::limits::{MAX_SERVER_MESSAGE, MAX_TRUTHS_PER_REQUEST};
use fiatlux_proto::v3::{StepRecord, StepRecordRequest};
use fiatlux_proto::{Bytes, Message, decode};

/// Maximum number of records to hold back while an earlier one is missing; beyond it the missing one is requested.
const MAX_AHEAD: usize = 64;

const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

const TRIES: u32 = 4;

/// Time after the episode's end at which missing records count as lost.
const PATIENCE: Duration = Duration::from_secs(10);

/// Reads a session's records and acknowledges none: a session under verification does not wait for a recorder.
pub(super) struct Records {
    link: Carrier,
    keys: SessionKeys,
    rows: RowsKey,
    inbox: Receiver<Bytes>,
    /// Records that arrived before an earlier one, by number.
    ahead: BTreeMap<u64, StepRecord>,
    next_seq: u64,
    _subscriber: Option<Declaration>,
}

impl Records {
    /// Reads all records from the session's first one on (if it is not reset before), or only the requested ones.
    pub fn of(link: &Carrier, keys: SessionKeys, rows: RowsKey, all: bool) -> Result<Self, CarrierError> {
        let (sender, inbox) = channel();
        // The receiver may be gone.
        let receive = move |message: fiatlux_carrier::Message| drop(sender.send(message.payload));
        let subscribe = || link.subscribe(&keys.truth_row(), Reach::Everywhere, receive);
        let subscriber = all.then(subscribe).transpose()?;
        Ok(Self { link: link.clone(), keys, rows, inbox, ahead: BTreeMap::new(), next_seq: 0, _subscriber: subscriber })
    }

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

    /// Requests the record of this number; `None` if the server no longer keeps it.
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

    /// Waits for the next record; `None` if it is lost.
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
            return tracing::debug!("dropping a record of another session");
        };
        match decode::<StepRecord>(&record, MAX_SERVER_MESSAGE) {
            Ok(record) if record.seq >= self.next_seq => drop(self.ahead.insert(record.seq, record)),
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "cannot decode a record; does the server speak this version?"),
        }
    }

    /// Requests the missing records and waits for the answer.
    fn ask(&mut self, count: u64) {
        let request = StepRecordRequest { from_seq: self.next_seq, count }.encode_to_vec();
        let question = Question {
            key: self.keys.truth_rows(),
            message: "StepRecordRequest".into(),
            attachment: self.rows.prove("rows", &request).to_vec(),
            payload: request.into(),
            timeout: ANSWER_TIMEOUT,
            ..Question::default()
        };
        let Ok(replies) = self.link.ask_all(question) else { return };
        replies.flatten().for_each(|message| self.take(message.payload));
    }
}
