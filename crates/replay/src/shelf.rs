//! What the server shows.

use crate::page::Page;
use crate::shown::{Desk, Shown};
use crate::{Bags, ReplayError};

/// The bags, their pages, and recently requested replays.
#[derive(Debug)]
pub(crate) struct Shelf {
    pub bags: Bags,
    pub list: Page,
    pub replay: Page,
    pub desk: Desk,
}

impl Shelf {
    pub fn new(bags: Bags) -> Self {
        let replay = Page::replay(bags.count() > 1);
        Self { bags, list: Page::list(), replay, desk: Desk::default() }
    }

    /// The replay of the bag at an index; `None` if there is no such bag.
    pub fn show(&self, index: usize) -> Option<Result<Shown, ReplayError>> {
        self.bags.file(index).map(|path| self.desk.show(path, None, None))
    }
}
