//! The channels of a file, and which topics its header promises.

use std::collections::BTreeMap;

use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_proto::{PROTOCOL, plain};

use crate::take::{take_text, take_u16};
use crate::topic::{self, TOPICS};

pub(crate) const MAX_CHANNELS: usize = 256;

/// The channels of a file by their ids. The first record of an id counts.
#[derive(Debug, Clone, Default)]
pub(crate) struct Channels {
    topics: BTreeMap<u16, String>,
    /// Topics that no message may have.
    refused: Vec<&'static str>,
    /// Of a later version, which may have topics that this one does not know.
    is_newer: bool,
}

impl Channels {
    /// No channel yet, of a file with this header.
    pub fn of(header: &EpisodeHeader) -> Self {
        let is_recorded = |topic: &str| {
            let mut recorded = header.sensors.iter().filter(|sensor| sensor.recorded);
            recorded.any(|sensor| topic.strip_prefix('/') == Some(&sensor.name))
        };
        Self {
            topics: BTreeMap::new(),
            refused: [topic::CAMERA, topic::LIDAR].into_iter().filter(|topic| !is_recorded(topic)).collect(),
            is_newer: header.protocol.is_some_and(|protocol| protocol.minor > PROTOCOL.minor),
        }
    }

    pub fn topic(&self, id: u16) -> Option<&str> {
        self.topics.get(&id).map(String::as_str)
    }

    /// Adds what a channel record says; `None` where it cannot be read or there are too many.
    pub fn add(&mut self, mut record: &[u8]) -> Option<()> {
        let (id, _schema) = (take_u16(&mut record)?, take_u16(&mut record)?);
        let topic = take_text(&mut record)?;
        if self.topics.len() < MAX_CHANNELS {
            self.topics.entry(id).or_insert(topic);
            return Some(());
        }
        self.topics.contains_key(&id).then_some(())
    }

    /// Takes over channels with ids that are not here.
    pub fn extend(&mut self, others: Self) {
        for (id, topic) in others.topics {
            self.topics.entry(id).or_insert(topic);
        }
    }

    /// The reason why the file cannot have a message of this channel; `None` if it can.
    pub fn refusal(&self, id: u16) -> Option<String> {
        let topic = self.topic(id)?;
        if self.refused.contains(&topic) {
            return Some(format!("it has messages on {topic}, but no sensor of its header is recorded there"));
        }
        let is_known = self.is_newer || TOPICS.iter().any(|(known, _)| *known == topic);
        (!is_known).then(|| format!("it has messages on '{}', a topic that no recorder writes", plain(topic)))
    }
}
