//! Digest chains over rows of numbers: what "bit for bit the same" means.

use sha2::{Digest, Sha256};

/// A SHA-256 chain: `digest(k) = SHA-256(digest(k - 1), row k)`, started by `SHA-256(layout, 0, context)`. A row is its numbers as
/// little-endian f64. Digests of rows of different layouts never meet, if the layouts have different names.
#[derive(Debug, Clone)]
pub struct DigestChain {
    link: [u8; 32],
    numbers: Vec<[u8; 8]>,
}

impl DigestChain {
    /// Starts a chain; `context` is whatever else must be equal.
    pub fn new(layout: &str, context: &[u8]) -> Self {
        Self::from_link(Sha256::new().chain_update(layout).chain_update([0]).chain_update(context).finalize().into())
    }

    /// Continues a chain from a link, such as its start, in the form of [`DigestChain::hex`]; `None` for any other text.
    pub fn from_hex(link: &str) -> Option<Self> {
        let digit = |byte: u8| char::from(byte).to_digit(16).map(|digit| digit as u8);
        let pair = |pair: &[u8]| Some(digit(*pair.first()?)? << 4 | digit(*pair.get(1)?)?);
        let bytes: Option<Vec<u8>> = link.as_bytes().chunks(2).map(pair).collect();
        Some(Self::from_link(bytes?.try_into().ok()?))
    }

    fn from_link(link: [u8; 32]) -> Self {
        Self { link, numbers: Vec::with_capacity(1024) }
    }

    /// Takes the next numbers of a row.
    pub fn extend(&mut self, numbers: &[f64]) {
        self.numbers.extend(numbers.iter().map(|number| number.to_le_bytes()));
    }

    /// Ends a row: all numbers since the last one.
    pub fn end_row(&mut self) {
        self.link = Sha256::new().chain_update(self.link).chain_update(self.numbers.as_flattened()).finalize().into();
        self.numbers.clear();
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
