//! Force-closure objectives: linear independence of the contact wrenches, and the net wrench.
//!
//! Wrenches are taken about the nearest centred centroid; torques are divided by a characteristic
//! length, so that forces and torques compare.

use nalgebra::{Matrix3, Matrix6, Vector3};

use super::Contacts;

/// Lack of linear independence: `Σ_k relu(ε − λ_k)²` over the eigenvalues of `M = (1/N)·Σ G_i G_iᵀ`.
///
/// `G_i` maps a unit force at candidate `i` to a wrench. In most iterations every eigenvalue exceeds `ε`,
/// which [`Moments::all_exceed`] proves with a 3×3 matrix; only where it cannot are eigenvalues computed.
pub(crate) fn independence(
    contacts: &mut Contacts,
    center: &Vector3<f64>,
    length: f64,
    floor: f64,
    weight: f64,
) -> f64 {
    let n = contacts.len();
    let moments = Moments::new(contacts, center, length);
    if moments.all_exceed(floor) {
        return 0.0;
    }
    let eigen = moments.grasp_matrix().symmetric_eigen();
    let mut sum = 0.0;
    for k in 0..6 {
        let lack = floor - eigen.eigenvalues[k];
        if lack <= 0.0 {
            continue;
        }
        sum += lack * lack;
        let v = eigen.eigenvectors.column(k);
        let force = Vector3::new(v[0], v[1], v[2]);
        let torque = Vector3::new(v[3], v[4], v[5]) / length;
        for i in 0..n {
            let r = contacts.point[i] - center;
            // λ = (1/N)·Σ ‖s_i‖² with s_i = v_f + v_τ × r_i.
            let s = force + torque.cross(&r);
            contacts.point_gradient[i] += s.cross(&torque) * (-4.0 * lack * contacts.share[i] * weight);
        }
    }
    sum
}

/// First and second moments of the contact positions about a centre, in characteristic lengths.
struct Moments {
    first: Vector3<f64>,
    /// `Σ [r]×[r]×ᵀ = tr(S)·1 − S`.
    rotational: Matrix3<f64>,
}

impl Moments {
    fn new(contacts: &Contacts, center: &Vector3<f64>, length: f64) -> Self {
        let inverse = 1.0 / length;
        let mut first = Vector3::zeros();
        let mut second = Matrix3::zeros();
        for (p, &share) in contacts.point.iter().zip(&contacts.share) {
            let r = (p - center) * inverse;
            first += r * share;
            second += r * r.transpose() * share;
        }
        Self { first, rotational: Matrix3::from_diagonal_element(second.trace()) - second }
    }

    /// `M`: the force block is the identity, the coupling the cross matrix of the first moment.
    fn grasp_matrix(&self) -> Matrix6<f64> {
        let cross = self.first.cross_matrix();
        let mut m = Matrix6::zeros();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        m.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross);
        m.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross.transpose());
        m.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rotational);
        m
    }

    /// True when every eigenvalue of `M` exceeds `floor` (below 1): the Schur complement of the force block
    /// in `M − ε·1` is positive definite, by its leading minors.
    fn all_exceed(&self, floor: f64) -> bool {
        let c = &self.first;
        let coupling = Matrix3::from_diagonal_element(c.norm_squared()) - c * c.transpose();
        let s = self.rotational - Matrix3::from_diagonal_element(floor) - coupling / (1.0 - floor);
        let minor = s.m11 * s.m22 - s.m12 * s.m21;
        floor < 1.0 && s.m11 > 0.0 && minor > 0.0 && s.determinant() > 0.0
    }
}

/// Net wrench `‖F‖² + ‖T/ℓ‖²` of contact forces along the pad normals.
///
/// Candidate `i` pushes with the share `w_i` of its certainty times its alignment,
/// `w = L1-normalized P_c·relu(n·z(Φ_c))`, which is held fixed in the gradient as in the reference.
pub(crate) fn net_wrench(contacts: &mut Contacts, center: &Vector3<f64>, length: f64, weight: f64) -> f64 {
    let n = contacts.len();
    let mut total = 0.0;
    for i in 0..n {
        let look = &contacts.look[i];
        let w =
            contacts.share[i] * look.certainty().max(0.0) * contacts.normal[i].dot(&look.inward()).max(0.0);
        contacts.push[i] = w;
        total += w;
    }
    if total < 1e-6 {
        contacts.push.fill(0.0);
        return 0.0;
    }
    let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
    for i in 0..n {
        contacts.push[i] /= total;
        let f = contacts.normal[i] * contacts.push[i];
        force += f;
        torque += (contacts.point[i] - center).cross(&f) / length;
    }
    for i in 0..n {
        let w = 2.0 * weight * contacts.push[i];
        let r = contacts.point[i] - center;
        let normal = contacts.normal[i];
        contacts.normal_gradient[i] += (force + torque.cross(&r) / length) * w;
        contacts.point_gradient[i] += normal.cross(&torque) * (w / length);
    }
    force.norm_squared() + torque.norm_squared()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::random_hand::vector;

    #[test]
    fn the_short_cut_agrees_with_the_eigenvalues() {
        let rng = &mut Xoshiro256PlusPlus::seed_from_u64(11);
        let mut agreed = [0, 0];
        for k in 0..400 {
            let mut contacts = Contacts::new(6);
            let flat = if k % 2 == 0 { 1.0 } else { 0.05 };
            for p in &mut contacts.point {
                *p = vector(rng, 0.03).component_mul(&Vector3::new(1.0, flat, flat));
            }
            let moments = Moments::new(&contacts, &vector(rng, 0.01), 0.05);
            let exact = moments.grasp_matrix().symmetric_eigenvalues().min() > 0.05;
            assert_eq!(moments.all_exceed(0.05), exact);
            agreed[usize::from(exact)] += 1;
        }
        assert!(agreed[0] > 20 && agreed[1] > 20, "both answers occur: {agreed:?}");
    }
}
