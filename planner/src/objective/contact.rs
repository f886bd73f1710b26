//! Objectives of single contact candidates: distance to focal contacts, certainty, orientation, centroid.

use nalgebra::{Point3, Vector3};

use super::Contacts;
use super::weights::Weights;
use crate::refine::{CenteredCentroid, FieldCells, Sample};

/// Channel of the distance to the nearest focal contact.
const DISTANCE: usize = 0;
/// Channel of the certainty.
const CERTAINTY: usize = 1;
/// First of three channels of the inward direction.
const INWARD: usize = 2;
/// Keeps the orientation mismatch differentiable at a perfect match.
const SMOOTH: f64 = 1e-4;

/// What the fields say at one contact candidate.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Look {
    pub(crate) sample: Sample,
    /// How far the candidate is outside the volume, as a vector from the volume to it, metres.
    pub(crate) outside: Vector3<f64>,
}

impl Look {
    pub(crate) fn at(cells: &FieldCells, p: &Vector3<f64>) -> Self {
        let size = cells.grid.size_m;
        let outside = p.map(|v| v - v.clamp(0.0, size));
        Self { sample: cells.sample(&Point3::from(*p)), outside }
    }

    /// Certainty relative to the field's maximum, 0 to 1.
    #[inline]
    pub(crate) fn certainty(&self) -> f64 {
        f64::from(self.sample.value[CERTAINTY])
    }

    /// Inward direction, interpolated (shorter than 1 where directions disagree).
    #[inline]
    pub(crate) fn inward(&self) -> Vector3<f64> {
        let v = &self.sample.value;
        Vector3::new(f64::from(v[INWARD]), f64::from(v[INWARD + 1]), f64::from(v[INWARD + 2]))
    }

    /// Distance to the nearest focal contact, metres; grows outside the volume.
    #[inline]
    pub(crate) fn distance(&self) -> f64 {
        f64::from(self.sample.value[DISTANCE]) + self.outside.norm()
    }
}

/// Distance to focal contacts beyond the tolerance: `Σ_i w_i relu(d(p_i) − τ)`.
///
/// `τ` is a tenth of the mean distance between paired candidates, as in the reference, not differentiated.
/// Where the reference pairs at random, candidate `i` is paired with `i + N/2`.
pub(crate) fn distance(contacts: &mut Contacts, weight: f64) -> f64 {
    let n = contacts.len();
    let half = n / 2;
    let spread: f64 = (0..half).map(|i| (contacts.point[i] - contacts.point[i + half]).norm()).sum::<f64>()
        / half.max(1) as f64;
    let tolerance = 0.1 * spread;
    let mut sum = 0.0;
    for i in 0..n {
        let look = &contacts.look[i];
        let beyond = look.distance() - tolerance;
        if beyond <= 0.0 {
            continue;
        }
        let share = contacts.share[i];
        sum += share * beyond;
        let mut g = look.sample.gradient_of(DISTANCE);
        let outside = look.outside.norm();
        if outside > 0.0 {
            g += look.outside / outside;
        }
        contacts.point_gradient[i] += g * (weight * share);
    }
    sum
}

/// Lack of certainty: `Σ_i w_i ℓ·(1 − P_c(p_i))`, metres.
///
/// The reference moves each candidate towards a copy of itself that has gone up the gradient of `P_c`;
/// that step has no objective of which it is the gradient. This one has the same direction and, with `ℓ`
/// the reference's step, about the same size.
pub(crate) fn certainty(contacts: &mut Contacts, weight: f64, length: f64) -> f64 {
    let mut sum = 0.0;
    for i in 0..contacts.len() {
        let look = &contacts.look[i];
        let share = contacts.share[i];
        sum += share * length * (1.0 - look.certainty());
        let g = look.sample.gradient_of(CERTAINTY) * (-weight * share * length);
        contacts.point_gradient[i] += g;
    }
    sum
}

/// Mismatch of pad normals and contact orientations: `Σ_i w_i ½‖n_i − z(Φ_c(p_i))‖`, 0 to 1.
///
/// The direction field is interpolated, so that the term also has a gradient in position.
pub(crate) fn orientation(contacts: &mut Contacts, weight: f64) -> f64 {
    let mut sum = 0.0;
    for i in 0..contacts.len() {
        let look = &contacts.look[i];
        let gap = contacts.normal[i] - look.inward();
        let length = (gap.norm_squared() + SMOOTH).sqrt();
        let share = contacts.share[i];
        sum += share * 0.5 * length;
        let g = gap * (0.5 * weight * share / length);
        let s = &look.sample;
        let along = |axis: usize| {
            let row = &s.gradient[axis];
            g.x * f64::from(row[INWARD]) + g.y * f64::from(row[INWARD + 1]) + g.z * f64::from(row[INWARD + 2])
        };
        contacts.point_gradient[i] -= Vector3::new(along(0), along(1), along(2));
        contacts.normal_gradient[i] += g;
    }
    sum
}

/// Distance of the mean contact to the nearest centred centroid: `min_s ‖c̄ − s‖`, metres.
///
/// Returns the distance and the index of that centroid; nothing without centroids.
pub(crate) fn centroid(
    contacts: &mut Contacts,
    centroids: &[CenteredCentroid],
    weight: f64,
) -> Option<(f64, usize)> {
    let mean = contacts.mean();
    let (nearest, squared) = centroids
        .iter()
        .enumerate()
        .map(|(i, c)| (i, (mean - c.position.coords).norm_squared()))
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    let distance = squared.sqrt();
    if distance > 1e-9 {
        let g = (mean - centroids[nearest].position.coords) * (weight / distance);
        for (slot, share) in contacts.point_gradient.iter_mut().zip(&contacts.share) {
            *slot += g * *share;
        }
    }
    Some((distance, nearest))
}

/// All four, added up with their weights; returns the unweighted values in order.
pub(crate) fn all(
    contacts: &mut Contacts,
    centroids: &[CenteredCentroid],
    weights: &Weights,
) -> (f64, f64, f64, Option<(f64, usize)>) {
    (
        distance(contacts, weights.contact_distance),
        certainty(contacts, weights.certainty, weights.certainty_length_m),
        orientation(contacts, weights.orientation),
        centroid(contacts, centroids, weights.centroid),
    )
}
