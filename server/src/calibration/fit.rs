//! Learning a calibration from outcomes: beta calibration (Kull, Silva Filho, Flach, AISTATS 2017), held to rise.
//!
//! `logit(share) = a ln s - b ln(1 - s) + c` with `a, b >= 0`: three numbers, so that tens of outcomes are enough, and
//! identity, Platt's curve and flat lines among its shapes. A weak pull of `a` and `b` towards 0 keeps few outcomes that
//! happen to be in order from making a step.

use nalgebra::{Matrix3, Vector3};

use super::{Calibration, WrongCalibration};

/// Fewer outcomes than this teach nothing.
pub const LEAST_OUTCOMES: usize = 30;
/// Fewer successes, or fewer failures, teach nothing either.
pub const LEAST_OF_EACH: usize = 10;
/// Weight of the pull of both slopes towards 0, in outcomes.
const PULL: f64 = 0.5;
/// Scores are kept this far from 0 and 1, where logarithms have no end.
const MARGIN: f64 = 1e-3;
/// Straight pieces of the map.
const PIECES: usize = 64;
/// Parts into which outcomes are put to see what a calibration says of outcomes that it does not know.
const FOLDS: usize = 5;

/// A grasp's score and what became of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// Uncalibrated score, 0 to 1.
    pub score: f64,
    /// It succeeded.
    pub succeeded: bool,
}

/// A calibration and what it is worth.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The calibration.
    pub calibration: Calibration,
    /// Mean squared error of the share against what happened (Brier), of outcomes that were held out: with the
    /// calibration.
    pub brier: f64,
    /// The same for the score as it is.
    pub brier_uncalibrated: f64,
    /// The same for always saying the mean.
    pub brier_of_mean: f64,
}

/// Why nothing was learned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TooLittle {
    /// There are too few outcomes.
    #[error(
        "too few outcomes to learn from: found {outcomes} with {successes} successes and {failures} failures, \
         expected at least {LEAST_OUTCOMES} with {LEAST_OF_EACH} of each"
    )]
    Few {
        /// All.
        outcomes: usize,
        /// Successes.
        successes: usize,
        /// Failures.
        failures: usize,
    },
    /// Higher scores did not succeed more often.
    #[error(
        "higher scores did not succeed more often here: found {outcomes} outcomes in which the score says nothing, \
         expected some relation; no monotone calibration can help"
    )]
    NoRelation {
        /// All.
        outcomes: usize,
    },
    /// The result is not a calibration.
    #[error(transparent)]
    Wrong(#[from] WrongCalibration),
}

/// Learns a calibration; `created_unix_s` is the time of now, seconds since 1970.
///
/// # Errors
/// [`TooLittle`] when outcomes are too few, or say nothing.
pub fn fit(trials: &[Trial], name: &str, created_unix_s: i64) -> Result<Fitted, TooLittle> {
    let successes = trials.iter().filter(|t| t.succeeded).count();
    let failures = trials.len() - successes;
    if trials.len() < LEAST_OUTCOMES || successes.min(failures) < LEAST_OF_EACH {
        return Err(TooLittle::Few { outcomes: trials.len(), successes, failures });
    }
    let curve = Curve::of(trials);
    if curve.a.max(curve.b) < 1e-6 {
        return Err(TooLittle::NoRelation { outcomes: trials.len() });
    }
    let knots = (0..=PIECES).map(|i| {
        let score = i as f64 / PIECES as f64;
        (score, curve.share(score))
    });
    let counts =
        (u32::try_from(trials.len()).unwrap_or(u32::MAX), u32::try_from(successes).unwrap_or(u32::MAX));
    let calibration = Calibration::new(name, counts, created_unix_s, knots.collect())?;
    let (mut brier, mut brier_of_mean) = (0.0, 0.0);
    for fold in 0..FOLDS {
        let part = |inside: bool| -> Vec<Trial> {
            let chosen = trials.iter().enumerate().filter(|(i, _)| (i % FOLDS == fold) == inside);
            chosen.map(|(_, trial)| *trial).collect()
        };
        let (known, held_out) = (part(false), part(true));
        let curve = Curve::of(&known);
        let mean = known.iter().filter(|t| t.succeeded).count() as f64 / known.len() as f64;
        brier += squares(&held_out, |score| curve.share(score));
        brier_of_mean += squares(&held_out, |_| mean);
    }
    let n = trials.len() as f64;
    let brier_uncalibrated = squares(trials, |score| score) / n;
    Ok(Fitted { calibration, brier: brier / n, brier_uncalibrated, brier_of_mean: brier_of_mean / n })
}

fn squares(trials: &[Trial], share: impl Fn(f64) -> f64) -> f64 {
    trials.iter().map(|t| (share(t.score) - f64::from(u8::from(t.succeeded))).powi(2)).sum()
}

/// The three numbers.
#[derive(Debug, Clone, Copy)]
struct Curve {
    a: f64,
    b: f64,
    c: f64,
}

impl Curve {
    /// The most likely curve that rises: where a slope would be negative it is 0, and the others are learned anew.
    fn of(trials: &[Trial]) -> Self {
        let mut free = [true, true];
        loop {
            let curve = Self::with(trials, free);
            match () {
                () if curve.a < 0.0 && curve.a <= curve.b => free[0] = false,
                () if curve.b < 0.0 => free[1] = false,
                () => return curve,
            }
        }
    }

    /// Newton's method on the log likelihood, which is concave.
    fn with(trials: &[Trial], free: [bool; 2]) -> Self {
        const STEPS: usize = 100;
        let mut at = Vector3::zeros();
        let used = Vector3::new(f64::from(u8::from(free[0])), f64::from(u8::from(free[1])), 1.0);
        for _ in 0..STEPS {
            let mut gradient = Vector3::new(-PULL * at.x, -PULL * at.y, 0.0);
            let mut hessian = Matrix3::from_diagonal(&Vector3::new(PULL, PULL, 1e-9));
            for trial in trials {
                let features = features(trial.score).component_mul(&used);
                let p = sigmoid(features.dot(&at));
                gradient += features * (f64::from(u8::from(trial.succeeded)) - p);
                hessian += features * features.transpose() * (p * (1.0 - p)).max(1e-9);
            }
            let Some(step) = hessian.cholesky().map(|h| h.solve(&gradient)) else { break };
            // Far from the end full steps may go too far.
            at += step * (2.0 / step.norm()).min(1.0);
            if step.norm() < 1e-10 {
                break;
            }
        }
        Self { a: at.x, b: at.y, c: at.z }
    }

    fn share(&self, score: f64) -> f64 {
        sigmoid(features(score).dot(&Vector3::new(self.a, self.b, self.c)))
    }
}

fn features(score: f64) -> Vector3<f64> {
    let s = if score.is_nan() { 0.5 } else { score.clamp(MARGIN, 1.0 - MARGIN) };
    Vector3::new(s.ln(), -(1.0 - s).ln(), 1.0)
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Trials whose success is drawn with a known share.
    fn drawn(count: usize, seed: u64, share: impl Fn(f64) -> f64) -> Vec<Trial> {
        let mut state = seed;
        let mut unit = move || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut trial = || {
            let score = 0.2 + 0.75 * unit();
            Trial { score, succeeded: unit() < share(score) }
        };
        (0..count).map(|_| trial()).collect()
    }

    #[test]
    fn the_share_of_a_site_is_found_and_better_than_the_score() {
        // A site where scores promise too much.
        let site = |score: f64| 0.1 + 0.6 * score * score;
        let fitted = fit(&drawn(4000, 1, site), "site", 7).unwrap();
        for score in [0.3, 0.5, 0.7, 0.9] {
            let share = fitted.calibration.share(score);
            assert!((share - site(score)).abs() < 0.05, "{score}: {share}, expected {}", site(score));
        }
        assert!(
            fitted.brier < fitted.brier_uncalibrated - 0.02 && fitted.brier < fitted.brier_of_mean,
            "{fitted:?}"
        );
        assert_eq!(fitted.calibration.outcome_count, 4000);
        let grid: Vec<f64> = (0..=200).map(|i| fitted.calibration.share(f64::from(i) / 200.0)).collect();
        assert!(grid.is_sorted());
    }

    #[test]
    fn what_is_calibrated_already_stays_about_so() {
        let fitted = fit(&drawn(4000, 2, |score| score), "site", 0).unwrap();
        for score in [0.3, 0.5, 0.7, 0.9] {
            assert!((fitted.calibration.share(score) - score).abs() < 0.05, "{fitted:?}");
        }
    }

    #[test]
    fn too_little_is_said_and_not_learned_from() {
        let trials = drawn(29, 3, |score| score);
        assert!(matches!(fit(&trials, "x", 0), Err(TooLittle::Few { outcomes: 29, .. })));
        let lucky: Vec<Trial> =
            (0..100).map(|i| Trial { score: f64::from(i) / 100.0, succeeded: i >= 9 }).collect();
        let error = fit(&lucky, "x", 0).unwrap_err();
        assert!(error.to_string().contains("91 successes and 9 failures"), "{error}");
        let inverted = drawn(400, 4, |score| 1.0 - score);
        assert_eq!(fit(&inverted, "x", 0), Err(TooLittle::NoRelation { outcomes: 400 }));
    }

    #[test]
    fn few_outcomes_in_perfect_order_make_no_step() {
        let perfect: Vec<Trial> =
            (0..40).map(|i| Trial { score: 0.3 + 0.015 * f64::from(i), succeeded: i >= 20 }).collect();
        let calibration = fit(&perfect, "x", 0).unwrap().calibration;
        assert!((0.02..0.5).contains(&calibration.share(0.45)), "{}", calibration.share(0.45));
        assert!((0.5..0.98).contains(&calibration.share(0.75)), "{}", calibration.share(0.75));
    }
}
