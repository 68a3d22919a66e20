//! The outcome of each episode of a run.

use std::collections::BTreeSet;
use std::path::Path;

use fiatlux_proto::keys::is_name;

use super::journal::{Chain, Lines};
use super::{ABANDONED, Event, LedgerError, MAX_ATTEMPTS, MAX_EPISODES, MAX_TEXT, Marks, NOT_RUN, Registration};

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EpisodeState {
    /// Not begun, or to be begun again.
    Waiting,
    /// This session plays it. In a journal without a running server, it was open when the server died.
    Open { session: String },
    /// Played to its end and on disk.
    Played(PlayedEpisode),
    /// It counts as a failure.
    Failed {
        /// Such as [`NOT_RUN`], [`ABANDONED`] or [`NOT_REPEATED`](super::NOT_REPEATED).
        cause: String,
    },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlayedEpisode {
    pub session: String,
    /// File name of the bag, in the journal's folder; never a path.
    pub bag: String,
    pub digest: String,
    /// Name of the cause that ended the episode, such as `success` or `fall`.
    pub cause: String,
    /// Judged by the run's judge, published or strict.
    pub success: bool,
    pub steps: u64,
}

/// Rows that a later attempt must repeat.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prefix {
    pub steps: u64,
    pub digest: String,
    /// Short digests of earlier rows.
    pub marks: Marks,
}

/// A server's signature under its journal. The reader must check it, and decide whether to trust the key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seal {
    /// Link of the line above it, which stands for the whole journal.
    pub of: String,
    pub key: String,
    /// Signature of the link, base64.
    pub signature: String,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LedgerEpisode {
    pub state: EpisodeState,
    pub attempts: u32,
    /// The longest of the attempts that were abandoned.
    pub prefix: Option<Prefix>,
    /// Cause of the last abandoned attempt; may be empty.
    pub abandoned: String,
    /// Attempts that ended because the server died. They bind nothing.
    pub lost: u32,
    /// Start of the first attempt that counts, ms since 1970.
    pub opened_ms: Option<u64>,
}

/// A run as its journal describes it, without I/O: [`Ledger::apply`] folds in an event.
#[derive(Debug, Clone, PartialEq)]
pub struct Ledger {
    registration: Registration,
    episodes: Vec<LedgerEpisode>,
    finished: bool,
    finished_ms: Option<u64>,
    seal: Option<Seal>,
}

impl Ledger {
    pub fn new(registration: Registration) -> Result<Self, String> {
        check(&registration)?;
        let waiting = LedgerEpisode {
            state: EpisodeState::Waiting,
            attempts: 0,
            prefix: None,
            abandoned: String::new(),
            lost: 0,
            opened_ms: None,
        };
        let episodes = vec![waiting; registration.episodes.len()];
        Ok(Self { registration, episodes, finished: false, finished_ms: None, seal: None })
    }

    pub fn read(path: impl AsRef<Path>) -> Result<Self, LedgerError> {
        Self::read_chain(path.as_ref()).map(|(ledger, _)| ledger)
    }

    pub(super) fn read_chain(path: &Path) -> Result<(Self, Chain), LedgerError> {
        let mut lines = Lines::open(path)?;
        let registration =
            lines.next()?.ok_or_else(|| lines.wrong_line("the first line is not a registration".into()))?;
        let mut ledger = Self::new(registration).map_err(|reason| lines.wrong_line(reason))?;
        loop {
            let before = lines.chain.link.clone();
            let Some(event) = lines.next()? else { break };
            if matches!(&event, Event::Sealed { of, .. } if *of != before) {
                return Err(lines.wrong_line("the signature does not cover the lines above it".into()));
            }
            ledger.apply(&event).map_err(|reason| lines.wrong_line(reason))?;
        }
        Ok((ledger, lines.chain))
    }

    pub fn registration(&self) -> &Registration {
        &self.registration
    }

    pub fn episodes(&self) -> &[LedgerEpisode] {
        &self.episodes
    }

    /// True if no episode is waiting or open.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Time of its end, ms since 1970.
    pub fn finished_ms(&self) -> Option<u64> {
        self.finished_ms
    }

    pub fn seal(&self) -> Option<&Seal> {
        self.seal.as_ref()
    }

    /// True if the server drew the seeds.
    pub fn is_hosted(&self) -> bool {
        self.registration.spec.hosted_seeds > 0
    }

    pub fn open(&self) -> impl Iterator<Item = (u32, &LedgerEpisode)> {
        let numbered = (0..).zip(&self.episodes);
        numbered.filter(|(_, episode)| matches!(episode.state, EpisodeState::Open { .. }))
    }

    /// Applies an event.
    ///
    /// # Errors
    /// The event contradicts those before it; nothing has changed then.
    pub fn apply(&mut self, event: &Event) -> Result<(), String> {
        if let Event::Sealed { of, key, signature } = event {
            return self.take_seal(of, key, signature);
        }
        if self.finished {
            return Err("the run is finished".into());
        }
        let (index, attempt) = match event {
            Event::Opened { episode, attempt, .. }
            | Event::Played { episode, attempt, .. }
            | Event::Abandoned { episode, attempt, .. }
            | Event::Failed { episode, attempt, .. } => (*episode, *attempt),
            Event::Restarted { .. } => {
                for episode in &mut self.episodes {
                    if matches!(episode.state, EpisodeState::Open { .. }) {
                        (episode.state, episode.lost) = (EpisodeState::Waiting, episode.lost + 1);
                        episode.opened_ms = episode.opened_ms.filter(|_| episode.attempts > episode.lost);
                    }
                }
                return Ok(());
            }
            Event::Finished { unix_ms } => return self.finish(*unix_ms),
            Event::Sealed { .. } => return Ok(()),
        };
        let count = self.episodes.len();
        let episode = self.episodes.get_mut(index as usize);
        let episode =
            episode.ok_or_else(|| format!("there is no episode {index}; the run has {count}, counted from 0"))?;
        if let Event::Opened { session, unix_ms, .. } = event {
            let Registration { server, .. } = &self.registration;
            if let Some(owner) = self.registration.owner(index as usize).filter(|owner| owner != server) {
                return Err(format!("episode {index} belongs to server {owner}, and {server} began it, too"));
            }
            if episode.state != EpisodeState::Waiting {
                return Err(format!("episode {index} is already open or decided"));
            }
            if attempt != episode.attempts + 1 || attempt > MAX_ATTEMPTS {
                return Err(format!(
                    "attempt {attempt} at episode {index} does not follow {}; the maximum is {MAX_ATTEMPTS}",
                    episode.attempts
                ));
            }
            short(session)?;
            (episode.state, episode.attempts) = (EpisodeState::Open { session: session.clone() }, attempt);
            episode.opened_ms.get_or_insert(*unix_ms);
            return Ok(());
        }
        let EpisodeState::Open { session: opened } = &episode.state else {
            return Err(format!("episode {index} is not open"));
        };
        if attempt != episode.attempts {
            return Err(format!("attempt {attempt} at episode {index} is not the one that is open"));
        }
        let is_same = |session: &String| match session == opened {
            true => Ok(()),
            false => Err(format!("episode {index} is open in another session")),
        };
        match event {
            Event::Played { session, bag, digest, cause, success, steps, .. } => {
                is_same(session)?;
                short(cause)?;
                if !is_file_name(bag) {
                    return Err(format!("'{}' is not a file name of a bag", super::clip(bag)));
                }
                if !is_sha256(digest) {
                    return Err("the digest is not 64 hexadecimal digits".into());
                }
                let (session, bag, digest, cause) = (session.clone(), bag.clone(), digest.clone(), cause.clone());
                let (success, steps) = (*success, *steps);
                episode.state = EpisodeState::Played(PlayedEpisode { session, bag, digest, cause, success, steps });
            }
            Event::Abandoned { session, steps, digest, marks, cause, .. } => {
                is_same(session)?;
                short(cause)?;
                if !digest.is_empty() && !is_sha256(digest) {
                    return Err("the digest is not 64 hexadecimal digits".into());
                }
                marks.check()?;
                let is_longer = episode.prefix.as_ref().is_none_or(|prefix| *steps > prefix.steps);
                if !digest.is_empty() && is_longer {
                    episode.prefix = Some(Prefix { steps: *steps, digest: digest.clone(), marks: marks.clone() });
                }
                episode.abandoned.clone_from(cause);
                episode.state = EpisodeState::Waiting;
            }
            Event::Failed { cause, .. } => {
                short(cause)?;
                episode.state = EpisodeState::Failed { cause: cause.clone() };
            }
            Event::Opened { .. } | Event::Restarted { .. } | Event::Finished { .. } | Event::Sealed { .. } => {}
        }
        if episode.state == EpisodeState::Waiting && episode.attempts >= MAX_ATTEMPTS {
            episode.state = EpisodeState::Failed { cause: ABANDONED.into() };
        }
        Ok(())
    }

    fn take_seal(&mut self, of: &str, key: &str, signature: &str) -> Result<(), String> {
        if !self.finished || self.seal.is_some() {
            return Err("a journal is signed once, when its run is finished".into());
        }
        [of, key, signature].into_iter().try_for_each(short)?;
        self.seal = Some(Seal { of: of.into(), key: key.into(), signature: signature.into() });
        Ok(())
    }

    fn finish(&mut self, unix_ms: u64) -> Result<(), String> {
        if let Some((index, _)) = self.open().next() {
            return Err(format!("episode {index} is open"));
        }
        for episode in &mut self.episodes {
            if episode.state == EpisodeState::Waiting {
                // The server's death alone leaves no trace of the client's.
                let begun = episode.attempts > episode.lost;
                episode.state = EpisodeState::Failed { cause: if begun { ABANDONED } else { NOT_RUN }.into() };
            }
        }
        (self.finished, self.finished_ms) = (true, Some(unix_ms));
        Ok(())
    }
}

fn check(registration: &Registration) -> Result<(), String> {
    let Registration { server, run, key_sha256, episodes, .. } = registration;
    if !is_name(server) || !is_name(run) {
        return Err("server or run has a name that is not 1 to 64 letters, digits, - or _".into());
    }
    if !is_sha256(key_sha256) {
        return Err("the key's digest is not 64 hexadecimal digits".into());
    }
    if !(1..=MAX_EPISODES).contains(&episodes.len()) {
        return Err(format!("a run has 1 to {MAX_EPISODES} episodes, this one {}", episodes.len()));
    }
    if episodes.iter().any(|episode| !is_name(&episode.task)) {
        return Err("an episode has a task that is not 1 to 64 letters, digits, - or _".into());
    }
    if episodes.iter().collect::<BTreeSet<_>>().len() < episodes.len() {
        return Err("two episodes have the same task and seed".into());
    }
    let Registration { group, spec, .. } = registration;
    let is_sorted = group.is_sorted_by(|one, other| one < other);
    let is_group = is_sorted && group.contains(server) && spec.hosted_seeds > 0;
    if !group.is_empty() && !is_group {
        return Err("its group is not a sorted list of servers with its own, or its seeds are not hosted".into());
    }
    Ok(())
}

/// A plain file name of a bag: nothing that leads out of the folder.
fn is_file_name(name: &str) -> bool {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    name.len() <= 255 && name.ends_with(".mcap") && !name.starts_with('.') && name.bytes().all(fits)
}

fn is_sha256(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

fn short(text: &str) -> Result<(), String> {
    if text.len() <= MAX_TEXT { Ok(()) } else { Err(format!("a text has more than {MAX_TEXT} bytes")) }
}
