//! Force-closure objectives: linear independence of the contact wrenches, and the net wrench.
//!
//! Wrenches are taken about the nearest centred centroid; torques are divided by a characteristic
//! length, so that forces and torques compare.

use nalgebra::{Matrix6, Vector3};

use super::Contacts;

/// Lack of linear independence: `Σ_k relu(ε − λ_k)²` over the eigenvalues of `M = (1/N)·Σ G_i G_iᵀ`.
///
/// `G_i` maps a unit force at candidate `i` to a wrench. A Cholesky factorization of `M − ε·1` proves in
/// most iterations that every eigenvalue exceeds `ε`; only where it fails are eigenvalues computed.
pub(crate) fn independence(
    contacts: &mut Contacts,
    center: &Vector3<f64>,
    length: f64,
    floor: f64,
    weight: f64,
) -> f64 {
    let n = contacts.len();
    let share = 1.0 / n as f64;
    let m = grasp_matrix(contacts, center, length);
    if (m - Matrix6::identity() * floor).cholesky().is_some() {
        return 0.0;
    }
    let eigen = m.symmetric_eigen();
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
            contacts.point_gradient[i] += s.cross(&torque) * (-2.0 * lack * 2.0 * share * weight);
        }
    }
    sum
}

/// `M = (1/N)·Σ G_i G_iᵀ`, from the first and second moments of the contact positions.
fn grasp_matrix(contacts: &Contacts, center: &Vector3<f64>, length: f64) -> Matrix6<f64> {
    let share = 1.0 / contacts.len() as f64;
    let mut first = Vector3::zeros();
    let mut second = nalgebra::Matrix3::zeros();
    for p in &contacts.point {
        let r = (p - center) / length;
        first += r;
        second += r * r.transpose();
    }
    first *= share;
    second *= share;
    let cross = first.cross_matrix();
    // Σ [r]×[r]×ᵀ = tr(S)·1 − S.
    let rotational = nalgebra::Matrix3::identity() * second.trace() - second;
    let mut m = Matrix6::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&nalgebra::Matrix3::identity());
    m.fixed_view_mut::<3, 3>(3, 0).copy_from(&cross);
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross.transpose());
    m.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotational);
    m
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
        let w = look.certainty().max(0.0) * contacts.normal[i].dot(&look.inward()).max(0.0);
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
