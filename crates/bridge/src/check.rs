//! Compares a mapping with a model server, and names every difference before anything moves.

use std::fmt;

use crate::{BridgeError, Contract, Mapping, Mismatch, MismatchKind, ModelChunk};

/// All differences, so that one error names them all.
struct Mismatches(Vec<Mismatch>);

impl Mismatches {
    fn add(&mut self, kind: MismatchKind, key: &str, server: impl fmt::Display, mapping: impl fmt::Display) {
        let (server, mapping) = (shown(&server.to_string()), shown(&mapping.to_string()));
        self.0.push(Mismatch { kind, key: shown(key), server, mapping });
    }

    fn end(self, mapping: &Mapping) -> Result<(), BridgeError> {
        if self.0.is_empty() {
            return Ok(());
        }
        Err(BridgeError::Contract { mapping: mapping.name.clone(), mismatches: self.0 })
    }
}

/// Text from the server, shortened to 120 characters.
fn shown(text: &str) -> String {
    text.chars().take(120).collect()
}

const NOTHING: &str = "nothing";

/// Compares a mapping with the contract that a server announces.
pub fn check_contract(mapping: &Mapping, contract: &Contract) -> Result<(), BridgeError> {
    let mut found = Mismatches(Vec::new());
    cameras(mapping, contract, &mut found);
    if let Some(states) = &contract.states {
        for (key, width) in states {
            match mapping.states.iter().find(|ours| ours.key == *key) {
                None => found.add(MismatchKind::State, key, "it", NOTHING),
                Some(ours) => {
                    let ours = mapping.width(ours);
                    if let Some(width) = width.filter(|width| *width != ours) {
                        found.add(MismatchKind::Dimension, key, width, ours);
                    }
                }
            }
        }
        for ours in mapping.states.iter().filter(|ours| !states.iter().any(|(key, _)| *key == ours.key)) {
            found.add(MismatchKind::State, &ours.key, NOTHING, "it");
        }
    }
    if let Some(frames) = contract.state_frames.filter(|frames| *frames != 1) {
        found.add(MismatchKind::Frames, "state", format!("{frames} frames"), "1");
    }
    if let Some(actions) = &contract.actions {
        for terms in actions {
            // The server has a single key without a name.
            let ours = if terms.key.is_empty() { mapping.actions.first() } else { None };
            match ours.or_else(|| mapping.actions.iter().find(|ours| ours.key == terms.key)) {
                None => found.add(MismatchKind::Action, &terms.key, "it", "nothing; map it, or skip its numbers"),
                Some(ours) => {
                    let width = mapping.width(ours);
                    if let Some(theirs) = terms.width.filter(|theirs| *theirs != width) {
                        found.add(MismatchKind::Dimension, &ours.key, theirs, width);
                    }
                    if let Some(theirs) = terms.representation.filter(|theirs| *theirs != ours.declared) {
                        found.add(MismatchKind::Representation, &ours.key, theirs.name(), ours.declared.name());
                    }
                }
            }
        }
        let is_unnamed = actions.iter().any(|terms| terms.key.is_empty());
        let missing = |key: &str| !is_unnamed && !actions.iter().any(|terms| terms.key == key);
        for ours in mapping.actions.iter().filter(|ours| missing(&ours.key)) {
            found.add(MismatchKind::Action, &ours.key, NOTHING, "it");
        }
    }
    if let Some(horizon) = contract.horizon.filter(|horizon| *horizon != mapping.horizon) {
        found.add(MismatchKind::Horizon, "", format!("{horizon} rows"), mapping.horizon);
    }
    if let Some(keys) = &contract.language
        && !keys.is_empty()
        && !keys.contains(&mapping.language)
    {
        found.add(MismatchKind::Language, &mapping.language, format!("'{}'", keys.join("', '")), "it");
    }
    let space = contract.action_space.as_deref().unwrap_or_default();
    if !space.is_empty() && !mapping.action_space.is_empty() && space != mapping.action_space {
        found.add(MismatchKind::Representation, "action_space", space, &mapping.action_space);
    }
    found.end(mapping)
}

fn cameras(mapping: &Mapping, contract: &Contract, found: &mut Mismatches) {
    for terms in contract.cameras.iter().flatten() {
        let Some(ours) = mapping.cameras.iter().find(|ours| ours.key == terms.key) else {
            found.add(MismatchKind::Camera, &terms.key, "it", NOTHING);
            continue;
        };
        if let Some(size) = terms.size.filter(|size| *size != ours.size) {
            found.add(MismatchKind::Size, &terms.key, format!("{size:?}"), format!("{:?}", ours.size));
        }
        if let Some(delta) = terms.delta.as_ref().filter(|delta| **delta != ours.delta) {
            found.add(MismatchKind::Frames, &terms.key, format!("{delta:?}"), format!("{:?}", ours.delta));
        }
    }
    if let Some(cameras) = &contract.cameras {
        let missing = |key: &str| !cameras.iter().any(|terms| terms.key == key);
        for ours in mapping.cameras.iter().filter(|ours| missing(&ours.key)) {
            found.add(MismatchKind::Camera, &ours.key, NOTHING, "it");
        }
    }
    if let Some(count) = contract.camera_count.filter(|count| *count != mapping.cameras.len()) {
        found.add(MismatchKind::Camera, "", format!("{count} cameras"), mapping.cameras.len());
    }
    if let Some(size) = contract.image_size {
        for ours in mapping.cameras.iter().filter(|ours| ours.size != size) {
            found.add(MismatchKind::Size, &ours.key, format!("{size:?}"), format!("{:?}", ours.size));
        }
    }
}

/// Compares a mapping with a server's answer, which shows what its contract leaves out.
pub fn check_chunk(mapping: &Mapping, chunk: &ModelChunk) -> Result<(), BridgeError> {
    let mut found = Mismatches(Vec::new());
    for ours in &mapping.actions {
        match chunk.parts.iter().find(|(key, ..)| *key == ours.key) {
            None => found.add(MismatchKind::Action, &ours.key, NOTHING, "it"),
            Some((_, width, _)) if *width != mapping.width(ours) => {
                found.add(MismatchKind::Dimension, &ours.key, width, mapping.width(ours));
            }
            Some(_) => {}
        }
    }
    for (key, ..) in &chunk.parts {
        if !mapping.actions.iter().any(|ours| ours.key == *key) {
            found.add(MismatchKind::Action, key, "it", "nothing; map it, or skip its numbers");
        }
    }
    if chunk.rows != mapping.horizon {
        found.add(MismatchKind::Horizon, "", format!("{} rows", chunk.rows), mapping.horizon);
    }
    found.end(mapping)
}
