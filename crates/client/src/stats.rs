//! Statistics on how long steps take.

/// Largest number of samples to keep.
const KEPT: usize = 1 << 17;

/// Round-trip times: from sending an action to the arrival of the observation that answers it.
#[derive(Debug, Clone, Default)]
pub struct RoundTrips {
    seconds: Vec<f32>,
    next: usize,
}

impl RoundTrips {
    /// Adds a time, s; beyond 131,072 of them, the oldest are dropped.
    pub fn push(&mut self, seconds: f64) {
        if self.seconds.len() < KEPT {
            self.seconds.push(seconds as f32);
        } else {
            self.seconds[self.next] = seconds as f32;
            self.next = (self.next + 1) % KEPT;
        }
    }

    /// Number of times that are kept.
    pub fn count(&self) -> usize {
        self.seconds.len()
    }

    /// The time, s, that a share of all samples does not exceed: 0.5 for the median, 0.99 for the 99th percentile.
    /// `None` without samples.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f32::total_cmp);
        let rank = (share.clamp(0.0, 1.0) * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).map(|&seconds| f64::from(seconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles() {
        let mut trips = RoundTrips::default();
        assert_eq!(trips.quantile_s(0.5), None);
        (1..=100).rev().for_each(|i| trips.push(f64::from(i)));
        let quantiles = [0.0, 0.5, 0.99, 1.0].map(|share| trips.quantile_s(share));
        assert_eq!(quantiles, [1.0, 50.0, 99.0, 100.0].map(Some));
    }
}
