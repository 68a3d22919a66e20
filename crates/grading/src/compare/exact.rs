//! An exact test on paired differences.

/// Two-sided p-value of the sign-flip test. If neither policy were better, each difference would be as likely with
/// either sign. The p-value is the share of all `2^n` choices of signs whose sum is at least as far from zero as the
/// one found. Differences of zero change nothing.
///
/// Dynamic programming over the sum of the positive differences counts every choice; nothing is drawn at random. With
/// differences of -1, 0 and 1 this is the sign test, which for paired successes is McNemar's exact test.
pub(super) fn sign_flip_p(differences: &[i64]) -> f64 {
    let unit = differences.iter().fold(0, |unit, difference| greatest_divisor(unit, difference.unsigned_abs()));
    if unit == 0 {
        return 1.0;
    }
    let steps = differences.iter().map(|difference| (difference.unsigned_abs() / unit) as usize);
    let steps: Vec<usize> = steps.filter(|step| *step > 0).collect();
    let total: usize = steps.iter().sum();
    let found = (differences.iter().sum::<i64>().unsigned_abs() / unit) as usize;
    if found == 0 {
        return 1.0;
    }

    // Entry k is the probability that the differences taken as positive sum to k steps.
    let mut share = vec![0.0; total + 1];
    share[0] = 1.0;
    let mut reached = 0;
    for step in steps {
        reached += step;
        for sum in (0..=reached).rev() {
            let with = if sum >= step { share[sum - step] } else { 0.0 };
            share[sum] = 0.5 * (share[sum] + with);
        }
    }
    // The signed sum is twice that sum less the total; both tails are equal.
    let tail: f64 = share[(total + found) / 2..].iter().sum();
    (2.0 * tail).min(1.0)
}

fn greatest_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choose(n: u32, k: u32) -> f64 {
        (0..k).map(|i| f64::from(n - i) / f64::from(i + 1)).product()
    }

    /// Compares with the binomial sum, which holds if all differences have one size.
    #[test]
    fn equal_differences_give_the_sign_test() {
        for (positive, negative) in [(1, 0), (5, 0), (8, 2), (2, 8), (3, 3), (48, 0), (30, 18), (100, 60)] {
            let n = positive + negative;
            let differences: Vec<i64> = (0..n).map(|i| if i < positive { 7 } else { -7 }).chain([0, 0, 0]).collect();
            let tail: f64 = (0..=positive.min(negative)).map(|k| choose(n, k)).sum();
            let expected = (2.0 * tail * 0.5_f64.powi(n as i32)).min(1.0);
            let p = sign_flip_p(&differences);
            assert!((p / expected - 1.0).abs() < 1e-12, "{positive} and {negative}: {p}, not {expected}");
        }
        // 10 discordant pairs, 9 to 1: 2 (1 + 10) / 1024.
        assert_eq!(sign_flip_p(&[1, 1, 1, 1, 1, 1, 1, 1, 1, -1]), 22.0 / 1024.0);
    }

    /// Compares with all choices of signs, one by one.
    #[test]
    fn unequal_differences_give_what_enumeration_gives() {
        let cases: [&[i64]; 5] = [
            &[1, 2, 3, 4, 5, 6],
            &[12, -15, 20, 30, 60, -60, 45],
            &[630, 840, -504, 1260, 2520, 0, 2520, 315],
            &[2, 2, -1, 3, 3, 3, -4, 9, 1, 1, -2],
            &[-5],
        ];
        for differences in cases {
            let found = differences.iter().sum::<i64>().abs();
            let n = differences.len();
            let far = (0_u32..1 << n).filter(|signs| {
                let signed = |(i, d): (usize, &i64)| if signs >> i & 1 == 1 { *d } else { -d };
                differences.iter().enumerate().map(signed).sum::<i64>().abs() >= found
            });
            let expected = far.count() as f64 / f64::from(1_u32 << n);
            assert_eq!(sign_flip_p(differences), expected, "{differences:?}");
        }
    }

    /// 1 to n, all of one sign: only the mirror image is as far from zero, as in Wilcoxon's table.
    #[test]
    fn one_sided_results_are_as_unlikely_as_can_be() {
        for n in [1_i32, 5, 20, 48] {
            let differences: Vec<i64> = (1..=i64::from(n)).collect();
            assert_eq!(sign_flip_p(&differences), 2.0 * 0.5_f64.powi(n));
        }
        assert_eq!(sign_flip_p(&[]), 1.0);
        assert_eq!(sign_flip_p(&[0, 0]), 1.0);
        assert_eq!(sign_flip_p(&[3, -3]), 1.0);
    }
}
