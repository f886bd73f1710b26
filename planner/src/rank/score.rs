//! The score of a grasp: four parts between 0 and 1, and how they add up.

use crate::grasp::ScoreParts;

/// Objective value at which its part of the score has fallen to one half.
const OBJECTIVE_HALF: f64 = 0.6;
/// Force-closure margin that counts as full.
const MARGIN_FULL: f64 = 0.25;
/// Distance from the object's middle at which being near it counts nothing, metres.
const OFF_MIDDLE_M: f64 = 0.05;
/// Room around the hand that counts as full, metres.
const ROOM_FULL_M: f64 = 0.02;

/// Shares of the parts; they sum to 1. See [`HOLD`] for what they were chosen on.
const SHARES: ScoreParts =
    ScoreParts { objective: 0.21, force_closure: 0.69, clearance: 0.01, certainty: 0.09 };
/// Shares of margin, straightness and nearness to the middle in the part for force closure; they sum to 1.
const HOLD: [f64; 3] = [0.31, 0.31, 0.38];

/// What speaks for contacts to hold an object.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hold {
    /// The Ferrari-Canny margin times how squarely the touched surfaces face away from each other.
    pub(crate) margin: f64,
    /// How straight the virtual fingers press towards each other, 0 to 1.
    pub(crate) straightness: f64,
    /// Horizontal distance of the place that they press on from the middle of what is grasped, metres: gravity turns what
    /// is held at its end.
    pub(crate) off_middle_m: f64,
}

/// The parts of a score from what was measured: the optimized objective, what speaks for the contacts to hold, the
/// room around the hand (metres) and the mean certainty of the contacts (0 to 1).
pub(crate) fn parts(objective: f64, hold: &Hold, room_m: f64, certainty: f64) -> ScoreParts {
    let of_hold = [
        (hold.margin / MARGIN_FULL).clamp(0.0, 1.0),
        hold.straightness.clamp(0.0, 1.0),
        (1.0 - hold.off_middle_m / OFF_MIDDLE_M).clamp(0.0, 1.0),
    ];
    ScoreParts {
        objective: 1.0 / (1.0 + (objective.max(0.0) / OBJECTIVE_HALF).powi(2)),
        force_closure: of_hold.iter().zip(HOLD).map(|(part, share)| part * share).sum(),
        clearance: (room_m / ROOM_FULL_M).clamp(0.0, 1.0),
        certainty: certainty.clamp(0.0, 1.0),
    }
}

/// The score: the weighted mean of the parts.
pub(crate) fn total(parts: &ScoreParts) -> f64 {
    SHARES.objective * parts.objective
        + SHARES.force_closure * parts.force_closure
        + SHARES.clearance * parts.clearance
        + SHARES.certainty * parts.certainty
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_sum_to_one_and_scores_stay_between_zero_and_one() {
        assert!(
            (total(&ScoreParts { objective: 1.0, force_closure: 1.0, clearance: 1.0, certainty: 1.0 }) - 1.0)
                .abs()
                < 1e-12
        );
        let hold = |margin, straightness, off_middle_m| Hold { margin, straightness, off_middle_m };
        for (o, h, r, c) in
            [(0.0, hold(9.0, 9.0, 0.0), 9.0, 9.0), (1e9, hold(0.0, -1.0, f64::INFINITY), -1.0, 0.0)]
        {
            let s = total(&parts(o, &h, r, c));
            assert!((0.0..=1.0).contains(&s), "{s}");
        }
    }

    #[test]
    fn each_part_rises_with_what_it_measures() {
        let hold = Hold { margin: 0.1, straightness: 0.8, off_middle_m: 0.02 };
        let base = total(&parts(0.5, &hold, 0.01, 0.5));
        assert!(total(&parts(0.4, &hold, 0.01, 0.5)) > base);
        for better in [
            Hold { margin: 0.2, ..hold },
            Hold { straightness: 0.9, ..hold },
            Hold { off_middle_m: 0.01, ..hold },
        ] {
            assert!(total(&parts(0.5, &better, 0.01, 0.5)) > base, "{better:?}");
        }
        assert!(total(&parts(0.5, &hold, 0.015, 0.5)) > base);
        assert!(total(&parts(0.5, &hold, 0.01, 0.6)) > base);
    }
}
