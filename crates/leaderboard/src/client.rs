//! Submits a run's folder, or loose bags, to a leaderboard.
//!
//! An interrupted upload resumes where it stopped, even in a later call: the same files with the same manifest are the same
//! submission.

mod http;

use std::collections::{BTreeMap, BTreeSet};
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
use crate::{Manifest, ManifestError, Stage};
use http::{Answer, Http};

/// Number of tries of a failed request while no byte gets through.
const TRIES: u32 = 8;
/// Pause before the second try; it doubles with each further one, up to [`MAX_PAUSE`].
const PAUSE: Duration = Duration::from_millis(500);
const MAX_PAUSE: Duration = Duration::from_secs(60);
/// Pause between two requests for the state of a submission.
const POLL: Duration = Duration::from_secs(2);

#[derive(Debug, Error)]
pub enum SubmitError {
    #[error(transparent)]
    Find(#[from] FindError),
    #[error("cannot read the bags to submit")]
    Bag(#[from] BagError),
    #[error("cannot read {}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("there is no bag in {}; name the folder of a run, or of *.mcap files", path.display())]
    NoBags { path: PathBuf },
    #[error("{} holds {runs} runs; submit each of them separately", path.display())]
    Runs { path: PathBuf, runs: usize },
    #[error(
        "the service does not accept a file named '{name}'; use only letters, digits, -, _ and ., {MAX_NAME} at most"
    )]
    Name { name: String },
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error(
        "'{url}' is not the address of a service; write https://HOST or http://HOST:PORT, with a path where it has one"
    )]
    Url { url: String },
    #[error("{url} does not answer ({reason}); start again later: the service keeps what has arrived")]
    Unanswered { url: String, reason: String },
    #[error("the service refuses the request ({code}): {message}")]
    Refused {
        /// One word such as `token`; the HTTP status if the service gives none.
        code: String,
        message: String,
    },
    #[error("{url} is not a leaderboard, or runs another version: {reason}")]
    Unreadable { url: String, reason: String },
    #[error("{} was changed while it was sent; submit again", path.display())]
    Changed { path: PathBuf },
    #[error("stopped; run the same command again to resume")]
    Stopped,
}

#[derive(Debug, Clone)]
pub struct Upload {
    /// The submitter's description of the policy; fill it in before [`Submit::send`].
    pub manifest: Manifest,
    files: Vec<(String, PathBuf)>,
}

impl Upload {
    /// All bags below a folder and, if it is the folder of a run, its journals. The manifest gets the policy's name
    /// and, if the run has them, its version and link; the caller fills in the rest.
    ///
    /// # Errors
    /// [`SubmitError`]: no bag, several runs, names that the service does not accept.
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

    /// Puts thin copies, in a folder, in the place of full bags; what [stays full](Bag::stays_full) is left. The same bag gives the same copy, so that an
    /// interrupted upload can be resumed. `progress` receives the bags done and the bags in all.
    ///
    /// # Errors
    /// [`SubmitError::Bag`]: a bag cannot be read, or a copy not written.
    pub fn make_thin(&mut self, folder: &Path, progress: &mut dyn FnMut(usize, usize)) -> Result<(), SubmitError> {
        let all = self.files.len();
        for (index, (name, path)) in self.files.iter_mut().enumerate() {
            progress(index, all);
            if Path::new(name).extension().is_none_or(|extension| extension != "mcap") {
                continue;
            }
            let bag = Bag::open(&path)?;
            if !bag.is_thin() && bag.stays_full().is_none() {
                *path = bag.write_thin(&folder.join(name))?;
            }
        }
        Ok(())
    }

    /// Number of files to send, bags and journals together.
    pub fn files(&self) -> usize {
        self.files.len()
    }
}

fn name_of(path: &Path) -> Result<String, SubmitError> {
    let name = path.file_name().unwrap_or_default();
    name.to_str().map(str::to_owned).ok_or_else(|| SubmitError::Name { name: name.to_string_lossy().into_owned() })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubmitProgress {
    /// Digests of the files are being computed: bytes done, bytes in total.
    Reading(u64, u64),
    /// Files are being sent: bytes done, bytes in total.
    Sending(u64, u64),
    /// The service is grading what it has received.
    Grading,
    /// The service is verifying: episodes done, episodes in total.
    Verifying(u64, u64),
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Submitted {
    /// 16 hexadecimal digits.
    pub id: String,
    pub state: Stage,
    /// The reason of a refusal; else empty.
    pub reason: String,
    pub badge: crate::Badge,
    /// Why it is not ranked among all twelve subtasks; empty if it is.
    #[serde(default)]
    pub not_ranked: String,
    /// Subtasks in which it is ranked.
    #[serde(default)]
    pub ranked_tasks: Vec<String>,
    pub episodes_verified: u64,
    /// Total; 0 until the submission is graded.
    pub episodes_to_verify: u64,
    #[serde(default)]
    files: Vec<FileStatus>,
}

impl Submitted {
    /// Grading until the service names the number of episodes to verify, then the verified of them.
    fn progress(&self) -> SubmitProgress {
        match self.state {
            Stage::Uploading | Stage::Received => SubmitProgress::Grading,
            _ => SubmitProgress::Verifying(self.episodes_verified, self.episodes_to_verify),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct FileStatus {
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
    /// A client of the service at `url`, such as `https://HOST`. Setting `stop` ends its work with
    /// [`SubmitError::Stopped`].
    pub fn to(
        url: &str,
        token: &str,
        progress: &'a mut dyn FnMut(SubmitProgress),
        stop: &'a AtomicBool,
    ) -> Result<Self, SubmitError> {
        Ok(Self { http: Http::new(url, token)?, progress, stop })
    }

    /// Sends all files that the service does not have yet. When this returns, the service has accepted the submission.
    pub fn send(&mut self, upload: &Upload) -> Result<Submitted, SubmitError> {
        upload.manifest.check()?;
        let (paths, wish) = self.announce(upload)?;
        let mut submitted = self.ask("POST", "/api/v1/submissions", Some(wish.to_string()))?;
        if submitted.state != Stage::Uploading {
            return Ok(submitted);
        }
        let whole = submitted.files.iter().map(|file| file.bytes).sum();
        let mut done = 0;
        for file in std::mem::take(&mut submitted.files) {
            let path = paths
                .get(&file.name)
                .ok_or_else(|| self.http.unreadable("it asks for a file that was not announced"))?;
            if !file.stored {
                self.file(&submitted.id, &file, path, done, whole)?;
            }
            done += file.bytes;
            (self.progress)(SubmitProgress::Sending(done, whole));
        }
        let finish = format!("/api/v1/submissions/{}/finish", submitted.id);
        self.ask("POST", &finish, None)
    }

    pub fn wait(&mut self, id: &str) -> Result<Submitted, SubmitError> {
        loop {
            let submitted = self.ask("GET", &format!("/api/v1/submissions/{id}"), None)?;
            if matches!(submitted.state, Stage::Verified | Stage::Refused) {
                return Ok(submitted);
            }
            (self.progress)(submitted.progress());
            self.pause(POLL)?;
        }
    }

    /// The files by name, and the request that announces them.
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
            let mut file = fiatlux_files::open(path).map_err(read)?;
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

    /// Sends the missing part of a file; after an interruption it asks how much has arrived.
    fn file(&mut self, id: &str, file: &FileStatus, path: &Path, done: u64, whole: u64) -> Result<(), SubmitError> {
        let read = |source| SubmitError::Read { path: path.into(), source };
        let (mut received, mut tries) = (file.received, FailedTries::default());
        loop {
            let mut source = fiatlux_files::open(path).map_err(read)?;
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
                // 408: too slow; 409: another offset, or an earlier connection is still open; 5xx.
                Ok(answer) => answer.refused().to_string(),
                Err(reason) => reason,
            };
            self.pause(tries.again(&self.http, reason)?)?;
            let submitted = self.ask("GET", &format!("/api/v1/submissions/{id}"), None)?;
            let there = submitted.files.iter().find(|there| there.place == file.place);
            let there = there.ok_or_else(|| self.http.unreadable("it no longer lists the file"))?;
            if there.stored {
                return Ok(());
            }
            if there.received > received {
                tries = FailedTries::default();
            }
            received = there.received.min(file.bytes);
        }
    }

    /// A request without a file, repeated while the service does not answer.
    fn ask(&mut self, method: &str, address: &str, body: Option<String>) -> Result<Submitted, SubmitError> {
        let mut tries = FailedTries::default();
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

#[derive(Debug, Default)]
struct FailedTries(u32);

impl FailedTries {
    /// Counts one more, and returns the pause before the next one.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Guards "verified 0 of 0 episodes", which looks like a submission without any.
    #[test]
    fn what_is_graded_is_not_said_to_be_verified() {
        let progress = |state: &str, whole: u64| {
            let answer = json!({
                "id": "0123456789abcdef", "state": state, "reason": "", "badge": "self_reported", "episodes_verified": 0,
                "episodes_to_verify": whole,
            });
            serde_json::from_value::<Submitted>(answer).expect("an answer").progress()
        };
        assert_eq!(progress("received", 0), SubmitProgress::Grading);
        assert_eq!(progress("graded", 48), SubmitProgress::Verifying(0, 48));
    }
}
