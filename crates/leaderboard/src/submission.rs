//! A submission: its manifest and files, its division, its state and its badge.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use fiatlux_proto::is_unseen;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use time::OffsetDateTime;

use crate::store::Digest;

/// Id of a submission: 16 hexadecimal digits, computed from its content and its account.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SubmissionId(pub(crate) u64);

impl fmt::Display for SubmissionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl FromStr for SubmissionId {
    type Err = WordError;

    fn from_str(text: &str) -> Result<Self, WordError> {
        let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        let refuse = || WordError { what: "submission", expected: "16 hexadecimal digits in lower case" };
        if text.len() != 16 || !text.bytes().all(is_digit) {
            return Err(refuse());
        }
        u64::from_str_radix(text, 16).map(Self).map_err(|_| refuse())
    }
}

/// A word is not of the expected form.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("not the id of a {what}; write {expected}")]
pub struct WordError {
    /// The thing that it should name, such as `submission`.
    pub what: &'static str,
    pub expected: &'static str,
}

/// The submitter's description of a policy. This is untrusted text: bounded and without control characters, but it must
/// be escaped wherever it is shown. Nobody checks that it is true.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// 1 to 80 bytes.
    pub policy: String,
    /// Up to 80 bytes.
    #[serde(default)]
    pub version: String,
    /// Up to 32 names of up to 120 bytes each.
    #[serde(default)]
    pub authors: Vec<String>,
    /// Empty, or a URL that begins with `https://` or `http://`, up to 400 bytes.
    #[serde(default)]
    pub link: String,
    /// Such as `Apache-2.0`, up to 80 bytes.
    #[serde(default)]
    pub licence: String,
    /// Up to 2,000 bytes; may contain line breaks.
    #[serde(default)]
    pub note: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("manifest: {field} {problem}; {remedy}")]
pub struct ManifestError {
    pub field: &'static str,
    pub problem: &'static str,
    pub remedy: &'static str,
}

const MAX_AUTHORS: usize = 32;

impl Manifest {
    /// Checks the length and the characters of every field; the error names the first that is not accepted.
    pub fn check(&self) -> Result<(), ManifestError> {
        let wrong = |field, problem, remedy| Err(ManifestError { field, problem, remedy });
        if self.policy.trim().is_empty() {
            return wrong("policy", "is empty", "give the policy a name");
        }
        if self.authors.len() > MAX_AUTHORS {
            return wrong("authors", "has more than 32 names", "name a group instead");
        }
        let texts = [
            ("policy", &self.policy, 80),
            ("version", &self.version, 80),
            ("link", &self.link, 400),
            ("licence", &self.licence, 80),
            ("note", &self.note, 2000),
        ];
        for (field, text, most) in texts.into_iter().chain(self.authors.iter().map(|name| ("authors", name, 120))) {
            if text.len() > most {
                return wrong(field, "is too long", "shorten it to the length in the documentation");
            }
            if text.chars().any(|c| is_unseen(c) && !(field == "note" && c == '\n')) {
                return wrong(
                    field,
                    "has a control character or one that changes the direction of text",
                    "write plain text",
                );
            }
        }
        if self.authors.iter().any(|name| name.trim().is_empty()) {
            return wrong("authors", "has an empty name", "leave it out");
        }
        if !self.link.is_empty() && !is_link(&self.link) {
            return wrong("link", "is not a URL", "write https:// and a host, or leave it empty");
        }
        Ok(())
    }
}

fn is_link(text: &str) -> bool {
    let rest = ["https://", "http://"].iter().find_map(|scheme| text.strip_prefix(scheme));
    let is_plain = |c: char| c.is_ascii_graphic() && !"\"'<>\\^`{|}".contains(c);
    rest.is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_alphanumeric()) && rest.chars().all(is_plain))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// The world waited for each action.
    Lockstep,
    /// The world ran at 50 Hz by the wall clock and did not wait.
    RealTime,
}

/// The class of a policy's observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Observations {
    Standard,
    /// Also the place of the lamp or of the ladder's top, as a map would give it.
    Goal,
    /// Also the exact state of the world, or the judge's verdict.
    Privileged,
}

/// The two tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Runs on the board's own servers.
    Hosted,
    /// Anybody's bags, simulated again.
    Replayed,
}

/// Conditions that are proven of a ranking's entries; a ranking never mixes them. A hosted entry has all of them; of a
/// replayed one time and observations are claims, so its table has none.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Division {
    pub table: Kind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<Time>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observations: Option<Observations>,
    /// The robot, one of `fiatlux_rules::pins::RANKED_ROBOTS`.
    pub robot: String,
    /// Objects from files in place of the scene's own things, each as its place and digest.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assets: Vec<String>,
}

/// The degree to which a submission is confirmed, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Badge {
    /// Its bags are consistent; nothing else was checked. Never ranked.
    SelfReported,
    /// Every bag was simulated again, with results equal to the last bit: this motion happened in this room.
    Replayed,
    /// Seeds were drawn after registration, and every bag and journal is signed by one of the operator's servers: it also
    /// proves what the policy was shown.
    Hosted,
}

/// Outcome of a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Proof {
    Proven,
    /// The submitter says so; nobody has checked it, or nobody can.
    Claimed,
    /// It is false, or cannot be true.
    Refused,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    pub proof: Proof,
    /// Why, as a sentence without a full stop.
    pub reason: String,
}

impl Claim {
    pub(crate) fn new(proof: Proof, reason: impl Into<String>) -> Self {
        Self { proof, reason: reason.into() }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claims {
    pub rows: Claim,
    pub senses: Claim,
    pub tries: Claim,
}

/// Stages of a submission, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    Uploading,
    /// All files have arrived and wait to be graded.
    Received,
    /// Its scores are known; its bags are being verified.
    Graded,
    /// All bags that can be verified are.
    Verified,
    /// It is in no table; only its submitter can still see it, with the reason.
    Refused,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Part of the addresses of its pages.
    pub id: SubmissionId,
    pub manifest: Manifest,
    /// Name of the account that submitted it, which is public.
    pub account: String,
    /// Where it is ranked, among all twelve subtasks or in some of them; `None` if nowhere.
    pub division: Option<Division>,
    pub badge: Badge,
    /// Its claims, and what is proven of them.
    pub claims: Claims,
    /// The senses that it claims, in words; empty until it is graded.
    pub senses: String,
    /// Why it is not ranked among all twelve subtasks; empty if it is.
    pub obstacle: String,
    /// Subtasks in which it is ranked, such as `S05`.
    pub tasks: Vec<String>,
    /// Episodes by subtask of hosted runs that were registered and not submitted: they count as failures.
    pub failed_tries: BTreeMap<String, u64>,
    pub state: Stage,
    /// The reason of a refusal; else empty.
    pub reason: String,
    /// The time at which the submission was complete; until then, at which it was begun.
    pub received: OffsetDateTime,
    /// Episodes verified so far, and episodes to verify in total.
    pub progress: (u64, u64),
}

/// The word for a value in JSON and in the database.
#[cfg(test)]
pub(crate) fn word_to(value: impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

/// The value of such a word.
pub(crate) fn word_of<T: DeserializeOwned>(word: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(serde_json::Value::String(word.to_owned()))
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileSpec {
    pub name: String,
    pub bytes: u64,
    pub sha256: Digest,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    pub files: usize,
    pub file_bytes: u64,
    /// Maximum size of all files together, bytes.
    pub bytes: u64,
}

impl Default for Limits {
    /// 20,000 files, 512 MiB each, 32 GiB together.
    fn default() -> Self {
        Self { files: 20_000, file_bytes: 512 << 20, bytes: 32 << 30 }
    }
}

pub(crate) const BAG: &str = ".mcap";
pub(crate) const JOURNAL: &str = ".run.jsonl";
/// Maximum length of a file name, bytes.
pub(crate) const MAX_NAME: usize = 160;

/// True if a file may have this name: it cannot lead out of a folder, and its ending is that of a bag or journal.
pub(crate) fn is_file_name(name: &str) -> bool {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let stem = [BAG, JOURNAL].iter().find_map(|ending| name.strip_suffix(ending));
    name.len() <= MAX_NAME
        && name.bytes().all(is_plain)
        && stem.is_some_and(|stem| stem.starts_with(|c: char| c != '.' && c != '-'))
}

/// The id of a submission: a hash of its account, its manifest and its list of files.
pub(crate) fn id_of(account: &str, manifest: &Manifest, files: &[FileSpec]) -> SubmissionId {
    let mut sum = Sha256::new();
    let mut add = |text: &str| {
        sum.update((text.len() as u64).to_le_bytes());
        sum.update(text);
    };
    add("fiatlux submission 1");
    add(account);
    let Manifest { policy, version, authors, link, licence, note } = manifest;
    [policy, version, link, licence, note].into_iter().for_each(|text| add(text));
    add(&authors.len().to_string());
    authors.iter().for_each(|author| add(author));
    for FileSpec { name, bytes, sha256 } in files {
        add(name);
        add(&bytes.to_string());
        add(sha256.as_str());
    }
    let digest = sum.finalize();
    let mut first = [0; 8];
    first.copy_from_slice(&digest[..8]);
    SubmissionId(u64::from_be_bytes(first))
}
