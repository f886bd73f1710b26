//! The curve from a score's figure to the probability of success: a logistic one, as Platt (1999) fits it.

use graspd_hands::Confidence;

use super::collect::Sample;

/// Fewer successes, or fewer failures, than this say too little about a hand of its own.
pub const LEAST_OF_A_KIND: usize = 8;
/// The slope of a figure that says nothing about success, or says the opposite: the order of a ranking is kept.
const LEAST_SLOPE: f64 = 0.5;
/// Newton's steps; a logistic curve of two numbers needs about six.
const MOST_STEPS: usize = 50;

/// Fits slope and intercept of `p = 1 / (1 + exp(−(slope · figure + intercept)))` by maximum likelihood with Platt's
/// targets, (n₊ + 1) / (n₊ + 2) for successes and 1 / (n₋ + 2) for failures, so that a few samples all of one kind
/// promise neither certain success nor certain failure. `None` with fewer than [`LEAST_OF_A_KIND`] of both together.
///
/// The slope is at least 0.5: probabilities keep the order of figures.
pub fn fit<'a>(samples: impl IntoIterator<Item = &'a Sample>) -> Option<Confidence> {
    let samples: Vec<(f64, bool)> = samples.into_iter().map(|s| (s.figure, s.held())).collect();
    if samples.len() < 2 * LEAST_OF_A_KIND {
        return None;
    }
    let held = samples.iter().filter(|s| s.1).count() as f64;
    let lost = samples.len() as f64 - held;
    let target = |good: bool| if good { (held + 1.0) / (held + 2.0) } else { 1.0 / (lost + 2.0) };
    // About the mean, where slope and intercept hardly depend on each other.
    let mean = samples.iter().map(|s| s.0).sum::<f64>() / samples.len() as f64;
    let points: Vec<(f64, f64)> = samples.iter().map(|&(x, good)| (x - mean, target(good))).collect();
    let (slope, middle) = maximum(&points, None);
    let (slope, middle) =
        if slope < LEAST_SLOPE { maximum(&points, Some(LEAST_SLOPE)) } else { (slope, middle) };
    Some(Confidence { slope, intercept: middle - slope * mean })
}

/// Newton's method with halved steps where a whole one would not lower the loss; the slope may be given.
fn maximum(points: &[(f64, f64)], fixed: Option<f64>) -> (f64, f64) {
    let loss = |slope: f64, intercept: f64| -> f64 {
        let of_point = |&(x, t): &(f64, f64)| {
            let z = slope * x + intercept;
            // ln(1 + e^z) − t·z without overflow.
            z.max(0.0) + (-z.abs()).exp().ln_1p() - t * z
        };
        points.iter().map(of_point).sum()
    };
    let (mut slope, mut intercept) = (fixed.unwrap_or(1.0), 0.0);
    for _ in 0..MOST_STEPS {
        let (mut ga, mut gb, mut haa, mut hab, mut hbb) = (0.0, 0.0, 1e-9, 0.0, 1e-9);
        for &(x, t) in points {
            let p = 1.0 / (1.0 + (-(slope * x + intercept)).exp());
            let w = p * (1.0 - p);
            ga += (p - t) * x;
            gb += p - t;
            haa += w * x * x;
            hab += w * x;
            hbb += w;
        }
        let (da, db) = match fixed {
            Some(_) => (0.0, gb / hbb),
            None => {
                let det = haa * hbb - hab * hab;
                ((hbb * ga - hab * gb) / det, (haa * gb - hab * ga) / det)
            }
        };
        let now = loss(slope, intercept);
        let mut share = 1.0;
        while share > 1e-6 && loss(slope - share * da, intercept - share * db) > now {
            share *= 0.5;
        }
        slope -= share * da;
        intercept -= share * db;
        if (share * da).abs() + (share * db).abs() < 1e-9 {
            break;
        }
    }
    (slope, intercept)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::evaluate::{Class, Setup};

    pub(crate) fn sample(figure: f64, held: bool) -> Sample {
        let class = if held { Class::Success } else { Class::LostLifting };
        let (hand, setup) = ("hand".to_owned(), Setup::Single);
        Sample { hand, setup, run: 0, rank: 0, figure, score: figure, class }
    }

    /// Figures from 0 to 1, held as often as the curve says.
    fn drawn(truth: Confidence, count: usize) -> Vec<Sample> {
        let golden = 0.618_033_988_749_894_9;
        (0..count)
            .map(|i| {
                let figure = i as f64 / count as f64;
                let chance = (i as f64 * golden).fract();
                sample(figure, chance < truth.probability(figure))
            })
            .collect()
    }

    #[test]
    fn a_known_curve_is_found_again() {
        let truth = Confidence { slope: 6.0, intercept: -2.0 };
        let found = fit(&drawn(truth, 20_000)).unwrap();
        assert!((found.slope - 6.0).abs() < 0.2 && (found.intercept + 2.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn all_of_one_kind_promises_no_certainty() {
        let held: Vec<Sample> = (0..40).map(|i| sample(0.4 + 0.01 * f64::from(i), true)).collect();
        let found = fit(&held).unwrap();
        let p = found.probability(0.6);
        assert!(p > 0.9 && p < 0.999, "{p}");
        assert!(fit(&held[..5]).is_none(), "too few");
    }

    #[test]
    fn a_figure_that_misleads_keeps_its_order() {
        let upside_down: Vec<Sample> = (0..100).map(|i| sample(f64::from(i) / 100.0, i < 50)).collect();
        let found = fit(&upside_down).unwrap();
        assert_eq!(found.slope, LEAST_SLOPE);
        let mean = (0..100).map(|i| found.probability(f64::from(i) / 100.0)).sum::<f64>() / 100.0;
        assert!((mean - 0.5).abs() < 1e-6, "the mean is that of the data: {mean}");
    }

    proptest! {
        #[test]
        fn every_fit_is_finite_rises_and_has_the_mean_of_its_targets(
            figures in proptest::collection::vec((0.0..1.0_f64, any::<bool>()), 16..200)
        ) {
            let samples: Vec<Sample> = figures.iter().map(|&(f, held)| sample(f, held)).collect();
            let found = fit(&samples).unwrap();
            prop_assert!(found.slope.is_finite() && found.intercept.is_finite() && found.slope >= LEAST_SLOPE);
            let n = samples.len() as f64;
            let held = samples.iter().filter(|s| s.held()).count() as f64;
            let targets = held * (held + 1.0) / (held + 2.0) + (n - held) / (n - held + 2.0);
            let stated: f64 = samples.iter().map(|s| found.probability(s.figure)).sum();
            prop_assert!((stated - targets).abs() < 1e-3 * n, "{stated} {targets}");
        }
    }
}
