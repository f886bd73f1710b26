//! Precision at k and its averages, as the paper takes them from the grasp benchmark (Supplementary Note 3).

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use super::jaw::{FRICTIONS, Verdict};

/// Grasps that are scored in every view.
pub const TOP: usize = 50;
/// Grasps of one object that are scored at most.
pub const PER_OBJECT: usize = 10;
/// Grasps nearer than this, metres, and turned by less than [`NMS_RAD`], are one.
const NMS_M: f64 = 0.03;
/// See [`NMS_M`].
const NMS_RAD: f64 = std::f64::consts::PI / 6.0;

/// Which of the poses, best first, are kept by non-maximum suppression.
pub fn suppress(poses: &[Isometry3<f64>]) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for (i, pose) in poses.iter().enumerate() {
        let same = |&j: &usize| {
            let other = &poses[j];
            (other.translation.vector - pose.translation.vector).norm() < NMS_M
                && other.rotation.angle_to(&pose.rotation) < NMS_RAD
        };
        if !kept.iter().any(same) {
            kept.push(i);
        }
    }
    kept
}

/// Which of the grasps, best first, each on the object `objects[i]`, are scored: at most [`PER_OBJECT`] on one
/// object and [`TOP`] in all.
pub fn select(objects: &[usize]) -> Vec<usize> {
    let mut counts = std::collections::BTreeMap::new();
    let few = objects.iter().enumerate().filter(|(_, object)| {
        let count = counts.entry(**object).or_insert(0usize);
        *count += 1;
        *count <= PER_OBJECT
    });
    few.map(|(i, _)| i).take(TOP).collect()
}

/// Mean precision at k, k = 1 to [`TOP`], of one view at friction `mu`. Verdicts are best first; a grasp that
/// is missing counts as one that failed.
pub fn average_precision(verdicts: &[Verdict], mu: f64) -> f64 {
    let (mut good, mut sum) = (0usize, 0.0);
    for k in 1..=TOP {
        good += usize::from(verdicts.get(k - 1).is_some_and(|v| v.holds_at(mu)));
        sum += good as f64 / k as f64;
    }
    sum / TOP as f64
}

/// AP of one kind of volume, over all views; each 0 to 100.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Precision {
    /// AP_μ as (μ, value), from the least friction.
    pub by_friction: Vec<(f64, f64)>,
    /// AP: mean over μ = 0.2, 0.4, ... 1.0, as Supplementary Note 3 defines it.
    pub ap: f64,
    /// The mean over μ = 0.2, 0.4, ... 1.2, as the benchmark's code computes it.
    pub ap_six: f64,
}

impl Precision {
    /// The mean over views.
    pub fn of(views: &[Vec<Verdict>]) -> Self {
        let mean_at = |mu: f64| {
            let sum: f64 = views.iter().map(|verdicts| average_precision(verdicts, mu)).sum();
            100.0 * sum / views.len().max(1) as f64
        };
        let by_friction: Vec<(f64, f64)> = FRICTIONS.iter().rev().map(|&mu| (mu, mean_at(mu))).collect();
        let mean =
            |values: &[(f64, f64)]| values.iter().map(|v| v.1).sum::<f64>() / values.len().max(1) as f64;
        let ap = mean(&by_friction[..by_friction.len() - 1]);
        Self { ap, ap_six: mean(&by_friction), by_friction }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const GOOD: Verdict = Verdict::Holds { friction: 0.4 };

    #[test]
    fn fifty_good_grasps_are_perfect_where_they_hold() {
        let p = Precision::of(&[vec![GOOD; 50]]);
        assert_eq!(p.by_friction[0], (0.2, 0.0));
        assert_eq!(p.by_friction[1], (0.4, 100.0));
        assert!((p.ap - 80.0).abs() < 1e-9 && (p.ap_six - 500.0 / 6.0).abs() < 1e-9);
    }

    #[test]
    fn missing_grasps_are_failures() {
        // One good grasp: precision 1/k at every k; the harmonic number of 50 over 50.
        let harmonic: f64 = (1..=50).map(|k| 1.0 / f64::from(k)).sum();
        assert!((average_precision(&[GOOD], 1.0) - harmonic / 50.0).abs() < 1e-12);
        assert_eq!(average_precision(&[], 1.0), 0.0);
        // A bad one first costs more than a bad one last.
        let first = average_precision(&[Verdict::Empty, GOOD], 1.0);
        let last = average_precision(&[GOOD, Verdict::Empty], 1.0);
        assert!(first < last);
    }

    #[test]
    fn an_object_gives_ten_grasps_and_a_view_fifty() {
        let objects: Vec<usize> = (0..200).map(|i| if i < 100 { 0 } else { i % 7 }).collect();
        let chosen = select(&objects);
        assert_eq!(chosen.len(), 50);
        assert_eq!(chosen.iter().filter(|&&i| objects[i] == 0).count(), 10);
        assert!(chosen.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn near_poses_of_like_orientation_are_one() {
        let at = |x: f64, turn: f64| Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * turn);
        let poses = [at(0.0, 0.0), at(0.02, 0.2), at(0.02, 0.7), at(0.04, 0.0)];
        assert_eq!(suppress(&poses), vec![0, 2, 3]);
    }
}
