//! Adam in the tangent space of a configuration, with step lengths that fit a hand.

use crate::hand_model::HandModel;
use crate::options::Scheme;

/// Step lengths and decay rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSizes {
    /// Translation, metres a step (the reference: 1e-3 for everything).
    pub translation_m: f64,
    /// Rotation about the hand's pivot, radians a step.
    pub rotation_rad: f64,
    /// Fingers: metres of fingertip motion a step; see the hand model's step scale.
    pub finger_m: f64,
    /// Share of the step length that is left at the end. Steps are full until penetration counts, then they
    /// shrink along a half cosine: the hand first goes where contacts are, then settles among obstacles.
    pub final_share: f64,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
}

impl Default for StepSizes {
    fn default() -> Self {
        Self {
            translation_m: 1e-3,
            rotation_rad: 1.5e-2,
            finger_m: 1e-3,
            final_share: 0.1,
            beta1: 0.9,
            beta2: 0.999,
        }
    }
}

impl StepSizes {
    /// Share of the step length at iteration `k` of a scheme.
    pub(crate) fn share(&self, k: usize, scheme: Scheme) -> f64 {
        let first = scheme.iterations.saturating_sub(scheme.with_penetration);
        if k < first {
            return 1.0;
        }
        let progress = (k - first) as f64 / (scheme.iterations - first).max(1) as f64;
        self.final_share + (1.0 - self.final_share) * 0.5 * (1.0 + (std::f64::consts::PI * progress).cos())
    }
}

/// Moments of one candidate.
#[derive(Debug, Clone)]
pub(crate) struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    decay1: f64,
    decay2: f64,
}

impl Adam {
    pub(crate) fn new(dimension: usize) -> Self {
        Self { first: vec![0.0; dimension], second: vec![0.0; dimension], decay1: 1.0, decay2: 1.0 }
    }

    /// Takes the moments of another candidate of the same hand. Does not allocate.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.first.copy_from_slice(&other.first);
        self.second.copy_from_slice(&other.second);
        (self.decay1, self.decay2) = (other.decay1, other.decay2);
    }

    /// Turns a gradient into a step (in place); `lengths` is the step length of each variable.
    pub(crate) fn step(&mut self, sizes: &StepSizes, lengths: &[f64], share: f64, gradient: &mut [f64]) {
        self.decay1 *= sizes.beta1;
        self.decay2 *= sizes.beta2;
        let correct1 = 1.0 / (1.0 - self.decay1);
        let correct2 = 1.0 / (1.0 - self.decay2);
        for (i, g) in gradient.iter_mut().enumerate() {
            self.first[i] = sizes.beta1 * self.first[i] + (1.0 - sizes.beta1) * *g;
            self.second[i] = sizes.beta2 * self.second[i] + (1.0 - sizes.beta2) * *g * *g;
            let mean = self.first[i] * correct1;
            let scale = (self.second[i] * correct2).sqrt() + 1e-8;
            *g = -lengths[i] * share * mean / scale;
        }
    }
}

/// Step length of every tangent variable of a hand.
pub(crate) fn lengths(model: &HandModel<'_>, sizes: &StepSizes) -> Vec<f64> {
    let mut all = vec![sizes.translation_m; 3];
    all.extend([sizes.rotation_rad; 3]);
    all.extend(model.step_scale.iter().map(|s| s * sizes.finger_m));
    all
}
