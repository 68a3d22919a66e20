//! A limit on how long a bag is read.

use std::fmt;
use std::sync::Arc;

/// A limit on reading, shared by its clones. This crate has no clock; readers of strangers' bags supply one.
#[derive(Clone)]
pub struct Patience(Arc<dyn Fn() -> bool + Send + Sync>);

impl Patience {
    /// Reading ends with [`BagError::Slow`](crate::BagError::Slow) once `goes_on` returns false. It is asked before
    /// each message.
    pub fn new(goes_on: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(goes_on))
    }

    pub fn goes_on(&self) -> bool {
        (self.0)()
    }
}

impl fmt::Debug for Patience {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Patience")
    }
}
