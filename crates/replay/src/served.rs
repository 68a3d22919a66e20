//! The bags that the server shows.

use crate::cache::{PackedReplay, ReplayCache};
use crate::page::Page;
use crate::{Bags, ReplayError};

/// The bags, their pages, and recently requested replays.
#[derive(Debug)]
pub(crate) struct ServedBags {
    pub bags: Bags,
    pub list: Page,
    pub replay: Page,
    pub replays: ReplayCache,
}

impl ServedBags {
    pub fn new(bags: Bags) -> Self {
        let replay = Page::replay(bags.count() > 1);
        Self { bags, list: Page::list(), replay, replays: ReplayCache::default() }
    }

    /// The replay of the bag at an index; `None` if there is no such bag.
    pub fn show(&self, index: usize) -> Option<Result<PackedReplay, ReplayError>> {
        self.bags.file(index).map(|path| self.replays.show(path, None, None))
    }
}
