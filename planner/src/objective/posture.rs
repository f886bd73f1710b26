//! Objectives of the posture itself: reaching direction, joint limits, soft couplings.

use graspd_hands::{Joint, SoftCoupling};
use nalgebra::Vector3;

/// Rounds the corner of an absolute value, radians or metres.
const ROUND: f64 = 0.01;

/// `O_ab = ‖v_sa − v_hg‖` (Supplementary Note 4): the approach axis against the reaching direction.
///
/// Returns the value and its gradient with respect to `v_sa`.
pub(crate) fn approach(axis: &Vector3<f64>, reaching: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let gap = axis - reaching;
    let length = gap.norm();
    if length < 1e-9 {
        return (0.0, Vector3::zeros());
    }
    (length, gap / length)
}

/// Joints beyond their limits: `Σ relu(q − q_max) + relu(q_min − q)`.
pub(crate) fn joint_limits(q: &[f64], joints: &[Joint], weight: f64, gradient: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for ((&q, joint), g) in q.iter().zip(joints).zip(gradient) {
        if q > joint.upper {
            sum += q - joint.upper;
            *g += weight;
        } else if q < joint.lower {
            sum += joint.lower - q;
            *g -= weight;
        }
    }
    sum
}

/// Soft couplings: `Σ w·(√(x² + δ²) − δ)` with `x = Σ c·q − target`; an absolute value with a round corner.
pub(crate) fn couplings(q: &[f64], couplings: &[SoftCoupling], weight: f64, gradient: &mut [f64]) -> f64 {
    let mut sum = 0.0;
    for coupling in couplings {
        let x = coupling.terms.iter().fold(-coupling.target, |x, &(j, c)| x + c * q[j]);
        let root = x.hypot(ROUND);
        sum += coupling.weight * (root - ROUND);
        let slope = weight * coupling.weight * x / root;
        for &(j, c) in &coupling.terms {
            gradient[j] += slope * c;
        }
    }
    sum
}
