//! Keeps the records that no recorder has on disk yet.

use std::collections::VecDeque;

use fiatlux_proto::limits::{MAX_TRUTHS_PER_REQUEST, RECORDING_WINDOW, RECORDING_WINDOW_BYTES};
use fiatlux_proto::v3::{StepRecord, StepRecordAck, StepRecordRequest};
use fiatlux_proto::{Bytes, encode};

/// Numbers records and keeps those that are not acknowledged.
#[derive(Debug, Default)]
pub(super) struct RecordWindow {
    records: VecDeque<Bytes>,
    first: u64,
    /// Size of all kept records, bytes.
    bytes: usize,
}

impl RecordWindow {
    pub fn next_seq(&self) -> u64 {
        self.first + self.records.len() as u64
    }

    /// Numbers a record and keeps it. If `slide`, a full window drops its oldest record.
    pub fn push(&mut self, record: &mut StepRecord, slide: bool) -> Bytes {
        record.seq = self.next_seq();
        let bytes = Bytes::from(encode(record));
        while slide && self.is_full() {
            self.drop_first();
        }
        self.bytes += bytes.len();
        self.records.push_back(bytes.clone());
        bytes
    }

    pub fn is_full(&self) -> bool {
        self.records.len() as u64 >= RECORDING_WINDOW || self.bytes >= RECORDING_WINDOW_BYTES
    }

    fn drop_first(&mut self) {
        if let Some(first) = self.records.pop_front() {
            self.first += 1;
            self.bytes -= first.len();
        }
    }

    /// True if every record is acknowledged.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Drops the records that a recorder has on disk, and returns their number. An acknowledgement of records that do not exist
    /// yet frees nothing.
    pub fn acknowledge(&mut self, ack: &StepRecordAck) -> usize {
        if ack.next_seq > self.next_seq() {
            return 0;
        }
        let freed = ack.next_seq.saturating_sub(self.first).min(self.records.len() as u64) as usize;
        (0..freed).for_each(|_| self.drop_first());
        freed
    }

    /// The records of a request, from the first one that is still kept.
    pub fn get(&self, request: &StepRecordRequest) -> Vec<Bytes> {
        let skipped = request.from_seq.saturating_sub(self.first).min(self.records.len() as u64);
        let count = request.count.min(MAX_TRUTHS_PER_REQUEST);
        self.records.iter().skip(skipped as usize).take(count as usize).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use fiatlux_proto::Message;

    use super::*;

    fn seqs(records: &[Bytes]) -> Vec<u64> {
        records.iter().map(|bytes| StepRecord::decode(bytes.clone()).expect("a record").seq).collect()
    }

    #[test]
    fn records_are_kept_until_acknowledged() {
        let mut window = RecordWindow::default();
        for _ in 0..10 {
            window.push(&mut StepRecord::default(), false);
        }
        let ack = |next_seq| StepRecordAck { next_seq, ..StepRecordAck::default() };
        assert_eq!(window.acknowledge(&ack(11)), 0, "what does not exist is not on disk");
        assert_eq!((window.acknowledge(&ack(4)), window.acknowledge(&ack(2))), (4, 0));
        let get = |from_seq, count| seqs(&window.get(&StepRecordRequest { from_seq, count }));
        assert_eq!(get(5, 3), [5, 6, 7]);
        assert_eq!(get(2, 3), [4, 5, 6], "2 and 3 are gone");
        assert_eq!(get(9, u64::MAX), [9]);
        assert!(get(10, 5).is_empty() && get(u64::MAX, u64::MAX).is_empty() && get(0, 0).is_empty());
        assert_eq!(window.acknowledge(&ack(10)), 6);
        assert!(window.is_empty() && window.next_seq() == 10);
    }

    #[test]
    fn a_full_window_slides_or_grows() {
        let mut window = RecordWindow::default();
        for _ in 0..RECORDING_WINDOW {
            assert!(!window.is_full());
            window.push(&mut StepRecord::default(), true);
        }
        assert!(window.is_full());
        window.push(&mut StepRecord::default(), true);
        let oldest = |window: &RecordWindow| seqs(&window.get(&StepRecordRequest { from_seq: 0, count: 1 }));
        assert_eq!(oldest(&window), [1]);
        window.push(&mut StepRecord::default(), false);
        assert_eq!(oldest(&window), [1]);
        assert_eq!(
            window.get(&StepRecordRequest { from_seq: 1, count: u64::MAX }).len() as u64,
            MAX_TRUTHS_PER_REQUEST
        );
    }
}
