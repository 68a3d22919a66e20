//! What is submitted: a manifest and a run's files, its division, its state and its badge.

use std::fmt;
use std::str::FromStr;

use fiatlux_grading::{Conditions, Results};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use thiserror::Error;
use time::OffsetDateTime;

use crate::store::Digest;

/// Names a submission: 16 hexadecimal digits, which follow from its content and its account.
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

/// A word or number that is not one of those that stand for something here.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("not the name of a {what}; it is {expected}")]
pub struct WordError {
    /// What it was read as.
    pub what: &'static str,
    /// What it may be.
    pub expected: &'static str,
}

/// What a submitter says of a policy. Plain text from outside: bounded and without control characters, but to be escaped
/// wherever it is shown. Nothing in it is checked to be true.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// The policy's name: 1 to 80 bytes.
    pub policy: String,
    /// Its version, up to 80 bytes.
    #[serde(default)]
    pub version: String,
    /// Who made it: up to 32 names of up to 120 bytes.
    #[serde(default)]
    pub authors: Vec<String>,
    /// Where it is described: empty, or an address that begins with `https://` or `http://`, up to 400 bytes.
    #[serde(default)]
    pub link: String,
    /// Licence of the policy, such as `Apache-2.0`, up to 80 bytes.
    #[serde(default)]
    pub licence: String,
    /// Anything else that a reader should know, up to 2,000 bytes; lines may be broken.
    #[serde(default)]
    pub note: String,
}

/// A field of a manifest that cannot be taken.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("manifest: {field} {problem}; {remedy}")]
pub struct ManifestError {
    /// The field.
    pub field: &'static str,
    /// What is wrong with it.
    pub problem: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

/// Most authors of a submission.
const MAX_AUTHORS: usize = 32;

impl Manifest {
    /// Whether all its texts fit.
    ///
    /// # Errors
    /// The first field that does not.
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
                return wrong(field, "is too long", "the documentation of the manifest has the lengths");
            }
            if text.chars().any(|c| is_unseen(c) && !(field == "note" && c == '\n')) {
                return wrong(field, "has a control character or one that turns text around", "write plain text");
            }
        }
        if self.authors.iter().any(|name| name.trim().is_empty()) {
            return wrong("authors", "has an empty name", "leave it out");
        }
        if !self.link.is_empty() && !is_link(&self.link) {
            return wrong("link", "is not an address", "write https:// and a host, or leave it empty");
        }
        Ok(())
    }
}

/// Characters that change how the text around them is shown: controls, and those of Unicode that turn its direction or have
/// no width.
fn is_unseen(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

fn is_link(text: &str) -> bool {
    let rest = ["https://", "http://"].iter().find_map(|scheme| text.strip_prefix(scheme));
    let is_plain = |c: char| c.is_ascii_graphic() && !"\"'<>\\^`{|}".contains(c);
    rest.is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_alphanumeric()) && rest.chars().all(is_plain))
}

/// Hands that have divisions.
pub(crate) const RANKED_HANDS: [&str; 2] = ["inspire", "dex3"];

/// Whether the world waited for the policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Time {
    /// It did.
    Lockstep,
    /// 50 Hz by the wall clock.
    RealTime,
}

/// What the policy could sense.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Observations {
    /// What a robot senses, as published.
    Standard,
    /// Also the exact state or the judge's verdict.
    Privileged,
}

/// Rankings never mix these.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Division {
    /// Whether the world waited for the policy.
    pub time: Time,
    /// What the policy could sense.
    pub observations: Observations,
    /// The robot's hands: `inspire` or `dex3`.
    pub hands: String,
}

impl Division {
    /// Of results; `None` where they have a place in no ranking, for the reason that [`Division::obstacle`] gives.
    pub fn of(results: &Results) -> Option<Self> {
        if !results.missing.is_empty() || results.episodes.is_empty() {
            return None;
        }
        Self::of_conditions(&results.conditions)
    }

    fn of_conditions(conditions: &Conditions) -> Option<Self> {
        let time = match conditions.time.as_str() {
            "lockstep" => Time::Lockstep,
            "real time" => Time::RealTime,
            _ => return None,
        };
        let observations = match conditions.observations.as_str() {
            "standard" => Observations::Standard,
            "privileged" => Observations::Privileged,
            _ => return None,
        };
        // Other hands are a division of their own, not a deviation.
        let is_hands = |deviation: &String| deviation.starts_with("hands are ");
        let ranked = conditions.deviations.iter().all(is_hands) && conditions.protocol == "strict";
        let is_known = RANKED_HANDS.contains(&conditions.hands.as_str());
        (ranked && is_known).then(|| Self { time, observations, hands: conditions.hands.clone() })
    }

    /// Why results are not ranked, in words; empty where they are.
    pub fn obstacle(results: &Results) -> String {
        if Self::of(results).is_some() {
            return String::new();
        }
        let conditions = &results.conditions;
        let mut reasons = conditions.deviations.clone();
        if !results.missing.is_empty() {
            reasons.push(format!("there is no episode of {} under some of the seeds", results.missing.join(", ")));
        }
        if conditions.protocol != "strict" {
            reasons.push("episodes were not played by protocol strict".into());
        }
        if reasons.is_empty() {
            reasons.push(format!("observations are '{}', hands '{}'", conditions.observations, conditions.hands));
        }
        reasons.join("; ")
    }
}

/// How much of a submission has been seen to be true. A later one is worth more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Badge {
    /// Its bags agree with themselves, and that is all.
    SelfReported,
    /// Every bag was simulated again, and was equal to the last bit.
    Replayed,
    /// Seeds were drawn after registration, and every bag is signed by a server of ours.
    Hosted,
}

/// How far a submission has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Files are still to come.
    Uploading,
    /// All files have come, and wait to be graded.
    Received,
    /// Its scores are known; bags may still be verified.
    Graded,
    /// All that could be verified was.
    Verified,
    /// It has no place here, for the reason that is given with it.
    Refused,
}

/// A submission as others may see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Names it.
    pub id: SubmissionId,
    /// What the submitter says of the policy.
    pub manifest: Manifest,
    /// Whose it is: the name of the account, no secret.
    pub account: String,
    /// Where it is ranked; `None` where it is not, or not graded yet.
    pub division: Option<Division>,
    /// How much of it has been seen to be true.
    pub badge: Badge,
    /// How far it has come.
    pub state: State,
    /// Why it was refused; else empty.
    pub reason: String,
    /// When its last file had come; when it was begun, where it has not.
    pub received: OffsetDateTime,
    /// Episodes that were verified, and how many are to be.
    pub progress: (u64, u64),
}

/// The word that stands for a value in JSON and in the database.
pub(crate) fn word_to(value: impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

/// The value that a word stands for.
pub(crate) fn word_of<T: DeserializeOwned>(word: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(serde_json::Value::String(word.to_owned()))
}

/// A file that is to come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileSpec {
    pub name: String,
    pub bytes: u64,
    pub sha256: Digest,
}

/// How much a submission may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Most files.
    pub files: usize,
    /// Most bytes of a file.
    pub file_bytes: u64,
    /// Most bytes of all its files.
    pub bytes: u64,
}

impl Default for Limits {
    /// 20,000 files, 512 MiB each, 32 GiB together.
    fn default() -> Self {
        Self { files: 20_000, file_bytes: 512 << 20, bytes: 32 << 30 }
    }
}

/// How the name of a bag ends.
pub(crate) const BAG: &str = ".mcap";
/// How the name of a run's journal ends.
pub(crate) const JOURNAL: &str = ".run.jsonl";
/// Longest name of a file, bytes.
pub(crate) const MAX_NAME: usize = 160;

/// Whether a file may have that name: it cannot lead out of a folder, and says what the file is.
pub(crate) fn is_file_name(name: &str) -> bool {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let stem = [BAG, JOURNAL].iter().find_map(|ending| name.strip_suffix(ending));
    name.len() <= MAX_NAME
        && name.bytes().all(is_plain)
        && stem.is_some_and(|stem| stem.starts_with(|c: char| c != '.' && c != '-'))
}

/// Names a submission after its account and all that was said of it.
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
