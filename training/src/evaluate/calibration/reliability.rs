//! Whether stated probabilities come true: bins of equal count, and the expected calibration error.

use serde::{Deserialize, Serialize};

use crate::evaluate::statistics::{Share, wilson};

/// Grasps whose stated probabilities lie together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bin {
    /// Grasps.
    pub count: usize,
    /// Mean of the stated probabilities.
    pub stated: f64,
    /// Share that held, with its 95 % interval.
    pub held: Share,
}

/// A reliability curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reliability {
    /// Bins, from improbable to probable.
    pub bins: Vec<Bin>,
    /// Expected calibration error: the mean over grasps of how far their bin's share that held is from what was
    /// stated (Naeini et al. 2015), bins of equal count.
    pub error: f64,
    /// The error that chance alone would make with as many grasps in each bin if every probability were true.
    pub by_chance: f64,
    /// Mean squared difference between probability and outcome (Brier 1950).
    pub brier: f64,
}

/// Sorts grasps by their stated probability into `bins` bins of equal count (fewer where there are fewer grasps) and
/// compares. Each outcome is a probability and whether the grasp held.
pub fn reliability(outcomes: &[(f64, bool)], bins: usize) -> Reliability {
    let mut sorted = outcomes.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let n = sorted.len();
    let bins = bins.clamp(1, n.max(1));
    let mut out = Reliability { bins: Vec::new(), error: 0.0, by_chance: 0.0, brier: 0.0 };
    if n == 0 {
        return out;
    }
    for b in 0..bins {
        let members = &sorted[b * n / bins..(b + 1) * n / bins];
        let count = members.len();
        let stated = members.iter().map(|m| m.0).sum::<f64>() / count as f64;
        let held = wilson(members.iter().filter(|m| m.1).count(), count);
        let weight = count as f64 / n as f64;
        out.error += weight * (held.rate - stated).abs();
        // The mean absolute deviation of a share, by the normal approximation of its distribution.
        let variance = members.iter().map(|m| m.0 * (1.0 - m.0)).sum::<f64>() / (count as f64).powi(2);
        out.by_chance += weight * (2.0 * variance / std::f64::consts::PI).sqrt();
        out.bins.push(Bin { count, stated, held });
    }
    out.brier = sorted.iter().map(|m| (m.0 - f64::from(u8::from(m.1))).powi(2)).sum::<f64>() / n as f64;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_that_come_true_have_no_error() {
        // Ten grasps of 0.2 of which two held, ten of 0.9 of which nine did.
        let outcomes: Vec<(f64, bool)> =
            (0..10).map(|i| (0.2, i < 2)).chain((0..10).map(|i| (0.9, i < 9))).collect();
        let r = reliability(&outcomes, 2);
        assert!(r.error < 1e-12, "{r:?}");
        assert_eq!(r.bins.iter().map(|b| b.count).collect::<Vec<_>>(), [10, 10]);
        assert!((r.brier - (0.16 + 0.09) / 2.0).abs() < 1e-12, "{}", r.brier);
    }

    #[test]
    fn an_error_is_weighed_by_how_many_grasps_have_it() {
        // 30 grasps promise 0.5 and all hold, 10 promise 0.9 and nine hold.
        let outcomes: Vec<(f64, bool)> =
            (0..30).map(|_| (0.5, true)).chain((0..10).map(|i| (0.9, i < 9))).collect();
        let r = reliability(&outcomes, 4);
        assert!((r.error - 0.75 * 0.5).abs() < 1e-12, "{r:?}");
        assert!(r.by_chance > 0.0 && r.by_chance < r.error);
    }

    #[test]
    fn nothing_is_no_error_and_few_are_few_bins() {
        assert!(reliability(&[], 10).bins.is_empty());
        assert_eq!(reliability(&[(0.3, true), (0.4, false)], 10).bins.len(), 2);
    }
}
