use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::journal::{Chain, journal_of};
use super::{Event, Ledger, LedgerError, Registration};

/// The only writer of a journal; its server's lock keeps out others.
#[derive(Debug)]
pub struct LedgerWriter {
    path: PathBuf,
    file: File,
    ledger: Ledger,
    chain: Chain,
    broken: bool,
}

impl LedgerWriter {
    /// Starts the journal of a run, and makes its folder. The registration is on disk completely or not at all.
    pub fn create(folder: &Path, registration: Registration) -> Result<Self, LedgerError> {
        let path = journal_of(folder, &registration.server);
        let wrong = |reason: String| LedgerError::Event { path: path.clone(), reason };
        let (line, chain) = Chain::default().line(&registration).ok_or_else(|| wrong("the run is too large".into()))?;
        // A number that is not finite has no form in JSON.
        if Chain::default().read(line.trim_end().as_bytes()).ok().as_ref() != Some(&registration) {
            return Err(wrong("the spec does not read back as it was given; make its numbers finite".into()));
        }
        let ledger = Ledger::new(registration).map_err(wrong)?;
        if path.exists() {
            return Err(LedgerError::Exists { path });
        }
        fs::create_dir_all(folder).map_err(LedgerError::io("make the folder", folder))?;
        let new = path.with_extension("new");
        // Left by a server that died while it started this journal.
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

    /// Opens a journal to continue it, and removes a partial last line.
    pub fn open(path: &Path) -> Result<Self, LedgerError> {
        let (ledger, chain) = Ledger::read_chain(path)?;
        let file = OpenOptions::new().append(true).open(path).map_err(LedgerError::io("open", path))?;
        file.set_len(chain.length).map_err(LedgerError::io("shorten", path))?;
        Ok(Self { path: path.into(), file, ledger, chain, broken: false })
    }

    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends an event; it is on disk when this returns.
    ///
    /// # Errors
    /// It contradicts the events before it, or cannot be written; the ledger is unchanged then.
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

    /// Adds the server's signature to the journal of a finished run that has none yet. `sign` gets the text to sign,
    /// and returns public key and signature as text.
    pub fn seal(&mut self, sign: impl FnOnce(&str) -> (String, String)) -> Result<(), LedgerError> {
        if self.ledger.seal().is_some() {
            return Ok(());
        }
        let of = self.chain.link.clone();
        let (key, signature) = sign(&of);
        self.append(Event::Sealed { of, key, signature })
    }

    /// Removes a partly written line before the next one.
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
