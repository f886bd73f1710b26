//! Limits of joints, and which turn of a joint is the nearest.

use std::f64::consts::TAU;

use super::Joints;

/// From where to where each joint may be, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Lowest.
    pub lower: Joints,
    /// Highest.
    pub upper: Joints,
}

impl Default for JointLimits {
    /// Two turns for each joint.
    fn default() -> Self {
        Self { lower: [-TAU; 6], upper: [TAU; 6] }
    }
}

impl JointLimits {
    /// True when every joint is finite and within its limits.
    pub fn contain(&self, joints: &Joints) -> bool {
        self.first_outside(joints).is_none()
    }

    /// The first joint outside its limits.
    pub fn first_outside(&self, joints: &Joints) -> Option<usize> {
        (0..6).find(|&i| !(joints[i] >= self.lower[i] && joints[i] <= self.upper[i]))
    }

    /// The same posture in the turns nearest to `near`, as far as limits allow; `None` when no turn of a joint does.
    pub fn nearest_turns(&self, joints: &Joints, near: &Joints) -> Option<Joints> {
        let mut out = *joints;
        for i in 0..6 {
            let base = near[i] + (joints[i] - near[i] + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
            let turns = [0.0, -1.0, 1.0, -2.0, 2.0].map(|t| base + t * TAU);
            let fitting = turns.into_iter().filter(|q| *q >= self.lower[i] && *q <= self.upper[i]);
            out[i] = fitting.min_by(|a, b| (a - near[i]).abs().total_cmp(&(b - near[i]).abs()))?;
        }
        Some(out)
    }
}

/// How far the joint that goes farthest has to go, radians.
pub fn joint_distance(a: &Joints, b: &Joints) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_chosen_near_and_within_limits() {
        let limits = JointLimits::default();
        let near = [3.0, -3.0, 0.0, 6.0, -6.2, 0.1];
        let same = limits.nearest_turns(&[-3.0, 3.0, 0.1, 0.2, 0.1, 0.1], &near).unwrap();
        let expected = [TAU - 3.0, 3.0 - TAU, 0.1, 0.2 + TAU, 0.1 - TAU, 0.1];
        // 0.2 + TAU is beyond the limit: the turn below is taken.
        let expected = [expected[0], expected[1], expected[2], 0.2, expected[4], expected[5]];
        assert!(joint_distance(&same, &expected) < 1e-12, "{same:?}");
        let half = JointLimits { lower: [0.0; 6], upper: [1.0; 6] };
        assert_eq!(half.nearest_turns(&[2.0; 6], &[0.0; 6]), None);
        assert_eq!(half.first_outside(&[0.5, 0.5, f64::NAN, 0.5, 0.5, 0.5]), Some(2));
    }
}
