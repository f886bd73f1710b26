//! Geometry of the emulated arm: forward kinematics, and inverse by iteration. Independent of the adapter's.

use nalgebra::{Isometry3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Six joint positions or speeds.
pub type Six = [f64; 6];

/// Which arm is emulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UrModel {
    /// UR3e.
    Ur3e,
    /// UR5e.
    Ur5e,
    /// UR10e.
    Ur10e,
    /// UR16e.
    Ur16e,
    /// UR3 of the CB3 series.
    Ur3,
    /// UR5 of the CB3 series.
    Ur5,
    /// UR10 of the CB3 series.
    Ur10,
}

impl UrModel {
    /// All, with their names.
    pub const ALL: [(Self, &'static str); 7] = [
        (Self::Ur3e, "ur3e"),
        (Self::Ur5e, "ur5e"),
        (Self::Ur10e, "ur10e"),
        (Self::Ur16e, "ur16e"),
        (Self::Ur3, "ur3"),
        (Self::Ur5, "ur5"),
        (Self::Ur10, "ur10"),
    ];

    /// Offsets along z and lengths along x of the standard Denavit-Hartenberg table.
    fn table(self) -> (Six, Six) {
        match self {
            Self::Ur3e => {
                ([0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921], [0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0])
            }
            Self::Ur5e => ([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996], [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
            Self::Ur10e => {
                ([0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655], [0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0])
            }
            Self::Ur16e => {
                ([0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655], [0.0, -0.4784, -0.36, 0.0, 0.0, 0.0])
            }
            Self::Ur3 => {
                ([0.1519, 0.0, 0.0, 0.11235, 0.08535, 0.0819], [0.0, -0.24365, -0.21325, 0.0, 0.0, 0.0])
            }
            Self::Ur10 => {
                ([0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922], [0.0, -0.612, -0.5723, 0.0, 0.0, 0.0])
            }
            Self::Ur5 => {
                ([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823], [0.0, -0.425, -0.39225, 0.0, 0.0, 0.0])
            }
        }
    }

    /// What the dashboard answers when asked for the model.
    pub(crate) fn dashboard_name(self) -> &'static str {
        match self {
            Self::Ur3e | Self::Ur3 => "UR3",
            Self::Ur5e | Self::Ur5 => "UR5",
            Self::Ur10e | Self::Ur10 => "UR10",
            Self::Ur16e => "UR16",
        }
    }

    /// True for the older series: control steps of 8 ms.
    pub(crate) fn is_cb3(self) -> bool {
        matches!(self, Self::Ur3 | Self::Ur5 | Self::Ur10)
    }

    /// Length of a control step, seconds.
    pub fn step_s(self) -> f64 {
        if self.is_cb3() { 0.008 } else { 0.002 }
    }

    /// Largest joint speeds, radians per second.
    pub(crate) fn fastest(self) -> Six {
        use std::f64::consts::{PI, TAU};
        match self {
            Self::Ur3e | Self::Ur3 => [PI, PI, PI, TAU, TAU, TAU],
            Self::Ur5e | Self::Ur5 => [PI; 6],
            Self::Ur10e | Self::Ur16e | Self::Ur10 => [PI * 2.0 / 3.0, PI * 2.0 / 3.0, PI, PI, PI, PI],
        }
    }

    /// Poses of the frames after each joint; the last is the flange.
    fn frames(self, q: &Six) -> [Isometry3<f64>; 6] {
        const TWIST: Six = [1.0, 0.0, 0.0, 1.0, -1.0, 0.0];
        let (d, a) = self.table();
        let mut pose = Isometry3::identity();
        std::array::from_fn(|i| {
            let turn = Isometry3::rotation(Vector3::z() * q[i]);
            let twist = Isometry3::rotation(Vector3::x() * (TWIST[i] * std::f64::consts::FRAC_PI_2));
            pose = pose * turn * Translation3::new(a[i], 0.0, d[i]) * twist;
            pose
        })
    }

    /// Pose of the flange in the base frame.
    pub fn flange(self, q: &Six) -> Isometry3<f64> {
        self.frames(q)[5]
    }

    /// Speeds of a point fixed to the flange (linear, angular) by speeds of joints.
    pub(crate) fn jacobian(self, q: &Six, point: &Vector3<f64>) -> Matrix6<f64> {
        let frames = self.frames(q);
        let mut jacobian = Matrix6::zeros();
        for i in 0..6usize {
            let (axis, origin) = match i.checked_sub(1).map(|i| &frames[i]) {
                Some(frame) => (frame.rotation * Vector3::z(), frame.translation.vector),
                None => (Vector3::z(), Vector3::zeros()),
            };
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&axis.cross(&(point - origin)));
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&axis);
        }
        jacobian
    }

    /// Joints near `near` that take the flange to a pose; `None` where iteration finds none.
    pub fn joints(self, goal: &Isometry3<f64>, near: &Six) -> Option<Six> {
        let mut q = *near;
        for round in 0..100 {
            let at = self.flange(&q);
            let way = goal.translation.vector - at.translation.vector;
            let turn = (goal.rotation * at.rotation.inverse()).scaled_axis();
            let error = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
            if error.norm() < 1e-10 {
                return q.iter().all(|v| v.abs() <= 2.0 * std::f64::consts::PI + 1e-9).then_some(q);
            }
            let jacobian = self.jacobian(&q, &at.translation.vector);
            // Damped far from the goal, Newton's method near it.
            let damping = if round < 60 { (1e-3 * error.norm()).min(1e-3) } else { 1e-3 * error.norm() };
            let square = jacobian.transpose() * jacobian + Matrix6::identity() * damping.max(1e-14);
            let step = square.cholesky()?.solve(&(jacobian.transpose() * error));
            let longest = step.amax();
            let scale = if longest > 0.5 { 0.5 / longest } else { 1.0 };
            for i in 0..6 {
                q[i] += scale * step[i];
            }
            if !q.iter().all(|v| v.is_finite()) {
                return None;
            }
        }
        None
    }
}

/// A pose as the controller writes it: position and rotation vector.
pub fn to_six(pose: &Isometry3<f64>) -> Six {
    let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// A pose from position and rotation vector.
pub fn from_six(six: &Six) -> Isometry3<f64> {
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::new(Vector3::new(six[3], six[4], six[5])));
    Isometry3::from_parts(Translation3::new(six[0], six[1], six[2]), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iteration_leads_back() {
        for (model, _) in UrModel::ALL {
            let q = [0.4, -1.2, 1.6, -1.9, -1.5, 0.3];
            let near = [0.2, -1.0, 1.4, -1.7, -1.7, 0.6];
            let found = model.joints(&model.flange(&q), &near).unwrap();
            assert!(q.iter().zip(&found).all(|(a, b)| (a - b).abs() < 1e-8), "{found:?}");
            let far = Isometry3::translation(3.0, 0.0, 0.0);
            assert_eq!(model.joints(&far, &near), None);
        }
        let pose = from_six(&[0.1, 0.2, 0.3, 0.4, -0.5, 0.6]);
        assert!(
            to_six(&pose).iter().zip([0.1, 0.2, 0.3, 0.4, -0.5, 0.6]).all(|(a, b)| (a - b).abs() < 1e-12)
        );
    }
}
