//! Bags of a forger: taken apart, changed, sealed anew, written.

use std::path::{Path, PathBuf};

use fiatlux_bag::{Bag, BagWriter, topic};
use fiatlux_proto::Message;
use fiatlux_proto::v3::{ActionRecord, EpisodeHeader, EpisodeResult, State};
use fiatlux_wire::{header_digest, layout_of, read_identity, read_row};

/// A bag's parts that a second run is compared with.
#[derive(Debug, Clone)]
pub struct Parts {
    /// What was set when it began.
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

    /// Makes all digests fit what is there.
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
