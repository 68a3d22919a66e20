//! Submits a run's folder, or loose bags, to a leaderboard.
//!
//! What broke off goes on from where it was, also in a later call: the same files with the same manifest are the same
//! submission.

mod http;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use fiatlux_bag::run::journals;
use fiatlux_bag::{Bag, BagError, BagFiles, FindError};
use serde::Deserialize;
use serde_json::json;
use sha2::{Digest as _, Sha256};
use thiserror::Error;

use crate::store::Digest;
use crate::submission::{MAX_NAME, is_file_name};
use crate::{Manifest, ManifestError, State};
use http::{Answer, Http};

/// So often a request is tried that came to nothing, without a byte that arrived in between.
const TRIES: u32 = 8;
/// How long it waits before the second try; twice as long before each further one, up to [`MAX_PAUSE`].
const PAUSE: Duration = Duration::from_millis(500);
const MAX_PAUSE: Duration = Duration::from_secs(60);
/// How often it asks how a submission goes on.
const POLL: Duration = Duration::from_secs(2);

/// Why nothing was submitted.
#[derive(Debug, Error)]
pub enum SubmitError {
    /// The folder.
    #[error(transparent)]
    Find(#[from] FindError),
    /// A bag, or the journal of a run.
    #[error("cannot read what is to be submitted")]
    Bag(#[from] BagError),
    /// A file.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// Nothing there.
    #[error("there is no bag in {}; name the folder of a run, or of *.mcap files", path.display())]
    NoBags {
        /// The folder.
        path: PathBuf,
    },
    /// Several runs.
    #[error("{} runs are in {}; submit each by itself", runs, path.display())]
    Runs {
        /// The folder.
        path: PathBuf,
        /// How many.
        runs: usize,
    },
    /// A name that the service does not take.
    #[error("'{name}' is not a name that the service takes; use letters, digits, -, _ and . alone, {MAX_NAME} at most")]
    Name {
        /// The file's name.
        name: String,
    },
    /// The manifest.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The address of the service.
    #[error("'{url}' is not the address of a service; write https://HOST or http://HOST:PORT")]
    Url {
        /// As it was given.
        url: String,
    },
    /// No answer.
    #[error("{url} does not answer ({reason}); start again later: what has arrived stays there")]
    Unanswered {
        /// The service.
        url: String,
        /// Why, by the last try.
        reason: String,
    },
    /// It refuses a request.
    #[error("the service refuses ({code}): {message}")]
    Refused {
        /// One word.
        code: String,
        /// Its words.
        message: String,
    },
    /// It answers something else.
    #[error("{url} is not a leaderboard, or one of another version: {reason}")]
    Unreadable {
        /// The service.
        url: String,
        /// Why.
        reason: String,
    },
    /// A file changed under way.
    #[error("{} was changed while it was sent; submit again", path.display())]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// A stop was asked for.
    #[error("stopped; the same command goes on from here")]
    Stopped,
}

/// What is to be submitted.
#[derive(Debug, Clone)]
pub struct Upload {
    /// What is said of the policy.
    pub manifest: Manifest,
    files: Vec<(String, PathBuf)>,
}

impl Upload {
    /// All bags below a folder, and the journals of the run whose folder it is. The manifest has the policy's name, and where
    /// the run says so its version and link; the rest is for the caller to fill in.
    ///
    /// # Errors
    /// [`SubmitError`]: no bag, several runs, names that the service does not take.
    pub fn find(path: &Path) -> Result<Self, SubmitError> {
        let found = BagFiles::find(&[path.to_path_buf()])?;
        if found.runs.len() > 1 {
            return Err(SubmitError::Runs { path: path.into(), runs: found.runs.len() });
        }
        let first = found.bags.first().ok_or_else(|| SubmitError::NoBags { path: path.into() })?;
        let mut files = Vec::new();
        if let Some(run) = found.runs.first() {
            // Journals name bags by their file names.
            let bags = found.bags.iter().filter(|bag| bag.parent() == Some(run)).cloned();
            let journals = journals(run).map_err(|_| SubmitError::NoBags { path: run.clone() })?;
            for file in bags.chain(journals) {
                files.push((name_of(&file)?, file));
            }
        } else {
            let mut names = BTreeSet::new();
            for (index, bag) in found.bags.iter().enumerate() {
                let name = name_of(bag)?;
                let name = if names.insert(name.clone()) { name } else { format!("{index}-{name}") };
                files.push((name, bag.clone()));
            }
        }
        if let Some((name, _)) = files.iter().find(|(name, _)| !is_file_name(name)) {
            return Err(SubmitError::Name { name: name.clone() });
        }
        let bag = Bag::open(first)?;
        let ticket = bag.header().run.clone().unwrap_or_default();
        let manifest = Manifest {
            policy: bag.header().policy.clone(),
            version: ticket.policy_version,
            link: ticket.policy_link,
            ..Manifest::default()
        };
        Ok(Self { manifest, files })
    }

    /// How many files.
    pub fn files(&self) -> usize {
        self.files.len()
    }
}

fn name_of(path: &Path) -> Result<String, SubmitError> {
    let name = path.file_name().unwrap_or_default();
    name.to_str().map(str::to_owned).ok_or_else(|| SubmitError::Name { name: name.to_string_lossy().into_owned() })
}

/// How far it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubmitProgress {
    /// Files are read for their digests: bytes done, and in all.
    Reading(u64, u64),
    /// Files are sent: bytes done, and in all.
    Sending(u64, u64),
    /// The service verifies: episodes done, and in all.
    Verifying(u64, u64),
}

/// A submission as the service tells it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Submitted {
    /// Names it.
    pub id: String,
    /// How far it is.
    pub state: State,
    /// Why it was refused; else empty.
    pub reason: String,
    /// How much of it was seen to be true.
    pub badge: crate::Badge,
    /// Episodes that were verified.
    pub episodes_verified: u64,
    /// Episodes that are to be.
    pub episodes_to_verify: u64,
    #[serde(default)]
    files: Vec<Place>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct Place {
    place: u64,
    name: String,
    bytes: u64,
    received: u64,
    stored: bool,
}

/// A client of one service, with the token of one account.
pub struct Submit<'a> {
    http: Http,
    progress: &'a mut dyn FnMut(SubmitProgress),
    stop: &'a AtomicBool,
}

impl<'a> Submit<'a> {
    /// To the service at an address such as `https://HOST`.
    ///
    /// # Errors
    /// [`SubmitError::Url`].
    pub fn to(
        url: &str,
        token: &str,
        progress: &'a mut dyn FnMut(SubmitProgress),
        stop: &'a AtomicBool,
    ) -> Result<Self, SubmitError> {
        Ok(Self { http: Http::new(url, token)?, progress, stop })
    }

    /// Sends everything that the service does not have yet. From then on the submission is accepted.
    ///
    /// # Errors
    /// [`SubmitError`].
    pub fn send(&mut self, upload: &Upload) -> Result<Submitted, SubmitError> {
        upload.manifest.check()?;
        let (paths, wish) = self.announce(upload)?;
        let mut submitted = self.ask("POST", "/api/v1/submissions", Some(wish.to_string()))?;
        if submitted.state != State::Uploading {
            return Ok(submitted);
        }
        let whole = submitted.files.iter().map(|file| file.bytes).sum();
        let mut done = 0;
        for file in std::mem::take(&mut submitted.files) {
            let path = paths.get(&file.name).ok_or_else(|| self.http.unreadable("it names a file of no such name"))?;
            if !file.stored {
                self.file(&submitted.id, &file, path, done, whole)?;
            }
            done += file.bytes;
            (self.progress)(SubmitProgress::Sending(done, whole));
        }
        let finish = format!("/api/v1/submissions/{}/finish", submitted.id);
        self.ask("POST", &finish, None)
    }

    /// Waits until a submission is decided.
    ///
    /// # Errors
    /// [`SubmitError`].
    pub fn wait(&mut self, id: &str) -> Result<Submitted, SubmitError> {
        loop {
            let submitted = self.ask("GET", &format!("/api/v1/submissions/{id}"), None)?;
            if matches!(submitted.state, State::Verified | State::Refused) {
                return Ok(submitted);
            }
            let Submitted { episodes_verified, episodes_to_verify, .. } = submitted;
            (self.progress)(SubmitProgress::Verifying(episodes_verified, episodes_to_verify));
            self.pause(POLL)?;
        }
    }

    /// The files by name, and what is said of them before they are sent.
    fn announce(&mut self, upload: &Upload) -> Result<(BTreeMap<String, PathBuf>, serde_json::Value), SubmitError> {
        let mut sizes = Vec::new();
        for (_, path) in &upload.files {
            let data = path.metadata().map_err(|source| SubmitError::Read { path: path.clone(), source })?;
            sizes.push(data.len());
        }
        let whole = sizes.iter().sum();
        let (mut done, mut files, mut paths) = (0, Vec::new(), BTreeMap::new());
        for (name, path) in &upload.files {
            let read = |source| SubmitError::Read { path: path.clone(), source };
            let mut file = File::open(path).map_err(read)?;
            let (mut sum, mut bytes, mut block) = (Sha256::new(), 0, vec![0; 1 << 20]);
            loop {
                if self.stop.load(Ordering::Relaxed) {
                    return Err(SubmitError::Stopped);
                }
                let length = file.read(&mut block).map_err(read)?;
                if length == 0 {
                    break;
                }
                sum.update(&block[..length]);
                bytes += length as u64;
                done += length as u64;
                (self.progress)(SubmitProgress::Reading(done, whole));
            }
            files.push(json!({ "name": name, "bytes": bytes, "sha256": Digest::from(sum).as_str() }));
            paths.insert(name.clone(), path.clone());
        }
        Ok((paths, json!({ "manifest": upload.manifest, "files": files })))
    }

    /// Sends what is missing of a file; asks how much is there whenever it breaks off.
    fn file(&mut self, id: &str, file: &Place, path: &Path, done: u64, whole: u64) -> Result<(), SubmitError> {
        let read = |source| SubmitError::Read { path: path.into(), source };
        let (mut received, mut tries) = (file.received, Tries::default());
        loop {
            let mut source = File::open(path).map_err(read)?;
            source.seek(SeekFrom::Start(received)).map_err(read)?;
            let address = format!("/api/v1/submissions/{id}/files/{}?offset={received}", file.place);
            let (progress, stop) = (&mut *self.progress, self.stop);
            let mut sent = received;
            let mut on_bytes = |bytes| {
                sent += bytes;
                progress(SubmitProgress::Sending(done + sent, whole));
                !stop.load(Ordering::Relaxed)
            };
            let answer = self.http.put(&address, source, file.bytes - received, &mut on_bytes);
            if self.stop.load(Ordering::Relaxed) {
                return Err(SubmitError::Stopped);
            }
            let reason = match answer {
                Ok(Answer { status: 200, json }) if json["stored"] == true => return Ok(()),
                Ok(Answer { status: 422, .. }) => return Err(SubmitError::Changed { path: path.into() }),
                Ok(answer @ Answer { status: 400..=407 | 410..=499, .. }) => return Err(answer.refused()),
                // 408 too slow, 409 another offset or a connection that has not ended yet, 5xx.
                Ok(answer) => answer.refused().to_string(),
                Err(reason) => reason,
            };
            self.pause(tries.again(&self.http, reason)?)?;
            let submitted = self.ask("GET", &format!("/api/v1/submissions/{id}"), None)?;
            let there = submitted.files.iter().find(|there| there.place == file.place);
            let there = there.ok_or_else(|| self.http.unreadable("it takes no files any more"))?;
            if there.stored {
                return Ok(());
            }
            if there.received > received {
                tries = Tries::default();
            }
            received = there.received.min(file.bytes);
        }
    }

    /// A request without a file, tried again while nobody answers.
    fn ask(&mut self, method: &str, address: &str, body: Option<String>) -> Result<Submitted, SubmitError> {
        let mut tries = Tries::default();
        loop {
            let reason = match self.http.ask(method, address, body.as_deref()) {
                Ok(Answer { status: 200..=299, json }) => {
                    return serde_json::from_value(json).map_err(|error| self.http.unreadable(&error.to_string()));
                }
                Ok(answer @ Answer { status: 400..=499, .. }) => return Err(answer.refused()),
                Ok(answer) => answer.refused().to_string(),
                Err(reason) => reason,
            };
            self.pause(tries.again(&self.http, reason)?)?;
        }
    }

    fn pause(&self, time: Duration) -> Result<(), SubmitError> {
        let start = std::time::Instant::now();
        while start.elapsed() < time {
            if self.stop.load(Ordering::Relaxed) {
                return Err(SubmitError::Stopped);
            }
            std::thread::sleep(Duration::from_millis(50).min(time));
        }
        Ok(())
    }
}

/// How often a request came to nothing.
#[derive(Debug, Default)]
struct Tries(u32);

impl Tries {
    /// Counts one more, and says how long to wait before the next one.
    fn again(&mut self, http: &Http, reason: String) -> Result<Duration, SubmitError> {
        self.0 += 1;
        if self.0 > TRIES {
            return Err(http.unanswered(reason));
        }
        Ok((PAUSE * 2_u32.saturating_pow(self.0 - 1)).min(MAX_PAUSE))
    }
}

impl std::fmt::Debug for Submit<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Submit").field("http", &self.http).finish_non_exhaustive()
    }
}
