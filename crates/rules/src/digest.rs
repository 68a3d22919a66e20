//! The digest chain over rows.

use fiatlux_judge::DigestChain;

use crate::errand::manifest;
use crate::row::Row;

/// A [`DigestChain`] over the numbers of rows in the order of [`Row::visit`], counts and flags included, in the layout of
/// [`Manifest::layout`](crate::Manifest).
#[derive(Debug, Clone)]
pub struct RowDigest(DigestChain);

impl RowDigest {
    /// Starts a chain; `context` is whatever else must be equal (task, seeds, config, gains, model).
    pub fn new(context: &[u8]) -> Self {
        Self(DigestChain::new(&manifest().layout, context))
    }

    /// Continues a chain from a link, such as its start, in the form of [`RowDigest::hex`]; `None` for any other text.
    pub fn from_hex(link: &str) -> Option<Self> {
        DigestChain::from_hex(link).map(Self)
    }

    /// Continues the chain with the numbers of a row.
    pub fn push(&mut self, row: &Row) {
        row.visit(&mut |_, numbers| self.0.extend(numbers));
        self.0.end_row();
    }

    /// The digest of all rows so far.
    pub fn bytes(&self) -> [u8; 32] {
        self.0.bytes()
    }

    /// The digest in hexadecimal.
    pub fn hex(&self) -> String {
        self.0.hex()
    }
}
