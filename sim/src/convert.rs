//! The one place where nalgebra meets the physics engine's own linear algebra (glam).

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::math::{Pose, Rotation, Vector};

pub(crate) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(crate) fn point(p: &Point3<f64>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

pub(crate) fn pose(p: &Isometry3<f64>) -> Pose {
    let q = p.rotation.quaternion().coords;
    Pose::from_parts(vector(&p.translation.vector), Rotation::from_xyzw(q.x, q.y, q.z, q.w))
}

pub(crate) fn from_vector(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

pub(crate) fn from_pose(p: &Pose) -> Isometry3<f64> {
    let q = p.rotation;
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(q.w, q.x, q.y, q.z));
    Isometry3::from_parts(Translation3::from(from_vector(p.translation)), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_survives_the_way_there_and_back() {
        let there = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.5, -0.6));
        let back = from_pose(&pose(&there));
        assert!((there.inverse() * back).translation.vector.norm() < 1e-12);
        assert!(there.rotation.angle_to(&back.rotation) < 1e-12);
        let p = Point3::new(1.0, 2.0, 3.0);
        assert!((from_vector(pose(&there) * point(&p)) - (there * p).coords).norm() < 1e-12);
    }
}
