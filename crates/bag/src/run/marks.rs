//! Short digests along an episode, so that a retry that diverges from the first attempt is noticed early.

use data_encoding::HEXLOWER;
use serde::{Deserialize, Serialize};

/// Maximum number of marks of an attempt. Beyond it every second one is dropped: 6,000 rows keep one in 16.
const MAX_MARKS: usize = 512;

const DIGITS: usize = 8;

/// The first bytes of the digest at steps 0, `every`, 2 `every`, and so on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marks {
    every: u64,
    /// The marks in order, [`DIGITS`] each.
    hex: String,
}

impl Default for Marks {
    fn default() -> Self {
        Self { every: 1, hex: String::new() }
    }
}

impl Marks {
    /// Takes the digest of the rows up to a step. Steps come in order, from 0 on.
    pub fn push(&mut self, step: u64, digest: &[u8; 32]) {
        if self.hex.len() >= MAX_MARKS * DIGITS {
            let marks = self.hex.as_bytes().chunks(2 * DIGITS).flat_map(|two| &two[..DIGITS]);
            self.hex = marks.map(|digit| char::from(*digit)).collect();
            self.every = self.every.saturating_mul(2);
        }
        let place = (self.hex.len() / DIGITS) as u64;
        if place.checked_mul(self.every) == Some(step) {
            self.hex.push_str(&mark(digest));
        }
    }

    /// False if the digest of the rows up to this step differs from the marked one. Steps without a mark agree.
    pub fn agrees(&self, step: u64, digest: &[u8; 32]) -> bool {
        if !step.is_multiple_of(self.every) {
            return true;
        }
        let at = usize::try_from(step / self.every).ok().and_then(|place| place.checked_mul(DIGITS));
        let marked = at.and_then(|at| self.hex.get(at..at.checked_add(DIGITS)?));
        marked.is_none_or(|marked| marked == mark(digest))
    }

    pub(super) fn check(&self) -> Result<(), String> {
        let fits = self.every > 0
            && self.hex.len() <= MAX_MARKS * DIGITS
            && self.hex.len().is_multiple_of(DIGITS)
            && self.hex.bytes().all(|byte| byte.is_ascii_hexdigit());
        if fits { Ok(()) } else { Err("the marks of the attempt are not valid".into()) }
    }
}

fn mark(digest: &[u8; 32]) -> String {
    HEXLOWER.encode(&digest[..DIGITS / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn digest(step: u64) -> [u8; 32] {
        let mut digest = [7; 32];
        digest[..8].copy_from_slice(&step.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes());
        digest
    }

    /// Guards that an attempt of any length has few marks, and that a divergence is noticed at the next one.
    #[test]
    fn marks_are_few_and_see_who_leaves_the_way() {
        for (steps, every) in [(10, 1), (511, 1), (512, 2), (6000, 16), (72_000, 256)] {
            let mut marks = Marks::default();
            (0..=steps).for_each(|step| marks.push(step, &digest(step)));
            assert_eq!((marks.every, marks.check()), (every, Ok(())), "{steps}");
            assert_eq!((marks.hex.len() / DIGITS) as u64, steps / every + 1);
            assert!((0..=2 * steps).all(|step| step > steps || marks.agrees(step, &digest(step))));
            let seen: Vec<u64> = (0..=steps).filter(|step| !marks.agrees(*step, &digest(step + 1))).collect();
            assert!(seen.iter().copied().eq((0..=steps).step_by(every as usize)), "{steps}");
            assert!(marks.agrees(u64::MAX, &digest(0)), "there is no mark");
        }
    }
}
