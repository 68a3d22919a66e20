//! Sets of degrees of freedom.

use std::ops::{BitAnd, BitAndAssign, BitOr, BitOrAssign, Not};

/// Bits of one word.
const WORD: usize = u128::BITS as usize;

/// Most words of a set.
pub(crate) const MAX_WORDS: usize = 2;

/// A set of indices below `128 W`. Models of up to 128 degrees of freedom take one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RowSet<const W: usize>([u128; W]);

impl<const W: usize> RowSet<W> {
    pub const EMPTY: Self = Self([0; W]);

    /// All indices below one.
    #[inline(always)]
    pub fn below(index: usize) -> Self {
        Self(std::array::from_fn(|word| match index.saturating_sub(word * WORD) {
            0 => 0,
            bits if bits >= WORD => u128::MAX,
            bits => (1 << bits) - 1,
        }))
    }

    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|&word| word == 0)
    }

    #[inline(always)]
    pub fn contains(&self, index: usize) -> bool {
        self.0.get(index / WORD).is_some_and(|word| word >> (index % WORD) & 1 == 1)
    }

    pub fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    #[inline(always)]
    pub fn first(&self) -> Option<usize> {
        let word = self.0.iter().position(|&word| word != 0)?;
        Some(word * WORD + self.0[word].trailing_zeros() as usize)
    }

    #[inline(always)]
    pub fn last(&self) -> Option<usize> {
        let word = self.0.iter().rposition(|&word| word != 0)?;
        Some(word * WORD + WORD - 1 - self.0[word].leading_zeros() as usize)
    }

    #[inline(always)]
    pub fn remove(&mut self, index: usize) {
        self.0[index / WORD] &= !(1 << (index % WORD));
    }

    #[inline(always)]
    pub fn insert(&mut self, index: usize) {
        self.0[index / WORD] |= 1 << (index % WORD);
    }

    #[inline(always)]
    fn zip(self, other: Self, of: impl Fn(u128, u128) -> u128) -> Self {
        Self(std::array::from_fn(|word| of(self.0[word], other.0[word])))
    }
}

impl<const W: usize> BitAnd for RowSet<W> {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        self.zip(other, |a, b| a & b)
    }
}

impl<const W: usize> BitOr for RowSet<W> {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        self.zip(other, |a, b| a | b)
    }
}

impl<const W: usize> BitAndAssign for RowSet<W> {
    #[inline(always)]
    fn bitand_assign(&mut self, other: Self) {
        *self = *self & other;
    }
}

impl<const W: usize> BitOrAssign for RowSet<W> {
    #[inline(always)]
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

impl<const W: usize> Not for RowSet<W> {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(self.0.map(|word| !word))
    }
}

/// Its indices, ascending.
impl<const W: usize> IntoIterator for RowSet<W> {
    type Item = usize;
    type IntoIter = Indices<W>;

    #[inline(always)]
    fn into_iter(self) -> Indices<W> {
        Indices(self)
    }
}

pub(crate) struct Indices<const W: usize>(RowSet<W>);

impl<const W: usize> Iterator for Indices<W> {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        let first = self.0.first()?;
        self.0.remove(first);
        Some(first)
    }
}

impl<const W: usize> DoubleEndedIterator for Indices<W> {
    #[inline(always)]
    fn next_back(&mut self) -> Option<usize> {
        let last = self.0.last()?;
        self.0.remove(last);
        Some(last)
    }
}
