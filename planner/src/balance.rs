//! Which pads a candidate grasps with: shares of the pads such that their pushes hold each other.
//!
//! A grasp needs two sides. Where one finger opposes four, a mean over all pads lies among the four, and what is
//! pulled to the object is their side of the hand. Pads are therefore weighed so that their normals cancel as far
//! as they can in the posture with which a candidate starts.

use nalgebra::Vector3;

/// Steps of the search for the shares.
const STEPS: usize = 100;
/// Length of a step: from 2 on it would swing about the balance of two opposed pads instead of reaching it.
const PACE: f64 = 0.8;

/// Shares `w` of contact candidates with outward normals `n` that minimize `‖Σ w n‖² + evenness·Σ w²`, with `w ≥ 0`
/// and `Σ w = 1`, by exponentiated gradient from equal shares; candidates that are not `used` get none. The evenness
/// is that of `pads` pads with the same number of candidates each. No candidates: no shares.
pub(crate) fn shares(normals: &[Vector3<f64>], used: &[bool], pads: usize, evenness: f64) -> Vec<f64> {
    let n = used.iter().filter(|u| **u).count();
    let evenness = evenness * normals.len() as f64 / pads.max(1) as f64;
    let mut w: Vec<f64> = used.iter().map(|u| if *u { 1.0 / n as f64 } else { 0.0 }).collect();
    for _ in 0..STEPS {
        let sum: Vector3<f64> = normals.iter().zip(&w).map(|(n, w)| n * *w).sum();
        // The larger the second term's slope, the shorter the step that does not swing.
        let pace = PACE / (1.0 + evenness * w.iter().copied().fold(0.0, f64::max));
        let mut total = 0.0;
        for (w, normal) in w.iter_mut().zip(normals) {
            *w *= (-pace * (sum.dot(normal) + evenness * *w)).exp();
            total += *w;
        }
        w.iter_mut().for_each(|w| *w /= total);
    }
    w
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::random_hand::direction;

    const EVENNESS: f64 = 0.2;

    proptest! {
        #[test]
        fn shares_sum_to_one_and_balance_at_least_as_well_as_equal_ones(seed in 0u64..1_000_000, n in 1usize..24) {
            let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
            let normals: Vec<Vector3<f64>> = (0..n).map(|_| direction(rng).into_inner()).collect();
            let used = vec![true; n];
            let w = shares(&normals, &used, n, EVENNESS);
            prop_assert!(w.iter().all(|w| (0.0..=1.0).contains(w)));
            prop_assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            let cost = |w: &[f64]| {
                let sum: Vector3<f64> = normals.iter().zip(w).map(|(n, w)| n * *w).sum();
                sum.norm_squared() + EVENNESS * w.iter().map(|w| w * w).sum::<f64>()
            };
            prop_assert!(cost(&w) <= cost(&vec![1.0 / n as f64; n]) + 1e-9);
        }
    }

    #[test]
    fn one_thumb_weighs_nearly_as_much_as_four_fingers() {
        let mut normals = vec![-Vector3::y(); 4];
        normals.push(Vector3::y());
        let w = shares(&normals, &[true; 5], 5, EVENNESS);
        assert!(w[4] > 0.4 && w[4] <= 0.5, "{w:?}");
        assert!(w[..4].iter().all(|x| (x - w[0]).abs() < 1e-12), "equal pads weigh the same: {w:?}");
    }

    #[test]
    fn the_more_even_the_less_a_thumb_weighs() {
        let mut normals = vec![-Vector3::y(); 4];
        normals.push(Vector3::y());
        let thumb = |evenness: f64| shares(&normals, &[true; 5], 5, evenness)[4];
        assert!(thumb(0.2) > thumb(1.0) && thumb(1.0) > thumb(10.0) && thumb(10.0) > 0.2);
        assert!(thumb(1e3) < 0.21, "at last all pads count the same");
    }

    #[test]
    fn what_is_not_used_gets_no_share() {
        let normals = [Vector3::x(), Vector3::x(), -Vector3::x(), -Vector3::x()];
        let w = shares(&normals, &[true, false, true, false], 4, EVENNESS);
        assert_eq!((w[1], w[3]), (0.0, 0.0));
        assert!((w[0] - 0.5).abs() < 1e-12 && (w[2] - 0.5).abs() < 1e-12, "{w:?}");
    }

    #[test]
    fn a_parallel_jaw_keeps_equal_shares() {
        let w = shares(&[Vector3::x(), Vector3::x(), -Vector3::x(), -Vector3::x()], &[true; 4], 2, EVENNESS);
        assert!(w.iter().all(|w| (w - 0.25).abs() < 1e-12), "{w:?}");
        assert!(shares(&[], &[], 0, EVENNESS).is_empty());
    }
}
