//! The policy `random`.

use fiatlux_proto::v3::{Observation, SessionInfo};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

use fiatlux_client::{Command, Policy, PolicyError};

use crate::entry::Entry;

/// As a program makes it.
pub(crate) const ENTRY: Entry = Entry {
    name: "random",
    does: "uniform in [-1, 1], drawn from the session's seed and the episode's index",
    make: |_| Ok(Box::new(Random::default())),
};

/// Actions drawn uniformly from [-1, 1]. They depend only on the session's seed and the episode's index.
#[derive(Debug)]
pub struct Random {
    generator: Pcg64Mcg,
    joints: usize,
}

impl Default for Random {
    fn default() -> Self {
        Self { generator: Pcg64Mcg::new(0), joints: 0 }
    }
}

impl Policy for Random {
    fn name(&self) -> String {
        "random".into()
    }

    fn reset(&mut self, info: &SessionInfo, first: &Observation) -> Result<(), PolicyError> {
        let seed = mix(info.seed);
        self.generator = Pcg64Mcg::new(u128::from(seed) << 64 | u128::from(mix(seed ^ first.episode)));
        self.joints = info.joints.len();
        Ok(())
    }

    fn act(&mut self, _observation: &Observation) -> Result<Command, PolicyError> {
        Ok(Command::Action((0..self.joints).map(|_| uniform(self.generator.next_u64())).collect()))
    }
}

/// Spreads a number over all bits: the finaliser of SplitMix64 (Steele, Lea and Flood, 2014). Without it, PCG states
/// that differ only in their lowest bit would give the same numbers.
fn mix(number: u64) -> u64 {
    let number = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}

/// A number from -1 to 1, made of the 53 highest bits.
fn uniform(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}
