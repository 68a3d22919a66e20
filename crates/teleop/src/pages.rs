//! The pages that are connected.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::station::Station;

/// Most pages at once.
const MAX_PAGES: usize = 16;
/// Time between two looks whether all pages are gone.
const LOOK: Duration = Duration::from_millis(5);

/// Why the server ends the connection of a page. Pages know the codes: they do not come back by themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Farewell {
    /// Others came, and it was the one that sent too much, or else had sent nothing for longest, and did not drive.
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
    activity: Arc<Mutex<Activity>>,
}

/// Recent activity of a page, by what it has sent.
#[derive(Debug)]
struct Activity {
    /// It has spent its budget: its messages wait.
    is_held_up: bool,
    last: Instant,
}

/// A connected page; it leaves when this is dropped.
pub(crate) struct Page {
    pub station: Arc<Station>,
    pub id: u64,
    /// Set when it has to go.
    pub ended: watch::Receiver<Option<Farewell>>,
    activity: Arc<Mutex<Activity>>,
    all: Arc<Mutex<Vec<Entry>>>,
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Pages {
    /// Takes in a page, which drives from now on.
    pub fn enter(&self, station: &Arc<Station>) -> Page {
        let driver = *station.driver.borrow();
        let id = station.enter();
        let (sender, ended) = watch::channel(None);
        let activity = Arc::new(Mutex::new(Activity { is_held_up: false, last: Instant::now() }));
        let mut entries = lock(&self.0);
        let idlest = entries.iter().enumerate().filter(|(_, entry)| entry.id != driver).max_by_key(|(at, entry)| {
            let activity = lock(&entry.activity);
            // Of equal ones the oldest.
            (activity.is_held_up, activity.last.elapsed(), std::cmp::Reverse(*at))
        });
        if let Some((at, _)) = idlest
            && entries.len() >= MAX_PAGES
        {
            entries.remove(at).ended.send_replace(Some(Farewell::TooMany));
        }
        entries.push(Entry { id, ended: sender, activity: Arc::clone(&activity) });
        Page { station: Arc::clone(station), id, ended, activity, all: Arc::clone(&self.0) }
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

impl Page {
    /// Notes that it has sent something, and whether more of it has to wait.
    pub fn has_sent(&self, is_held_up: bool) {
        *lock(&self.activity) = Activity { is_held_up, last: Instant::now() };
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        lock(&self.all).retain(|entry| entry.id != self.id);
        self.station.leave(self.id);
    }
}
