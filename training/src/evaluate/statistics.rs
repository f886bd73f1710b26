//! Plain statistics: shares with their confidence intervals, quantiles.

use serde::{Deserialize, Serialize};

/// Quantile of the standard normal distribution for a two-sided interval of 95 %.
const Z_95: f64 = 1.959_963_984_540_054;

/// A share with its confidence interval, each 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// Successes over trials; 0 without trials.
    pub rate: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// The share of successes with its 95 % Wilson score interval (Wilson 1927, without continuity correction).
/// Without trials nothing is known: the interval is 0 to 1.
pub fn wilson(successes: usize, trials: usize) -> Share {
    if trials == 0 {
        return Share { rate: 0.0, low: 0.0, high: 1.0 };
    }
    let n = trials as f64;
    let p = (successes as f64 / n).min(1.0);
    let z2 = Z_95 * Z_95;
    let middle = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    // At the ends the interval touches 0 and 1 exactly; rounding must not leave it short of them.
    let low = if successes == 0 { 0.0 } else { (middle - half).max(0.0) };
    let high = if successes >= trials { 1.0 } else { (middle + half).min(1.0) };
    Share { rate: p, low, high }
}

/// Probability that pairs which came out differently fall at least as unevenly by chance (McNemar's exact test, two-sided);
/// `only_a` of them succeeded in the first way alone, `only_b` in the second. 1 where none did.
pub fn mcnemar(only_a: usize, only_b: usize) -> f64 {
    let (least, n) = (only_a.min(only_b), only_a + only_b);
    // Terms of the binomial distribution with one half, by logarithms: no power of two underflows.
    let half_n = n as f64 * std::f64::consts::LN_2;
    let mut log_choose = 0.0;
    let mut tail = 0.0;
    for k in 0..=least {
        if k > 0 {
            log_choose += ((n - k + 1) as f64).ln() - (k as f64).ln();
        }
        tail += f64::exp(log_choose - half_n);
    }
    (2.0 * tail).min(1.0)
}

/// A quantile, interpolated between neighbours; `None` without values.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let low = at.floor() as usize;
    let high = (low + 1).min(last);
    Some(sorted[low] + (sorted[high] - sorted[low]) * (at - low as f64))
}

/// The arithmetic mean; `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn wilson_gives_published_intervals() {
        // Newcombe (1998), Table I, method 3.
        for (successes, trials, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let share = wilson(successes, trials);
            assert!((share.low - low).abs() < 1e-4 && (share.high - high).abs() < 1e-4, "{share:?}");
        }
        assert_eq!(wilson(25, 25).high, 1.0);
        assert_eq!(wilson(0, 0), Share { rate: 0.0, low: 0.0, high: 1.0 });
    }

    #[test]
    fn mcnemar_gives_known_probabilities() {
        for (a, b, p) in
            [(0, 0, 1.0), (5, 5, 1.0), (0, 6, 0.03125), (1, 9, 0.021_484_375), (9, 1, 0.021_484_375)]
        {
            assert!((mcnemar(a, b) - p).abs() < 1e-12, "{a} {b}: {}", mcnemar(a, b));
        }
        assert!(mcnemar(400, 1600) < 1e-100);
    }

    #[test]
    fn quantiles_and_means_of_known_values() {
        let values: Vec<f64> = (0..=100).rev().map(f64::from).collect();
        assert_eq!(quantile(&values, 0.95), Some(95.0));
        assert_eq!(quantile(&[2.0, 1.0], 0.5), Some(1.5));
        assert_eq!(quantile(&[], 0.5), None);
        assert_eq!(mean(&[1.0, 2.0, 6.0]), Some(3.0));
        assert_eq!(mean(&[]), None);
    }

    proptest! {
        #[test]
        fn an_interval_holds_its_rate(trials in 1usize..500, share in 0.0f64..=1.0) {
            let successes = ((trials as f64) * share).round() as usize;
            let s = wilson(successes, trials);
            prop_assert!(0.0 <= s.low && s.low <= s.rate + 1e-12 && s.rate <= s.high + 1e-12 && s.high <= 1.0);
            let more = wilson(successes * 4, trials * 4);
            prop_assert!(more.high - more.low <= s.high - s.low + 1e-12);
        }
    }
}
