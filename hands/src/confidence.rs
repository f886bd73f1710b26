//! How sure a ranking's figure makes: the curve from it to the probability that a grasp holds.

/// A logistic curve from a grasp's figure, the weighted mean of its score's parts (0 to 1), to the probability that
/// the grasp holds: `p = 1 / (1 + exp(−(slope · figure + intercept)))`. It rises, so a ranking by probability is a
/// ranking by figure.
///
/// Hands differ more than scenes do: the same figure means more for a gripper that two pads describe than for a hand
/// with sixteen motors. `hand.toml` gives a hand its own curve; `graspd eval calibration` fits it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Confidence {
    /// Log-odds per unit of figure; greater than 0.
    pub slope: f64,
    /// Log-odds of a figure of 0.
    pub intercept: f64,
}

impl Confidence {
    /// For hands without a curve of their own: fitted on all hands of the library together (`graspd eval calibration
    /// --items 15 --grasps 6 --seed 1`).
    pub const GENERIC: Self = Self { slope: 5.8, intercept: -1.65 };

    /// Probability that a grasp of this figure holds, between 0 and 1.
    pub fn probability(&self, figure: f64) -> f64 {
        1.0 / (1.0 + (-(self.slope * figure + self.intercept)).exp())
    }
}

impl Default for Confidence {
    fn default() -> Self {
        Self::GENERIC
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_larger_figure_is_a_larger_probability(
            slope in 0.01..50.0_f64, intercept in -20.0..20.0_f64, a in 0.0..1.0_f64, b in 0.0..1.0_f64
        ) {
            let curve = Confidence { slope, intercept };
            let (p, q) = (curve.probability(a), curve.probability(b));
            prop_assert!((0.0..=1.0).contains(&p));
            prop_assert!(a < b || p >= q);
        }
    }

    #[test]
    fn even_odds_lie_where_the_log_odds_are_zero() {
        assert_eq!(Confidence { slope: 4.0, intercept: -2.0 }.probability(0.5), 0.5);
    }
}
