//! Appends to a journal.

use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::journal::{Chain, journal_of};
use super::{Event, Ledger, LedgerError, Registration};

/// The one writer of a journal; its server's lock sees to it that there is no other.
#[derive(Debug)]
pub struct LedgerWriter {
    path: PathBuf,
    file: File,
    ledger: Ledger,
    chain: Chain,
    broken: bool,
}

impl LedgerWriter {
    /// Starts the journal of a run in its folder, which is made: all of the registration is on disk, or none of it.
    ///
    /// # Errors
    /// It exists already, the registration is wrong, or the file cannot be written.
    pub fn create(folder: &Path, registration: Registration) -> Result<Self, LedgerError> {
        let path = journal_of(folder, &registration.server);
        let wrong = |reason: String| LedgerError::Event { path: path.clone(), reason };
        let (line, chain) = Chain::default().line(&registration).ok_or_else(|| wrong("the run is too large".into()))?;
        // A number that is not finite has no form in JSON.
        if Chain::default().read(line.trim_end().as_bytes()).ok().as_ref() != Some(&registration) {
            return Err(wrong("the spec does not read back as it was given; its numbers must be finite".into()));
        }
        let ledger = Ledger::new(registration).map_err(wrong)?;
        if path.exists() {
            return Err(LedgerError::Exists { path });
        }
        fs::create_dir_all(folder).map_err(LedgerError::io("make the folder", folder))?;
        let new = path.with_extension("new");
        // What a server left here that died over it.
        if new.exists() {
            fs::remove_file(&new).map_err(LedgerError::io("remove", &new))?;
        }
        let file = OpenOptions::new().append(true).create_new(true).open(&new);
        let mut file = file.map_err(LedgerError::io("make", &new))?;
        let written = file.write_all(line.as_bytes()).and_then(|()| file.sync_all());
        written.map_err(LedgerError::io("write", &new))?;
        fs::rename(&new, &path).map_err(LedgerError::io("rename", &new))?;
        sync_folder(folder)?;
        folder.parent().map_or(Ok(()), sync_folder)?;
        Ok(Self { path, file, ledger, chain, broken: false })
    }

    /// Takes up a journal; a line that was torn is removed.
    ///
    /// # Errors
    /// As for [`Ledger::read`], or it cannot be written.
    pub fn open(path: &Path) -> Result<Self, LedgerError> {
        let (ledger, chain) = Ledger::read_chain(path)?;
        let file = OpenOptions::new().append(true).open(path).map_err(LedgerError::io("open", path))?;
        file.set_len(chain.length).map_err(LedgerError::io("shorten", path))?;
        Ok(Self { path: path.into(), file, ledger, chain, broken: false })
    }

    /// The run as it stands.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Path of the journal that is written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes an event; it is on disk when this returns.
    ///
    /// # Errors
    /// It does not follow from what was before, or cannot be written; the ledger is as it was then.
    pub fn append(&mut self, event: Event) -> Result<(), LedgerError> {
        if self.broken && self.undo().is_err() {
            return Err(LedgerError::Broken { path: self.path.clone() });
        }
        self.broken = false;
        let wrong = |reason: String| LedgerError::Event { path: self.path.clone(), reason };
        let mut after = self.ledger.clone();
        after.apply(&event).map_err(wrong)?;
        let (line, chain) = self.chain.line(&event).ok_or_else(|| wrong("the event is too long".into()))?;
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data());
        if let Err(error) = written {
            self.broken = self.undo().is_err();
            return Err(LedgerError::io("write", &self.path)(error));
        }
        (self.ledger, self.chain) = (after, chain);
        Ok(())
    }

    /// Puts the server's signature under the journal of a finished run, where it has none yet. `sign` is given what the
    /// signature is of, and returns public key and signature as text.
    ///
    /// # Errors
    /// As for [`LedgerWriter::append`]; the run is not finished.
    pub fn seal(&mut self, sign: impl FnOnce(&str) -> (String, String)) -> Result<(), LedgerError> {
        if self.ledger.seal().is_some() {
            return Ok(());
        }
        let of = self.chain.link.clone();
        let (key, signature) = sign(&of);
        self.append(Event::Sealed { of, key, signature })
    }

    /// What of a line reached the file must not stand before the next one.
    fn undo(&self) -> std::io::Result<()> {
        self.file.set_len(self.chain.length)?;
        self.file.sync_data()
    }
}

/// A name is on disk when its folder is.
fn sync_folder(folder: &Path) -> Result<(), LedgerError> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(LedgerError::io("sync the folder", folder))
}
