//! The state of one candidate: wrist pose and hand coordinates, and how it moves on its manifold.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

use crate::hand_model::HandModel;

/// A hand configuration `g_H`: wrist pose in the volume frame and the hand's coordinates.
///
/// Tangent vectors are laid out `[translation (3), rotation (3), coordinates (n)]`; the rotation part is a
/// world-frame rotation vector that turns the hand about its pivot (the middle of its contact candidates):
/// turning about the wrist would swing the fingers away from what they are about to touch.
#[derive(Debug, Clone)]
pub(crate) struct Configuration {
    pub(crate) translation: Vector3<f64>,
    pub(crate) rotation: UnitQuaternion<f64>,
    pub(crate) coordinates: Vec<f64>,
}

impl Configuration {
    /// Moves along a tangent vector.
    pub(crate) fn step(&mut self, model: &HandModel<'_>, tangent: &[f64]) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(tangent[3], tangent[4], tangent[5]));
        let pivot = self.rotation * model.pivot;
        self.translation += pivot - turn * pivot;
        self.translation += Vector3::new(tangent[0], tangent[1], tangent[2]);
        self.rotation = turn * self.rotation;
        self.rotation.renormalize_fast();
        for (u, d) in self.coordinates.iter_mut().zip(&tangent[6..]) {
            *u += d;
        }
    }

    /// Clamps every coordinate into its limits.
    pub(crate) fn clamp_coordinates(&mut self, model: &HandModel<'_>) {
        for (u, c) in self.coordinates.iter_mut().zip(&model.hand.actuation.coordinates) {
            *u = u.clamp(c.lower, c.upper);
        }
    }

    /// Copies another configuration of the same hand without allocating.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.translation = other.translation;
        self.rotation = other.rotation;
        self.coordinates.copy_from_slice(&other.coordinates);
    }

    /// Pose of the hand's root link in the volume frame.
    pub(crate) fn volume_from_hand(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(self.translation), self.rotation)
    }

    /// True while every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        self.translation.iter().all(|v| v.is_finite())
            && self.rotation.coords.iter().all(|v| v.is_finite())
            && self.coordinates.iter().all(|v| v.is_finite())
    }
}

/// Poses of every body and positions of every candidate for one configuration, and the loads that
/// gradients put on the bodies. Allocated once, reused every iteration.
#[derive(Debug, Clone)]
pub(crate) struct Kinematics {
    pub(crate) q: Vec<f64>,
    pub(crate) rotation: Vec<Matrix3<f64>>,
    pub(crate) origin: Vec<Vector3<f64>>,
    axis: Vec<Vector3<f64>>,
    force: Vec<Vector3<f64>>,
    moment: Vec<Vector3<f64>>,
    joint_gradient: Vec<f64>,
    coordinate_gradient: Vec<f64>,
}

impl Kinematics {
    pub(crate) fn new(model: &HandModel<'_>) -> Self {
        let bodies = model.moving.len() + 1;
        Self {
            q: vec![0.0; model.joint_count],
            rotation: vec![Matrix3::identity(); bodies],
            origin: vec![Vector3::zeros(); bodies],
            axis: vec![Vector3::zeros(); bodies],
            force: vec![Vector3::zeros(); bodies],
            moment: vec![Vector3::zeros(); bodies],
            joint_gradient: vec![0.0; model.joint_count],
            coordinate_gradient: vec![0.0; model.coordinate_count],
        }
    }

    /// Forward kinematics: `q = A·u + b`, then every body's pose in the volume frame.
    pub(crate) fn forward(&mut self, model: &HandModel<'_>, configuration: &Configuration) {
        model.hand.actuation.joints_into(&configuration.coordinates, &mut self.q);
        self.rotation[0] = *configuration.rotation.to_rotation_matrix().matrix();
        self.origin[0] = configuration.translation;
        for (i, body) in model.moving.iter().enumerate() {
            let parent = self.rotation[body.parent];
            let frame = parent * body.rotation;
            let axis = frame * body.axis;
            let mut origin = self.origin[body.parent] + parent * body.origin;
            let mut rotation = frame;
            let q = self.q[body.joint];
            if body.revolute {
                rotation = frame * axis_rotation(&body.axis, q);
            } else {
                origin += axis * q;
            }
            self.rotation[i + 1] = rotation;
            self.origin[i + 1] = origin;
            self.axis[i + 1] = axis;
        }
    }

    /// A point of a body, in the volume frame.
    #[inline]
    pub(crate) fn point(&self, body: usize, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation[body] * point + self.origin[body]
    }

    /// A direction of a body, in the volume frame.
    #[inline]
    pub(crate) fn direction(&self, body: usize, direction: &Vector3<f64>) -> Vector3<f64> {
        self.rotation[body] * direction
    }

    /// Forgets all loads.
    pub(crate) fn clear_loads(&mut self) {
        self.force.fill(Vector3::zeros());
        self.moment.fill(Vector3::zeros());
    }

    /// Adds the gradient `g` with respect to a point of a body that is at `at`.
    #[inline]
    pub(crate) fn load_point(&mut self, body: usize, at: &Vector3<f64>, g: &Vector3<f64>) {
        self.force[body] += g;
        self.moment[body] += at.cross(g);
    }

    /// Adds the gradient `g` with respect to a direction of a body that is now `direction`.
    #[inline]
    pub(crate) fn load_direction(&mut self, body: usize, direction: &Vector3<f64>, g: &Vector3<f64>) {
        self.moment[body] += direction.cross(g);
    }

    /// Carries all loads up the tree (the transpose Jacobian as a recursion) and adds the direct
    /// gradient with respect to joints; writes the tangent gradient of the configuration.
    pub(crate) fn pull_back(
        &mut self,
        model: &HandModel<'_>,
        configuration: &Configuration,
        direct_joint_gradient: &[f64],
        gradient: &mut [f64],
    ) {
        self.joint_gradient.copy_from_slice(direct_joint_gradient);
        for (i, body) in model.moving.iter().enumerate().rev() {
            let (force, moment) = (self.force[i + 1], self.moment[i + 1]);
            let axis = &self.axis[i + 1];
            self.joint_gradient[body.joint] += if body.revolute {
                axis.dot(&(moment - self.origin[i + 1].cross(&force)))
            } else {
                axis.dot(&force)
            };
            self.force[body.parent] += force;
            self.moment[body.parent] += moment;
        }
        let pivot = configuration.translation + configuration.rotation * model.pivot;
        let turn = self.moment[0] - pivot.cross(&self.force[0]);
        gradient[..3].copy_from_slice(self.force[0].as_slice());
        gradient[3..6].copy_from_slice(turn.as_slice());
        model.hand.actuation.pull_back(&self.joint_gradient, &mut self.coordinate_gradient);
        gradient[6..].copy_from_slice(&self.coordinate_gradient);
    }
}

/// Rodrigues' formula for a unit axis.
#[inline]
fn axis_rotation(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    let v = 1.0 - c;
    let (x, y, z) = (axis.x, axis.y, axis.z);
    Matrix3::new(
        v * x * x + c,
        v * x * y - s * z,
        v * x * z + s * y,
        v * x * y + s * z,
        v * y * y + c,
        v * y * z - s * x,
        v * x * z - s * y,
        v * y * z + s * x,
        v * z * z + c,
    )
}
