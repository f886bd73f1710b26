//! The curves from a ranking's figure to the probability of success: logistic ones, as Platt (1999) fits them.

use std::collections::BTreeMap;

use graspd_hands::Confidence;

use super::collect::Sample;

/// Fewer grasps of a hand than this say too little about it.
pub const LEAST_OF_A_HAND: usize = 16;
/// The slope of a figure that says nothing about success, or says the opposite: the order of a ranking is kept.
const LEAST_SLOPE: f64 = 0.5;
/// Newton's steps; logistic curves need about six.
const MOST_STEPS: usize = 50;

/// One hand's grasps: figures about a common middle, and Platt's targets.
struct Group {
    points: Vec<(f64, f64)>,
}

/// Fits `p = 1 / (1 + exp(−(slope · figure + intercept)))` by maximum likelihood: one slope for all hands, an intercept for
/// each with at least [`LEAST_OF_A_HAND`] grasps. A hundred grasps of a hand know how good its grasps are, but hardly
/// how fast that changes with the figure; hands agree in it.
///
/// Targets are Platt's, (n₊ + 1) / (n₊ + 2) for successes and 1 / (n₋ + 2) for failures of the hand, so that a few grasps
/// all of one kind promise neither certain success nor certain failure. The slope is at least 0.5: probabilities keep
/// the order of figures.
pub fn fit_hands<'a>(samples: impl IntoIterator<Item = &'a Sample>) -> BTreeMap<String, Confidence> {
    let mut of_hands: BTreeMap<&str, Vec<(f64, bool)>> = BTreeMap::new();
    for sample in samples {
        of_hands.entry(&sample.hand).or_default().push((sample.figure, sample.held()));
    }
    of_hands.retain(|_, own| own.len() >= LEAST_OF_A_HAND);
    let (middle, groups) = about_the_middle(of_hands.values().map(Vec::as_slice));
    let (slope, intercepts) = curves(&groups);
    let curve = |intercept: &f64| Confidence { slope, intercept: intercept - slope * middle };
    of_hands.into_keys().map(str::to_owned).zip(intercepts.iter().map(curve)).collect()
}

/// One curve for all grasps, whatever the hand; `None` with fewer than [`LEAST_OF_A_HAND`].
pub fn fit_together<'a>(samples: impl IntoIterator<Item = &'a Sample>) -> Option<Confidence> {
    let all: Vec<(f64, bool)> = samples.into_iter().map(|s| (s.figure, s.held())).collect();
    if all.len() < LEAST_OF_A_HAND {
        return None;
    }
    let (middle, groups) = about_the_middle([all.as_slice()]);
    let (slope, intercepts) = curves(&groups);
    intercepts.first().map(|intercept| Confidence { slope, intercept: intercept - slope * middle })
}

/// Slope and intercepts hardly depend on each other where figures are taken from their mean.
fn about_the_middle<'a>(hands: impl IntoIterator<Item = &'a [(f64, bool)]>) -> (f64, Vec<Group>) {
    let hands: Vec<&[(f64, bool)]> = hands.into_iter().collect();
    let count: usize = hands.iter().map(|h| h.len()).sum();
    let middle = hands.iter().flat_map(|h| h.iter()).map(|s| s.0).sum::<f64>() / count.max(1) as f64;
    let group = |own: &&[(f64, bool)]| {
        let held = own.iter().filter(|s| s.1).count() as f64;
        let lost = own.len() as f64 - held;
        let target = |good: bool| if good { (held + 1.0) / (held + 2.0) } else { 1.0 / (lost + 2.0) };
        Group { points: own.iter().map(|&(x, good)| (x - middle, target(good))).collect() }
    };
    (middle, hands.iter().map(group).collect())
}

/// The common slope and each group's intercept.
fn curves(groups: &[Group]) -> (f64, Vec<f64>) {
    let free = maximum(groups, None);
    if free.0 < LEAST_SLOPE { maximum(groups, Some(LEAST_SLOPE)) } else { free }
}

/// Minus the logarithm of the likelihood.
fn loss(groups: &[Group], slope: f64, intercepts: &[f64]) -> f64 {
    let of_group = |(group, intercept): (&Group, &f64)| -> f64 {
        let of_point = |&(x, t): &(f64, f64)| {
            let z = slope * x + intercept;
            // ln(1 + e^z) − t·z without overflow.
            z.max(0.0) + (-z.abs()).exp().ln_1p() - t * z
        };
        group.points.iter().map(of_point).sum()
    };
    groups.iter().zip(intercepts).map(of_group).sum()
}

/// Newton's method with halved steps where a whole one would not lower the loss; the slope may be given. Intercepts touch
/// each other only through the slope, so the system is solved by eliminating them.
fn maximum(groups: &[Group], fixed: Option<f64>) -> (f64, Vec<f64>) {
    let mut slope = fixed.unwrap_or(1.0);
    let mut intercepts = vec![0.0; groups.len()];
    for _ in 0..MOST_STEPS {
        let (mut gradient, mut curvature) = (0.0, 1e-9);
        // Of each group: gradient of its intercept, its own curvature, and that with the slope.
        let mut own = Vec::with_capacity(groups.len());
        for (group, intercept) in groups.iter().zip(&intercepts) {
            let (mut g, mut h, mut cross) = (0.0, 1e-9, 0.0);
            for &(x, t) in &group.points {
                let p = 1.0 / (1.0 + (-(slope * x + intercept)).exp());
                let w = p * (1.0 - p);
                gradient += (p - t) * x;
                curvature += w * x * x;
                g += p - t;
                h += w;
                cross += w * x;
            }
            own.push((g, h, cross));
        }
        let step = if fixed.is_some() {
            0.0
        } else {
            let (g, h) = own.iter().fold((gradient, curvature), |(a, b), &(g, h, cross)| {
                (a - cross * g / h, b - cross * cross / h)
            });
            g / h.max(1e-9)
        };
        let steps: Vec<f64> = own.iter().map(|&(g, h, cross)| (g - cross * step) / h).collect();
        let now = loss(groups, slope, &intercepts);
        let mut share = 1.0;
        let next = loop {
            let moved: Vec<f64> = intercepts.iter().zip(&steps).map(|(b, s)| b - share * s).collect();
            if share < 1e-6 || loss(groups, slope - share * step, &moved) <= now {
                break moved;
            }
            share *= 0.5;
        };
        let largest = steps.iter().fold(step.abs(), |m, s| m.max(s.abs()));
        slope -= share * step;
        intercepts = next;
        if share * largest < 1e-9 {
            break;
        }
    }
    (slope, intercepts)
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
        let found = fit_together(&drawn(truth, 20_000)).unwrap();
        assert!((found.slope - 6.0).abs() < 0.2 && (found.intercept + 2.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn hands_share_a_slope_and_have_their_own_level() {
        let of = |hand: &str, intercept: f64| {
            drawn(Confidence { slope: 5.0, intercept }, 5000)
                .into_iter()
                .map(move |s| {
                    let hand = hand.to_owned();
                    Sample { hand, ..s }
                })
                .collect::<Vec<_>>()
        };
        let found = fit_hands(&[of("good", -1.0), of("poor", -4.0)].concat());
        let (good, poor) = (found["good"], found["poor"]);
        assert_eq!(good.slope, poor.slope);
        assert!((good.slope - 5.0).abs() < 0.3, "{good:?}");
        assert!(
            (good.intercept + 1.0).abs() < 0.2 && (poor.intercept + 4.0).abs() < 0.2,
            "{good:?} {poor:?}"
        );
    }

    #[test]
    fn all_of_one_kind_promises_no_certainty() {
        let held: Vec<Sample> = (0..40).map(|i| sample(0.4 + 0.01 * f64::from(i), true)).collect();
        let found = fit_together(&held).unwrap();
        let p = found.probability(0.6);
        assert!(p > 0.9 && p < 0.999, "{p}");
        assert!(fit_together(&held[..5]).is_none() && fit_hands(&held[..5]).is_empty(), "too few");
    }

    #[test]
    fn a_figure_that_misleads_keeps_its_order() {
        let upside_down: Vec<Sample> = (0..100).map(|i| sample(f64::from(i) / 100.0, i < 50)).collect();
        let found = fit_together(&upside_down).unwrap();
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
            let found = fit_together(&samples).unwrap();
            prop_assert!(found.slope.is_finite() && found.intercept.is_finite() && found.slope >= LEAST_SLOPE);
            let n = samples.len() as f64;
            let held = samples.iter().filter(|s| s.held()).count() as f64;
            let targets = held * (held + 1.0) / (held + 2.0) + (n - held) / (n - held + 2.0);
            let stated: f64 = samples.iter().map(|s| found.probability(s.figure)).sum();
            prop_assert!((stated - targets).abs() < 1e-3 * n, "{stated} {targets}");
        }
    }
}
