//! Thin bags: header, actions and result of an episode, whose rows are simulated again when they are read.
//!
//! Same build, same actions: same bytes. So the rows need not be kept, only the digest that the result has of them. A thin bag has
//! the metadata record `fiatlux.thin`, and of the topics `/action` and `/result` alone. Header and result are those of the full bag,
//! bit for bit, and with them what a signature covers: both forms are one recording, and either can be made from the other.
//!
//! The crate knows no simulator. A program that links one names it by [`simulate_with`]; from then on every reader of a bag has
//! rows, stored or simulated, by the same calls.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::{Bag, BagError, BagWriter, Completeness, Simulated, part_of, topic};

impl Bag {
    /// Simulates its actions once, whatever its form, and compares their rows with its result.
    ///
    /// # Errors
    /// [`BagError::Simulated`], [`BagError::Unable`]
    pub fn check_actions(&self) -> Result<(), BagError> {
        self.simulate(Simulated::Rows).map(drop).map_err(|reason| self.unsimulated(reason))
    }

    /// The reason for which no thin bag can be made of this one: something would be lost.
    pub fn stays_full(&self) -> Option<&'static str> {
        let request = self.header().request.as_ref();
        if *self.completeness() != Completeness::Whole {
            Some("it is cut, and an episode without its end cannot be simulated again")
        } else if self.unknown_field.is_some() {
            Some("its header has a field that this version does not know")
        } else if !self.header().meshes.is_empty() || request.is_some_and(|request| !request.weights.is_empty()) {
            Some("its sensors used a file that is not in the bag, so they cannot be simulated again")
        } else {
            None
        }
    }

    /// Writes this episode as a thin bag. The same episode gives the same bytes.
    ///
    /// # Errors
    /// It [stays full](Self::stays_full), or a file cannot be read or written.
    pub fn write_thin(&self, path: &Path) -> Result<PathBuf, BagError> {
        let refuse = |reason: &str| BagError::Form { path: self.path().into(), form: "thin", reason: reason.into() };
        if let Some(reason) = self.stays_full() {
            return Err(refuse(reason));
        }
        let result = self.result().ok_or_else(|| refuse("it has no result"))?;
        let part = part_of(path);
        let file = File::create(&part).map_err(BagError::io("make", &part))?;
        let mut writer = BagWriter::start(path, part, file, self.header(), true)?;
        let mut reader = self.reader()?;
        for chunk in self.chunks().iter().filter(|chunk| chunk.may_have(topic::ACTION, self.channels())) {
            reader.start(chunk)?;
            reader.find(|found| {
                if found.topic == topic::ACTION {
                    writer.message(topic::ACTION, found.step, found.bytes)?;
                }
                Ok(None::<()>)
            })?;
        }
        writer.finish(result)
    }

    /// Writes this episode as a full bag, simulated where this one is thin.
    ///
    /// # Errors
    /// [`BagError::Simulated`]: its rows or its result are not those of its actions, or it cannot be simulated here.
    pub fn write_full(&self, path: &Path) -> Result<(), BagError> {
        let full = self.holding(topic::OBSERVATION)?;
        fs::copy(full.path(), path).map(drop).map_err(BagError::io("write", path))
    }

    /// Refuses a new form of this bag that cannot be read as this one, before it takes its place; then it is on the disk.
    fn replaces(&self, new: &Path) -> Result<(), BagError> {
        let written = Self::open(new)?;
        if written.header() != self.header() || written.result() != self.result() {
            let form = if written.is_thin() { "thin" } else { "full" };
            let reason = "it does not read back as it was".into();
            return Err(BagError::Form { path: self.path().into(), form, reason });
        }
        let synced = File::open(new).and_then(|file| file.sync_all());
        synced.map_err(BagError::io("write", new))
    }
}

/// Brings a bag into the other form, in its place; returns false if it has that form. The file is whole in one form or the other at any
/// time.
///
/// # Errors
/// As of [`Bag::write_thin`] and [`Bag::write_full`]; the bag stays as it is.
pub fn convert(path: &Path, thin: bool) -> Result<bool, BagError> {
    let bag = Bag::open(path)?;
    if bag.is_thin() == thin {
        return Ok(false);
    }
    // Searches leave out what begins with a dot.
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = path.with_file_name(format!(".{name}.{}.new", std::process::id()));
    let done = match thin {
        true => bag.write_thin(&new).map(drop),
        false => bag.write_full(&new),
    };
    let done = done.and_then(|()| bag.replaces(&new));
    let done = done.and_then(|()| fs::rename(&new, path).map_err(BagError::io("rename", &new)));
    if done.is_err() {
        for left in [&new, &part_of(&new)] {
            let _ = fs::remove_file(left);
        }
    }
    done.map(|()| true)
}
