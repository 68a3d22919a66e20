//! Policy `random`.

use fiatlux_proto::v1::{Observation, SessionInfo};
use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::Rng as _;

use crate::{Command, Policy, PolicyError};

/// Actions drawn uniformly from [-1, 1]. The draw depends on the session's seed and the episode's index alone.
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
        self.generator = Pcg64Mcg::new(u128::from(info.seed) << 64 | u128::from(first.episode));
        // States that differ in few bits start alike; they part within a few draws.
        for _ in 0..16 {
            self.generator.next_u64();
        }
        self.joints = info.joints.len();
        Ok(())
    }

    fn act(&mut self, _observation: &Observation) -> Result<Command, PolicyError> {
        Ok(Command::Action((0..self.joints).map(|_| uniform(self.generator.next_u64())).collect()))
    }
}

/// From -1 to 1, of the 53 highest bits.
fn uniform(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}
