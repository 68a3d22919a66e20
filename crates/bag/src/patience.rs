//! How long a reader of a bag goes on.

use std::fmt;
use std::sync::Arc;

/// Says whether reading goes on; clones ask the same. This crate has no clock: whoever reads strangers' bags brings one.
#[derive(Clone)]
pub struct Patience(Arc<dyn Fn() -> bool + Send + Sync>);

impl Patience {
    /// Reading ends with [`BagError::Slow`](crate::BagError::Slow) once `goes_on` says no. It is asked before each message, for
    /// the first time when reading begins.
    pub fn new(goes_on: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(goes_on))
    }

    /// Whether reading goes on.
    pub fn goes_on(&self) -> bool {
        (self.0)()
    }
}

impl fmt::Debug for Patience {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Patience")
    }
}
