//! The digest chain over rows: what "bit for bit the same" means.

use sha2::{Digest, Sha256};

use crate::errand::manifest;
use crate::row::Row;

/// A SHA-256 chain: `digest(k) = SHA-256(digest(k - 1), row k)`, started by `SHA-256(layout, 0, context)`. The layout is the name of
/// [`Manifest::layout`](crate::Manifest), so that digests of different layouts never meet. A row is its numbers in the order of
/// [`Row::visit`], as little-endian f64, counts and flags included.
#[derive(Debug, Clone)]
pub struct RowDigest {
    link: [u8; 32],
    numbers: Vec<[u8; 8]>,
}

impl RowDigest {
    /// Starts a chain; `context` is whatever else must be equal (task, seeds, config, gains, model).
    pub fn new(context: &[u8]) -> Self {
        let mut hash = Sha256::new();
        hash.update(&manifest().layout);
        hash.update([0]);
        hash.update(context);
        Self { link: hash.finalize().into(), numbers: Vec::with_capacity(1024) }
    }

    /// Continues a chain from a link, such as its start, in the form of [`RowDigest::hex`]; `None` for any other text.
    pub fn from_hex(link: &str) -> Option<Self> {
        let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
        let pair = |pair: &[u8]| Some(digit(*pair.first()?)? << 4 | digit(*pair.get(1)?)?);
        let bytes: Option<Vec<u8>> = link.as_bytes().chunks(2).map(pair).collect();
        Some(Self { link: bytes?.try_into().ok()?, numbers: Vec::with_capacity(1024) })
    }

    /// Continues the chain with the numbers of a row.
    pub fn push(&mut self, row: &Row) {
        self.numbers.clear();
        let numbers = &mut self.numbers;
        row.visit(&mut |_, list| numbers.extend(list.iter().map(|number| number.to_le_bytes())));
        self.link = Sha256::new().chain_update(self.link).chain_update(self.numbers.as_flattened()).finalize().into();
    }

    /// The digest of all rows so far.
    pub fn bytes(&self) -> [u8; 32] {
        self.link
    }

    /// The digest in hexadecimal.
    pub fn hex(&self) -> String {
        self.link.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}
