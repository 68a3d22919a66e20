//! Sets of degrees of freedom.

use std::ops::{BitAnd, BitAndAssign, BitOr, BitOrAssign, Not, Range};

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
    pub fn last(&self) -> Option<usize> {
        let word = self.0.iter().rposition(|&word| word != 0)?;
        Some(word * WORD + WORD - 1 - self.0[word].leading_zeros() as usize)
    }

    /// The first run of indices that starts at `from` or after it.
    pub fn run_from(&self, from: usize) -> Option<Range<usize>> {
        let find = |from: usize, flip: u128| {
            (from / WORD..W).find_map(|word| {
                let beyond = u128::MAX << from.saturating_sub(word * WORD);
                let bits = (self.0[word] ^ flip) & beyond;
                (bits != 0).then(|| word * WORD + bits.trailing_zeros() as usize)
            })
        };
        let start = find(from, 0)?;
        Some(start..find(start, u128::MAX).unwrap_or(W * WORD))
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
        let RowSet(words) = &mut self.0;
        let word = words.iter().position(|&word| word != 0)?;
        let first = words[word].trailing_zeros() as usize;
        words[word] &= words[word] - 1;
        Some(word * WORD + first)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a plain list of flags, with runs across the words' border.
    #[test]
    fn runs_indices_and_bounds_are_those_of_flags() {
        let inside = |k: usize| (3..7).contains(&k) || (120..140).contains(&k) || k == 200 || k >= 250;
        let indices: Vec<usize> = (0..256).filter(|&k| inside(k)).collect();
        let mut set = RowSet::<2>::EMPTY;
        indices.iter().for_each(|&k| set.insert(k));
        assert!((0..300).all(|k| set.contains(k) == (k < 256 && inside(k))));
        assert_eq!(set.into_iter().collect::<Vec<_>>(), indices);
        let mut reversed: Vec<usize> = set.into_iter().rev().collect();
        reversed.reverse();
        assert_eq!(reversed, indices);
        assert_eq!((set.len(), set.last()), (indices.len(), Some(255)));
        let (mut runs, mut from) = (Vec::new(), 0);
        while let Some(run) = set.run_from(from) {
            from = run.end;
            runs.push(run);
        }
        assert_eq!(runs, [3..7, 120..140, 200..201, 250..256]);
        for bound in [0, 5, 128, 130, 256] {
            let below: Vec<usize> = (set & RowSet::below(bound)).into_iter().collect();
            assert_eq!(below, indices.iter().copied().filter(|&k| k < bound).collect::<Vec<_>>(), "{bound}");
        }
    }
}
