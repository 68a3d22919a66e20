//! The pages that are connected.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;

use crate::station::Station;

/// Most pages at once.
const MAX_PAGES: usize = 16;
/// Time between two looks whether all pages are gone.
const LOOK: Duration = Duration::from_millis(5);

/// Why the server ends the connection of a page. Pages know the codes: they do not come back by themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Farewell {
    /// Others came, and it was the one that had waited longest without driving.
    TooMany,
    /// The program ends.
    End,
}

impl Farewell {
    /// The WebSocket's close code: 1001 is *going away*, those from 4000 on are an application's own.
    pub fn code(self) -> u16 {
        match self {
            Self::TooMany => 4000,
            Self::End => 1001,
        }
    }
}

/// All connected pages. The newest one always gets in.
#[derive(Debug, Default)]
pub(crate) struct Pages(Arc<Mutex<Vec<Entry>>>);

#[derive(Debug)]
struct Entry {
    id: u64,
    ended: watch::Sender<Option<Farewell>>,
}

/// A connected page; it leaves when this is dropped.
pub(crate) struct Page {
    pub station: Arc<Station>,
    pub id: u64,
    /// Set when it has to go.
    pub ended: watch::Receiver<Option<Farewell>>,
    all: Arc<Mutex<Vec<Entry>>>,
}

fn lock(entries: &Mutex<Vec<Entry>>) -> MutexGuard<'_, Vec<Entry>> {
    entries.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Pages {
    /// Takes in a page, which drives from now on.
    pub fn enter(&self, station: &Arc<Station>) -> Page {
        let driver = *station.driver.borrow();
        let id = station.enter();
        let (sender, ended) = watch::channel(None);
        let mut entries = lock(&self.0);
        if entries.len() >= MAX_PAGES
            && let Some(at) = entries.iter().position(|entry| entry.id != driver)
        {
            entries.remove(at).ended.send_replace(Some(Farewell::TooMany));
        }
        entries.push(Entry { id, ended: sender });
        Page { station: Arc::clone(station), id, ended, all: Arc::clone(&self.0) }
    }

    /// Tells all pages that the program ends, and waits until they are gone.
    pub async fn end(&self) {
        for entry in lock(&self.0).iter() {
            entry.ended.send_replace(Some(Farewell::End));
        }
        while !lock(&self.0).is_empty() {
            tokio::time::sleep(LOOK).await;
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        lock(&self.all).retain(|entry| entry.id != self.id);
        self.station.leave(self.id);
    }
}
