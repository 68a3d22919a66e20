//! All that was heard from a robot and said to it, as a file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::records::MessageHeader;
use thiserror::Error;

use crate::cdr::Message;

/// Why the file cannot be written.
#[derive(Debug, Error)]
#[error("cannot record to {}: {reason}", path.display())]
pub struct RecordError {
    path: PathBuf,
    reason: String,
}

/// An MCAP file with samples as they are on the wire.
pub struct Record {
    writer: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<&'static str, (u16, u32)>,
    path: PathBuf,
}

impl Record {
    /// Begins a new file; one that is there already is kept.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn create(path: &Path) -> Result<Self, RecordError> {
        let failed = |reason: String| RecordError { path: path.into(), reason };
        let file = File::create_new(path).map_err(|error| failed(error.to_string()))?;
        let writer = mcap::Writer::new(BufWriter::new(file)).map_err(|error| failed(error.to_string()))?;
        Ok(Self { writer, channels: BTreeMap::new(), path: path.into() })
    }

    fn failed(&self, error: &mcap::McapError) -> RecordError {
        RecordError { path: self.path.clone(), reason: error.to_string() }
    }

    /// Adds a message, at a time since the beginning.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn add<M: Message>(&mut self, topic: &'static str, message: &M, at: Duration) -> Result<(), RecordError> {
        let (channel_id, sequence) = match self.channels.get(topic) {
            Some(channel) => *channel,
            None => {
                let schema = self.writer.add_schema(M::TYPE, "", &[]);
                let schema = schema.map_err(|error| self.failed(&error))?;
                let added = self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new());
                (added.map_err(|error| self.failed(&error))?, 0)
            }
        };
        self.channels.insert(topic, (channel_id, sequence.wrapping_add(1)));
        let log_time = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, &message.to_cdr()).map_err(|error| self.failed(&error))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn finish(mut self) -> Result<(), RecordError> {
        self.writer.finish().map(drop).map_err(|error| self.failed(&error))
    }
}
