//! The server of replays: for this machine alone.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use axum::body::Bytes;

use crate::answers::router;
use crate::page::Page;
use crate::{Bags, Replay, ReplayError};

/// Replays that are kept in memory, of at most 50 MB each.
const MOST_KEPT: usize = 2;
/// How often it looks whether it shall stop.
const LOOK: Duration = Duration::from_millis(50);

/// Shows bags in a browser of this machine. It listens on the loopback interface and answers requests for its own address
/// alone, so that no page of another host can read it under a name of its own. Clients name episodes by number, never files.
#[derive(Debug)]
pub struct Viewer {
    listener: TcpListener,
    address: SocketAddr,
    shelf: Arc<Shelf>,
}

impl Viewer {
    /// Listens on a port of 127.0.0.1; 0 is a free one.
    ///
    /// # Errors
    /// [`ReplayError::Listen`]: the port is taken.
    pub fn bind(bags: Bags, port: u16) -> Result<Self, ReplayError> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let failed = |source| ReplayError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address: bound, shelf: Arc::new(Shelf::new(bags)) })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until `stop` is set.
    ///
    /// # Errors
    /// [`ReplayError::Serve`]: the listener failed.
    pub fn serve(self, stop: &AtomicBool) -> Result<(), ReplayError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(ReplayError::Serve)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let server = axum::serve(listener, router(self.shelf, self.address.port()));
            tokio::select! {
                served = server.into_future() => served,
                () = stopped(stop) => Ok(()),
            }
        });
        // A replay that is being read is not waited for.
        runtime.shutdown_background();
        served.map_err(ReplayError::Serve)
    }
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(LOOK).await;
    }
}

/// A replay as it is sent.
#[derive(Debug, Clone)]
pub(crate) struct Shown {
    pub document: Bytes,
    pub meshes: Bytes,
    pub track: Bytes,
}

/// Which file it was made of, and which version of it: a bag may still be growing.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Edition {
    index: usize,
    length: u64,
    modified: Option<SystemTime>,
}

/// The bags, their pages, and the replays that were asked for last.
#[derive(Debug)]
pub(crate) struct Shelf {
    pub bags: Bags,
    pub list: Page,
    pub replay: Page,
    /// The last one is the one that was asked for last.
    kept: Mutex<Vec<(Edition, Shown)>>,
}

impl Shelf {
    fn new(bags: Bags) -> Self {
        let replay = Page::replay(bags.count() > 1);
        Self { bags, list: Page::list(), replay, kept: Mutex::default() }
    }

    /// The replay of a bag; none where there is no bag of that number. One is read at a time, which bounds the memory.
    pub fn show(&self, index: usize) -> Option<Result<Shown, ReplayError>> {
        let path = self.bags.file(index)?;
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let metadata = match fs::metadata(path) {
            Ok(metadata) => metadata,
            Err(source) => return Some(Err(ReplayError::Io { action: "read", path: path.into(), source })),
        };
        let edition = Edition { index, length: metadata.len(), modified: metadata.modified().ok() };
        let found = match kept.iter().position(|(known, _)| *known == edition) {
            Some(at) => kept.remove(at).1,
            None => match Replay::open(path) {
                Ok(replay) => Shown::from(replay),
                Err(error) => return Some(Err(error)),
            },
        };
        kept.retain(|(known, _)| known.index != index);
        if kept.len() >= MOST_KEPT {
            kept.remove(0);
        }
        kept.push((edition, found.clone()));
        Some(Ok(found))
    }
}

impl From<Replay> for Shown {
    fn from(replay: Replay) -> Self {
        let document = Bytes::from(replay.document_json());
        let (meshes, track) = replay.into_bytes();
        Self { document, meshes: meshes.into(), track: track.into() }
    }
}
