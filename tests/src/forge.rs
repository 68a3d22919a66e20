//! Bags and journals of a forger: taken apart, changed, sealed anew, written.

use std::path::{Path, PathBuf};

use fiatlux_access::Identity;
use fiatlux_bag::run::{Event, LedgerWriter, Registration};
use fiatlux_bag::{Bag, BagWriter, topic};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{ActionRecord, EpisodeHeader, EpisodeResult, State};
use fiatlux_wire::{header_digest, layout_of, read_identity, read_row};

/// A bag's parts that a second run is compared with.
#[derive(Debug, Clone)]
pub struct Parts {
    pub header: EpisodeHeader,
    /// Rows from row 0 on, one for each control step.
    pub states: Vec<State>,
    /// The actions between them.
    pub actions: Vec<ActionRecord>,
    /// Result as the server recorded it.
    pub result: EpisodeResult,
}

impl Parts {
    /// Of a whole bag.
    pub fn of(bag: &Path) -> Self {
        let bag = Bag::open(bag).unwrap();
        Self {
            header: bag.header().clone(),
            states: bag.states().map(Result::unwrap).collect(),
            actions: bag.actions().map(Result::unwrap).collect(),
            result: bag.result().unwrap().clone(),
        }
    }

    /// Makes all digests fit the present content.
    pub fn seal(&mut self) {
        let mut digest = read_identity(&self.header).unwrap().digest();
        self.header.digest_context = digest.hex();
        let layout = layout_of(&self.header).unwrap();
        self.states.iter().for_each(|state| digest.push(&read_row(state, layout).unwrap()));
        self.result.end.as_mut().unwrap().digest = digest.hex();
        self.result.header_digest = header_digest(&self.header);
    }

    /// Writes a bag of them.
    pub fn write(&self, path: &Path) -> PathBuf {
        let mut writer = BagWriter::create(path, &self.header).unwrap();
        for state in &self.states {
            let action = state.step.checked_sub(1).and_then(|before| self.actions.get(before as usize));
            if let Some(action) = action {
                writer.message(topic::ACTION, state.step, &action.encode_to_vec()).unwrap();
            }
            writer.message(topic::STATE, state.step, &state.encode_to_vec()).unwrap();
        }
        writer.finish(&self.result).unwrap()
    }
}

#[derive(Debug, Clone)]
pub struct JournalParts {
    pub registration: Registration,
    /// Without the server's signature.
    pub events: Vec<Event>,
}

impl JournalParts {
    /// Of a whole journal.
    pub fn of(journal: &Path) -> Self {
        let text = std::fs::read_to_string(journal).unwrap();
        let bare = |line: &str| {
            let mut members: serde_json::Value = serde_json::from_str(line).unwrap();
            members.as_object_mut().unwrap().remove("link");
            members
        };
        let mut lines = text.lines().map(bare);
        let registration = serde_json::from_value(lines.next().unwrap()).unwrap();
        let events = lines.map(|line| serde_json::from_value(line).unwrap());
        Self { registration, events: events.filter(|event| !matches!(event, Event::Sealed { .. })).collect() }
    }

    /// Leaves the last episode out, as if it had never been agreed on.
    pub fn drop_last_episode(&mut self) {
        self.registration.episodes.pop();
        self.drop_events_of(self.registration.episodes.len() as u32);
    }

    /// Leaves out what became of an episode.
    pub fn drop_events_of(&mut self, index: u32) {
        self.events.retain(|event| match event {
            Event::Opened { episode, .. }
            | Event::Played { episode, .. }
            | Event::Abandoned { episode, .. }
            | Event::Failed { episode, .. } => *episode != index,
            Event::Restarted { .. } | Event::Finished { .. } | Event::Sealed { .. } => true,
        });
    }

    /// Writes it into a folder with a chain that holds, signed by that identity where there is one.
    pub fn write(self, folder: &Path, signer: Option<&Identity>) -> PathBuf {
        let mut writer = LedgerWriter::create(folder, self.registration).unwrap();
        self.events.into_iter().for_each(|event| writer.append(event).unwrap());
        if let Some(signer) = signer {
            let sign = |link: &str| (signer.public().to_string(), fiatlux_access::sign_journal(signer, link));
            writer.seal(sign).unwrap();
        }
        writer.path().to_owned()
    }
}
