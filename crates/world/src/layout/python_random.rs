//! The parts of Python's `random.Random` that the published rooms need: the generator, its seeding by a whole number,
//! and how draws are made from its words.

use rand_mt::Mt;

/// The numbers of `random.Random(seed)`.
pub(super) struct PythonRandom(Mt);

impl PythonRandom {
    /// Python seeds by the 32-bit words of the number, lowest first, without leading zeros.
    pub(super) fn new(seed: u64) -> Self {
        let words = [seed as u32, (seed >> 32) as u32];
        let used = if words[1] == 0 { 1 } else { 2 };
        Self(Mt::new_with_key(words.into_iter().take(used)))
    }

    /// `random()`: uniform in [0, 1), 53 bits of two words.
    pub(super) fn random(&mut self) -> f64 {
        let (high, low) = (self.0.next_u32() >> 5, self.0.next_u32() >> 6);
        const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
        (f64::from(high) * 67_108_864.0 + f64::from(low)) * SCALE
    }

    /// `uniform(low, high)`: uniform between `low` and `high`, from one `random()`.
    pub(super) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random()
    }

    /// `choice(items)`: takes as many bits of a word as the number of items has, and repeats until they select an item.
    pub(super) fn choice<T: Copy, const N: usize>(&mut self, items: [T; N]) -> T {
        const { assert!(N > 0 && N < 1 << 31) };
        let shift = (N as u32).leading_zeros();
        loop {
            let index = (self.0.next_u32() >> shift) as usize;
            if index < N {
                return items[index];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Printed by Python 3.11: `r = random.Random(seed); [r.random(), r.uniform(-3, 5), *(r.choice("abc") for _ in "12345")]`.
    #[test]
    fn numbers_are_pythons() {
        let cases = [
            (0, 0.8444218515250481, 3.06363522352242, "babcb"),
            (1, 0.13436424411240122, 3.7794698954978614, "ababb"),
            (4294967295, 0.6353574441341173, -1.3744004836473795, "ccbcb"),
            (4294967296, 0.11299430095636409, 0.3426309189034269, "aacbc"),
            (18446744073709551615, 0.021825695401270107, -0.2952373851089938, "abcab"),
        ];
        for (seed, unit, uniform, letters) in cases {
            let mut random = PythonRandom::new(seed);
            assert_eq!((random.random(), random.uniform(-3.0, 5.0)), (unit, uniform), "seed {seed}");
            let chosen: String = (0..5).map(|_| random.choice(['a', 'b', 'c'])).collect();
            assert_eq!(chosen, letters, "seed {seed}");
        }
    }
}
