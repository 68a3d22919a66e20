//! Rates and their intervals.

/// 97.5 % quantile of the normal distribution.
const Z_95: f64 = 1.959963984540054;

/// A count of hits out of trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rate {
    /// Number of times that it happened.
    pub hits: u64,
    /// Number of times that it could have happened.
    pub trials: u64,
}

impl Rate {
    /// Counts the outcomes that are true.
    pub fn of(outcomes: impl IntoIterator<Item = bool>) -> Self {
        outcomes
            .into_iter()
            .fold(Self::default(), |rate, hit| Self { hits: rate.hits + u64::from(hit), trials: rate.trials + 1 })
    }

    /// Share of hits; `None` without trials.
    pub fn value(&self) -> Option<f64> {
        (self.trials > 0).then(|| self.hits as f64 / self.trials as f64)
    }

    /// Wilson's 95 % interval; `None` without trials.
    pub fn interval(&self) -> Option<[f64; 2]> {
        wilson_interval(self.hits, self.trials)
    }
}

/// Wilson's score interval of a binomial proportion at 95 % confidence; `None` without trials or with more hits than
/// trials.
pub fn wilson_interval(hits: u64, trials: u64) -> Option<[f64; 2]> {
    if trials == 0 || hits > trials {
        return None;
    }
    let (n, p) = (trials as f64, hits as f64 / trials as f64);
    let z2 = Z_95 * Z_95;
    let center = p + z2 / (2.0 * n);
    let half = Z_95 * libm::sqrt(p * (1.0 - p) / n + z2 / (4.0 * n * n));
    let bound = |value: f64| (value / (1.0 + z2 / n)).clamp(0.0, 1.0);
    // At the ends the bound is exact; rounding would leave it a hair off.
    let low = if hits == 0 { 0.0 } else { bound(center - half) };
    let high = if hits == trials { 1.0 } else { bound(center + half) };
    Some([low, high])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    #[test]
    fn wilson() {
        for (hits, trials, low, high) in
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
        {
            let [l, h] = wilson_interval(hits, trials).expect("trials");
            assert!((l - low).abs() < 6e-5 && (h - high).abs() < 6e-5, "{hits}/{trials}: {l} {h}");
        }
        let [low, high] = wilson_interval(10, 10).expect("trials");
        assert!((low - 1.0 / (1.0 + Z_95 * Z_95 / 10.0)).abs() < 1e-15 && high == 1.0, "{low} {high}");
        assert_eq!((wilson_interval(0, 0), wilson_interval(2, 1)), (None, None));
    }

    #[test]
    fn rate() {
        let rate = Rate::of([true, false, false, true]);
        assert_eq!(rate, Rate { hits: 2, trials: 4 });
        assert_eq!((rate.value(), Rate::default().value()), (Some(0.5), None));
    }
}
