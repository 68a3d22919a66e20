//! The bags that are on disk already, by session: a recorder that starts again continues where it was.
//!
//! A thread of its own reads the folder, once, and looks for the bags of each session that has sent a record.

use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use fiatlux_access::RowsKey;
use fiatlux_bag::{Bag, Resumed};
use fiatlux_carrier::{Carrier, Quality};
use fiatlux_proto::keys::SessionKeys;
use fiatlux_proto::v3::EpisodeHeader;
use fiatlux_session::recorder::Input;
use fiatlux_session::{Machine, RecorderSession};
use tracing::{info, warn};

use super::bags::{Bags, Found};
use super::inlet::{Followed, Inlet, Listed, Lookup};
use super::locks::lock;
use super::{Naming, RecorderState};

/// Number of newest bags of a folder in which a session is looked for.
const LATEST: usize = 128;

/// Number of sessions that are remembered where all bags are in one folder.
const MAX_SESSIONS: usize = 4096;

/// The bags of sessions, where all are in one folder.
#[derive(Default)]
pub(super) struct Shelf {
    files: BTreeMap<(String, String), Vec<PathBuf>>,
    /// Oldest first.
    order: VecDeque<(String, String)>,
}

impl Shelf {
    /// Reads the headers of a folder's unfinished bags and of its latest ones.
    fn read(&mut self, folder: &Path) {
        for path in latest(folder) {
            if let Some(header) = header_of(&path) {
                self.note(&header, &path);
            }
        }
    }

    /// Notes a bag of a session.
    pub fn note(&mut self, header: &EpisodeHeader, path: &Path) {
        let session = (header.server.clone(), header.session.clone());
        let files = self.files.entry(session.clone()).or_insert_with(|| {
            self.order.push_back(session);
            Vec::new()
        });
        files.push(path.into());
        if self.order.len() > MAX_SESSIONS
            && let Some(oldest) = self.order.pop_front()
        {
            self.files.remove(&oldest);
        }
    }
}

/// A folder's unfinished bags, and its latest finished ones.
fn latest(folder: &Path) -> Vec<PathBuf> {
    let (mut parts, mut bags) = (Vec::new(), Vec::new());
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        // A FIFO would never end.
        let Some(found) = entry.metadata().ok().filter(fs::Metadata::is_file) else { continue };
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("part") => parts.push(path),
            Some("mcap") => bags.push((found.modified().ok(), path)),
            _ => {}
        }
    }
    bags.sort();
    parts.sort();
    let bags = bags.into_iter().rev().take(LATEST).map(|(_, path)| path);
    parts.into_iter().chain(bags).collect()
}

fn header_of(path: &Path) -> Option<EpisodeHeader> {
    Bag::open(path).ok().map(|bag| bag.header().clone())
}

/// Prepares sessions for their workers; the body of a thread.
pub(super) fn prepare_all(carrier: &Carrier, shared: &Arc<RecorderState>, inbox: &Receiver<Option<Lookup>>) {
    if shared.naming == Naming::Flat {
        lock(&shared.shelf).read(&shared.out);
    }
    while let Ok(Some(Lookup(inlet))) = inbox.recv() {
        if let Some(session) = prepare(carrier, shared, &inlet) {
            inlet.follow(Box::new(session));
        } else {
            shared.inlets.remove(&inlet);
        }
    }
}

fn prepare(carrier: &Carrier, shared: &Arc<RecorderState>, inlet: &Arc<Inlet>) -> Option<Followed> {
    let key = &inlet.key;
    let (keys, server, session) = SessionKeys::of(key)?;
    let folder = match shared.naming {
        Naming::Flat => shared.out.clone(),
        Naming::BySession | Naming::ByRun => shared.out.join(server).join(session),
    };
    let files = match shared.naming {
        Naming::Flat => lock(&shared.shelf).files.get(&(server.into(), session.into())).cloned().unwrap_or_default(),
        Naming::BySession | Naming::ByRun => latest(&folder),
    };
    let found = Found::among(&files, server, session);
    let now = shared.start.elapsed();
    let name = &shared.name;
    let mut state = match &found.resumed {
        Some(Resumed { writer, header }) => {
            info!(%key, next_step = writer.next_step(), "continuing an unfinished bag");
            let mut state = RecorderSession::resume(name, header.clone(), writer.next_step(), now);
            state.handle(Input::OnDisk(writer.next_step_on_disk()), now);
            state
        }
        None if found.is_begun => RecorderSession::again(name, now),
        None => RecorderSession::new(name, now),
    };
    state.handle(Input::ServerSeen, now);
    let acks = carrier.publisher(&keys.truth_ack(), "StepRecordAck", Quality::default(), shared.reach);
    let acks = acks.map_err(|error| warn!(%key, %error, "cannot acknowledge the records of a session")).ok()?;
    let bags = Bags::new(shared, folder, found);
    let listed = Listed { shared: Arc::clone(shared), inlet: Arc::clone(inlet) };
    Some(Followed { inlet: Arc::clone(inlet), state, bags, acks, _listed: listed })
}

/// The key of a session's records, if its token proves that a server with the recorder's key has announced it.
pub(super) fn rows_of(shared: &RecorderState, token: &str) -> Option<(Arc<str>, RowsKey)> {
    let (keys, server, session) = SessionKeys::of(token)?;
    let (_, proof) = token.rsplit_once('/')?;
    let rows = RowsKey::of_recorder(&shared.key, server, session).ok()?;
    rows.is_token(proof).then(|| (keys.root().into(), rows))
}
