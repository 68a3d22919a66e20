//! Links of clients to runs, and what they ask for.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};

use fiatlux_proto::Bytes;
use fiatlux_proto::v3::RunRequest;

use super::gate::Gate;
use super::lock;
use super::opens::Digest;
use super::runs::Run;

/// Largest number of links to keep; a client whose link is forgotten greets again.
const MAX_LINKS: usize = 1024;

/// A client of a run that has proved that it holds the run's key.
pub(super) struct Link {
    pub run: Arc<Run>,
    pub peer: String,
    pub limit: Option<usize>,
    pub gate: Gate,
}

/// The links of a server, by their ids.
#[derive(Default)]
pub(super) struct Links(Mutex<LinkTable>);

#[derive(Default)]
struct LinkTable {
    links: BTreeMap<String, Arc<Link>>,
    /// Their ids, oldest first.
    order: VecDeque<String>,
}

impl Links {
    pub fn get(&self, id: &str) -> Option<Arc<Link>> {
        lock(&self.0).links.get(id).cloned()
    }

    pub fn add(&self, id: String, link: Link) {
        let LinkTable { links, order } = &mut *lock(&self.0);
        links.insert(id.clone(), Arc::new(link));
        order.push_back(id);
        if order.len() > MAX_LINKS
            && let Some(oldest) = order.pop_front()
        {
            links.remove(&oldest);
        }
    }
}

/// A request to a run, for the thread that serves runs.
pub(super) enum RunJob {
    /// A greeting, with its payload, its attachment and the digest that identifies it.
    Greeting(Box<RunRequest>, Bytes, Vec<u8>, Digest),
    /// A request over a link, with its payload and number.
    Ask(Box<RunRequest>, Bytes, Arc<Link>, u64),
}
