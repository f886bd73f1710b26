//! The score of a grasp: four parts between 0 and 1, and how they add up to the figure that is ranked by. The hand's
//! confidence makes a probability of it.

use crate::grasp::ScoreParts;

/// Objective value at which its part of the score has fallen to one half.
const OBJECTIVE_HALF: f64 = 0.6;
/// Force-closure margin that counts as full.
const MARGIN_FULL: f64 = 0.25;
/// Room around the hand that counts as full, metres.
const ROOM_FULL_M: f64 = 0.02;

/// Shares of the parts; they sum to 1. Chosen on 1784 simulated executions of the six best grasps of 325 plans with
/// seven hands, and counted on the same: the first grasp held in 305; with shares of 0.35, 0.30, 0.10 and 0.25 and
/// without squareness in 296; any of the six in 324.
const SHARES: ScoreParts =
    ScoreParts { objective: 0.40, force_closure: 0.40, clearance: 0.02, certainty: 0.18 };

/// The parts of a score from what was measured: the optimized objective, the Ferrari-Canny margin times how squarely
/// the touched surfaces face away from each other, the room around the hand (metres) and the mean certainty of the
/// contacts (0 to 1).
pub(crate) fn parts(objective: f64, margin: f64, room_m: f64, certainty: f64) -> ScoreParts {
    ScoreParts {
        objective: 1.0 / (1.0 + (objective.max(0.0) / OBJECTIVE_HALF).powi(2)),
        force_closure: (margin / MARGIN_FULL).clamp(0.0, 1.0),
        clearance: (room_m / ROOM_FULL_M).clamp(0.0, 1.0),
        certainty: certainty.clamp(0.0, 1.0),
    }
}

impl ScoreParts {
    /// The figure that grasps are ranked by: the weighted mean of the parts, 0 to 1. [`graspd_hands::Confidence`] says
    /// which probability it stands for.
    pub fn mean(&self) -> f64 {
        SHARES.objective * self.objective
            + SHARES.force_closure * self.force_closure
            + SHARES.clearance * self.clearance
            + SHARES.certainty * self.certainty
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_sum_to_one_and_scores_stay_between_zero_and_one() {
        assert!(
            (ScoreParts { objective: 1.0, force_closure: 1.0, clearance: 1.0, certainty: 1.0 }.mean() - 1.0)
                .abs()
                < 1e-12
        );
        for (o, m, r, c) in [(0.0, 9.0, 9.0, 9.0), (1e9, 0.0, -1.0, 0.0)] {
            let s = parts(o, m, r, c).mean();
            assert!((0.0..=1.0).contains(&s), "{s}");
        }
    }

    #[test]
    fn each_part_rises_with_what_it_measures() {
        let base = parts(0.5, 0.1, 0.01, 0.5).mean();
        assert!(parts(0.4, 0.1, 0.01, 0.5).mean() > base);
        assert!(parts(0.5, 0.2, 0.01, 0.5).mean() > base);
        assert!(parts(0.5, 0.1, 0.015, 0.5).mean() > base);
        assert!(parts(0.5, 0.1, 0.01, 0.6).mean() > base);
    }
}
