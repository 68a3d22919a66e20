//! Statistics of measured times.

use std::time::Duration;

/// Mean and percentiles of the times of single steps, us.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    pub mean_us: f64,
    pub p50_us: f64,
    pub p99_us: f64,
}

impl Times {
    /// The statistics of these samples, which it sorts. Percentiles are by nearest rank. Without samples all are zero.
    pub fn of(samples: &mut [Duration]) -> Self {
        samples.sort_unstable();
        let micros = |time: &Duration| time.as_secs_f64() * 1e6;
        let rank = |percent: usize| (samples.len() * percent).div_ceil(100).saturating_sub(1);
        let at = |percent| samples.get(rank(percent)).map_or(0.0, micros);
        let mean_us = samples.iter().map(micros).sum::<f64>() / samples.len().max(1) as f64;
        Self { mean_us, p50_us: at(50), p99_us: at(99) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_by_nearest_rank() {
        let times = |micros: &[u64]| {
            let mut samples: Vec<Duration> = micros.iter().map(|&us| Duration::from_micros(us)).collect();
            Times::of(&mut samples)
        };
        let near = |times: Times, expected: [f64; 3]| {
            for (a, b) in [times.mean_us, times.p50_us, times.p99_us].into_iter().zip(expected) {
                assert!((a - b).abs() < 1e-9, "{times:?} is not {expected:?}");
            }
        };
        near(times(&[]), [0.0, 0.0, 0.0]);
        near(times(&[7]), [7.0, 7.0, 7.0]);
        near(times(&[4, 1, 3, 2]), [2.5, 2.0, 4.0]);
        near(times(&(1..=200).rev().collect::<Vec<_>>()), [100.5, 100.0, 198.0]);
    }
}
