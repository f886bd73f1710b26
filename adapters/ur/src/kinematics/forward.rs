//! Forward kinematics and the geometric Jacobian.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{Joints, Kinematics};

/// One link: `rot_z(theta) * trans_z(d) * trans_x(a) * rot_x(alpha)`.
pub(super) fn link(theta: f64, d: f64, a: f64, alpha: f64) -> Isometry3<f64> {
    let (st, ct) = theta.sin_cos();
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), theta)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), alpha);
    Isometry3::from_parts(Translation3::new(a * ct, a * st, d), rotation)
}

impl Kinematics {
    /// Rows of the Denavit-Hartenberg table: d, a, alpha.
    fn rows(&self) -> [(f64, f64, f64); 6] {
        let dh = &self.dh;
        [
            (dh.d1, 0.0, FRAC_PI_2),
            (0.0, dh.a2, 0.0),
            (0.0, dh.a3, 0.0),
            (dh.d4, 0.0, FRAC_PI_2),
            (dh.d5, 0.0, -FRAC_PI_2),
            (dh.d6, 0.0, 0.0),
        ]
    }

    /// Pose of the flange in the base frame.
    pub fn forward(&self, joints: &Joints) -> Isometry3<f64> {
        // Rotation matrices: exact to the last bits over six products.
        let mut rotation = Matrix3::identity();
        let mut at = Vector3::zeros();
        for (theta, (d, a, alpha)) in joints.iter().zip(self.rows()) {
            let (st, ct) = theta.sin_cos();
            let (sa, ca) = if alpha == 0.0 { (0.0, 1.0) } else { (alpha.signum(), 0.0) };
            at += rotation * Vector3::new(a * ct, a * st, d);
            rotation *= Matrix3::new(ct, -st * ca, st * sa, st, ct * ca, -ct * sa, 0.0, sa, ca);
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Isometry3::from_parts(Translation3::from(at), rotation)
    }

    /// Origins of the base and of the frames after each joint in the base frame, of the Denavit-Hartenberg table: the arm's
    /// bones. Next to the first pair, the upper arm lies beside its bone by about `d4` along the axis of the shoulder, which
    /// is returned too (unit length).
    pub fn bones(&self, joints: &Joints) -> ([Point3<f64>; 7], Vector3<f64>) {
        let mut at = Isometry3::identity();
        let mut points = [Point3::origin(); 7];
        let mut axis = Vector3::z();
        for (i, (theta, (d, a, alpha))) in joints.iter().zip(self.rows()).enumerate() {
            at *= link(*theta, d, a, alpha);
            points[i + 1] = Point3::from(at.translation.vector);
            if i == 0 {
                axis = at.rotation * Vector3::z();
            }
        }
        (points, axis)
    }

    /// Speeds of the flange (linear, then angular, base frame) by speeds of joints.
    pub fn jacobian(&self, joints: &Joints) -> Matrix6<f64> {
        let flange = self.forward(joints).translation.vector;
        let mut to_joint = Isometry3::identity();
        let mut jacobian = Matrix6::zeros();
        for (i, (theta, (d, a, alpha))) in joints.iter().zip(self.rows()).enumerate() {
            let axis = to_joint.rotation * Vector3::z();
            let linear = axis.cross(&(flange - to_joint.translation.vector));
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&axis);
            to_joint *= link(*theta, d, a, alpha);
        }
        jacobian
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::Model;
    use proptest::prelude::*;

    #[test]
    fn an_arm_stretched_out_is_where_its_table_says() {
        let arm = Kinematics::new(Model::Ur5e);
        let flange = arm.forward(&[0.0; 6]);
        let dh = arm.dh();
        let expected = Vector3::new(dh.a2 + dh.a3, -dh.d4 - dh.d6, dh.d1 - dh.d5);
        assert!((flange.translation.vector - expected).norm() < 1e-15, "{flange}");
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_derivative(q in prop::array::uniform6(-3.0..3.0f64), joint in 0usize..6) {
            let arm = Kinematics::new(Model::Ur10e);
            let step = 1e-6;
            let (mut before, mut after) = (q, q);
            before[joint] -= step;
            after[joint] += step;
            let (a, b) = (arm.forward(&before), arm.forward(&after));
            let linear = (b.translation.vector - a.translation.vector) / (2.0 * step);
            let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * step);
            let column = arm.jacobian(&q).column(joint).into_owned();
            prop_assert!((column.fixed_rows::<3>(0) - linear).norm() < 1e-7);
            prop_assert!((column.fixed_rows::<3>(3) - angular).norm() < 1e-7);
        }
    }

    proptest! {
        #[test]
        fn the_last_bone_ends_at_the_flange_and_bones_keep_their_lengths(q in prop::array::uniform6(-3.0..3.0f64)) {
            let arm = Kinematics::new(Model::Ur5e);
            let (points, axis) = arm.bones(&q);
            prop_assert!((points[6].coords - arm.forward(&q).translation.vector).norm() < 1e-9);
            let dh = arm.dh();
            let lengths = [dh.d1, -dh.a2, -dh.a3, dh.d4, dh.d5, dh.d6];
            for (pair, length) in points.windows(2).zip(lengths) {
                prop_assert!(((pair[1] - pair[0]).norm() - length).abs() < 1e-9);
            }
            // The shoulder's axis is the elbow's and that of wrist 1.
            prop_assert!((points[4] - points[3] - axis * dh.d4).norm() < 1e-9);
        }
    }
}
