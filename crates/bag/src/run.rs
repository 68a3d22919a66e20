//! The ledger of a run: its episodes and their outcomes.
//!
//! A run has a folder of its own, `DIR/RUN/`, with its bags and a journal for each server that played a part of it,
//! `SERVER.run.jsonl`. The journal is only ever appended to, a line of JSON each time, and every line is on disk before
//! anybody is told of it. Its first line is the [`Registration`], each other one an [`Event`].
//!
//! The last member of a line is its `link`: SHA-256 of the link before (of nothing, in the first line) and of the line
//! without this member. A line that was changed, left out or moved breaks the chain there. Text after the last line break
//! is a line that was being written when its server died; a reader leaves it out, and [`LedgerWriter::open`] removes it.
//! Anybody can make such a chain; the server's signature under a finished one proves its origin ([`Event::Sealed`]).
//!
//! ```
//! use fiatlux_bag::run::{Event, Ledger, LedgerWriter, PlannedEpisode, Registration, EpisodeState, journals};
//! use fiatlux_proto::PROTOCOL;
//! use fiatlux_proto::v3::RunSpec;
//!
//! let folder = std::env::temp_dir().join(format!("fiatlux-ledger-example-{}", std::process::id()));
//! # std::fs::remove_dir_all(&folder).ok();
//! let registration = Registration {
//!     protocol: PROTOCOL,
//!     version: "1.0.0".into(),
//!     server: "lab".into(),
//!     run: "first".into(),
//!     key_sha256: "0".repeat(64),
//!     spec: RunSpec::default(),
//!     episodes: vec![PlannedEpisode { task: "S05".into(), seed: 0 }, PlannedEpisode { task: "S05".into(), seed: 1 }],
//!     unix_ms: 0,
//!     holder: String::new(),
//!     group: Vec::new(),
//! };
//! let mut writer = LedgerWriter::create(&folder, registration)?;
//! writer.append(Event::Opened { episode: 0, attempt: 1, session: "a-1".into(), unix_ms: 1 })?;
//! assert!(writer.append(Event::Finished { unix_ms: 2 }).is_err(), "an episode is open");
//!
//! let ledger = Ledger::read(&journals(&folder)?[0])?;
//! assert!(matches!(ledger.episodes()[0].state, EpisodeState::Open { .. }));
//! assert_eq!(ledger.episodes()[1].state, EpisodeState::Waiting);
//! # std::fs::remove_dir_all(&folder).ok();
//! # Ok::<(), fiatlux_bag::run::LedgerError>(())
//! ```

mod error;
mod journal;
mod ledger;
mod marks;
mod writer;

use fiatlux_proto::v3::{RunSpec, Version};
use serde::{Deserialize, Serialize};

pub use error::LedgerError;
pub(crate) use journal::is_journal;
pub use journal::{ends_finished, is_torn, journal_of, journals};
pub use ledger::{EpisodeState, Ledger, LedgerEpisode, PlayedEpisode, Prefix, Seal};
pub use marks::Marks;
pub use writer::LedgerWriter;

pub const MAX_EPISODES: usize = 10_000;

/// After this many attempts an episode counts as failed.
pub const MAX_ATTEMPTS: u32 = 20;

/// Maximum length of an event's text, bytes; [`clip`] makes one fit.
pub const MAX_TEXT: usize = 512;

/// Cause of an episode that nobody began before the run was finished.
pub const NOT_RUN: &str = "not run";
/// Cause of an episode that was begun and not played to its end.
pub const ABANDONED: &str = "abandoned";
/// Cause of an episode whose later attempt diverged from the one before.
pub const NOT_REPEATED: &str = "not repeated";

/// The first line of a journal: the terms of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    pub protocol: Version,
    pub version: String,
    pub server: String,
    pub run: String,
    /// SHA-256 of the run's key, hexadecimal.
    pub key_sha256: String,
    pub spec: RunSpec,
    /// Every episode of the run, hosted seeds included.
    pub episodes: Vec<PlannedEpisode>,
    /// Time of registration, ms since 1970.
    pub unix_ms: u64,
    /// The token that registered it, `token ID`; empty on a server without tokens. Hosted runs of one holder are counted.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub holder: String,
    /// The servers that share the episodes of a hosted run without sharing a folder, sorted: episode k belongs to number k modulo their
    /// count, and no other one begins it. Empty where every server may begin every episode.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub group: Vec<String>,
}

impl Registration {
    /// The only server that may begin an episode; `None` if all may.
    pub fn owner(&self, index: usize) -> Option<&str> {
        index.checked_rem(self.group.len()).map(|place| self.group[place].as_str())
    }
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedEpisode {
    pub task: String,
    pub seed: u64,
}

/// A line of the journal. `episode` is an index into the registration, attempts count from 1, times are ms since 1970.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case", deny_unknown_fields)]
pub enum Event {
    Opened {
        episode: u32,
        attempt: u32,
        session: String,
        unix_ms: u64,
    },
    /// The episode was played to its end, and its bag is whole and on disk.
    Played {
        episode: u32,
        attempt: u32,
        session: String,
        bag: String,
        digest: String,
        /// Name of the cause that ended the episode, such as `success` or `fall`.
        cause: String,
        /// By the protocol of the run.
        success: bool,
        steps: u64,
    },
    /// The session ended before the episode did, or the bag was lost. The episode may be begun again, but must repeat these
    /// rows.
    Abandoned {
        episode: u32,
        attempt: u32,
        session: String,
        steps: u64,
        /// Digest of the rows up to that one; empty if not even row 0 was recorded.
        digest: String,
        /// Marks that a later attempt is compared with.
        #[serde(default)]
        marks: Marks,
        cause: String,
    },
    /// The episode counts as a failure.
    Failed {
        episode: u32,
        attempt: u32,
        cause: String,
    },
    /// The server was restarted. Open episodes may be begun again, and need not repeat any row: the client was not at
    /// fault.
    Restarted {
        unix_ms: u64,
    },
    /// No more episodes are played.
    Finished {
        unix_ms: u64,
    },
    /// The server's signature of all lines above, from the registration to the end. Nothing follows it.
    Sealed {
        /// Link of the line before.
        of: String,
        /// Public key of the server, `ed25519:BASE64`.
        key: String,
        /// Signature of that link, base64, as `fiatlux_access::sign_journal` makes it.
        signature: String,
    },
}

/// A text cut to [`MAX_TEXT`] bytes.
pub fn clip(text: &str) -> String {
    let mut end = text.len().min(MAX_TEXT);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text[..end].to_owned()
}
