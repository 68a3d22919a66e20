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

/// The middle of these numbers, which it sorts, and the interval that has the median of whatever they are drawn from in 95 of 100
/// cases, by rank and without an assumption on how they are spread. Up to five numbers it is all of them; without numbers, zeros.
pub(crate) fn median(numbers: &mut [f64]) -> (f64, [f64; 2]) {
    numbers.sort_unstable_by(f64::total_cmp);
    let Some(last) = numbers.len().checked_sub(1) else { return (0.0, [0.0; 2]) };
    let count = numbers.len() as f64;
    let outside = ((count - 1.96 * count.sqrt()) / 2.0).max(0.0) as usize;
    ((numbers[last / 2] + numbers[last.div_ceil(2)]) / 2.0, [numbers[outside], numbers[last - outside]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_have_the_intervals_of_tables() {
        let of = |count: u32| median(&mut (1..=count).rev().map(f64::from).collect::<Vec<_>>());
        assert_eq!(of(0), (0.0, [0.0, 0.0]));
        assert_eq!(of(1), (1.0, [1.0, 1.0]));
        assert_eq!(of(4), (2.5, [1.0, 4.0]));
        // The usual table of ranks for 95 %.
        assert_eq!(of(30), (15.5, [10.0, 21.0]));
        assert_eq!(of(50), (25.5, [19.0, 32.0]));
    }

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
