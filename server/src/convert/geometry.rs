//! Vectors, quaternions and poses.

use graspd_proto::v1;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::join;
use crate::error::{FieldError, FieldReason};

/// A quaternion may differ from unit length by this much (it is then normalized).
const UNIT_TOLERANCE: f64 = 1e-3;

/// Coordinates beyond this are not a place in front of a robot.
const FARTHEST_M: f64 = 1e4;

/// Three finite numbers of reasonable size.
pub(super) fn vector(wire: Option<v1::Vector3>, path: &str) -> Result<Vector3<f64>, FieldError> {
    let v = wire.ok_or_else(|| FieldError::missing(path, "a vector"))?;
    for (name, value) in [("x", v.x), ("y", v.y), ("z", v.z)] {
        if !value.is_finite() || value.abs() > FARTHEST_M {
            return Err(FieldError::value(
                join(path, name),
                value,
                format!("a finite number of at most {FARTHEST_M}"),
            ));
        }
    }
    Ok(Vector3::new(v.x, v.y, v.z))
}

/// A point.
pub(super) fn point(wire: Option<v1::Vector3>, path: &str) -> Result<Point3<f64>, FieldError> {
    vector(wire, path).map(Point3::from)
}

/// A direction of any length but (nearly) 0.
pub(super) fn direction(wire: Option<v1::Vector3>, path: &str) -> Result<Unit<Vector3<f64>>, FieldError> {
    let v = vector(wire, path)?;
    Unit::try_new(v, 1e-9).ok_or_else(|| FieldError::value(path, "a vector of length 0", "a direction"))
}

/// A rigid-body pose.
pub(super) fn pose(wire: Option<&v1::Pose>, path: &str) -> Result<Isometry3<f64>, FieldError> {
    let wire = wire.ok_or_else(|| FieldError::missing(path, "a pose"))?;
    let position = vector(wire.position, &join(path, "position")).map_err(|e| {
        if e.reason == FieldReason::Missing { e } else { FieldError { reason: FieldReason::Pose, ..e } }
    })?;
    let path = join(path, "orientation");
    let q = wire.orientation.ok_or_else(|| FieldError::missing(&path, "a unit quaternion"))?;
    let q = Quaternion::new(q.w, q.x, q.y, q.z);
    let norm = q.norm();
    if !norm.is_finite() || (norm - 1.0).abs() > UNIT_TOLERANCE {
        return Err(FieldError::new(
            FieldReason::Pose,
            path,
            format!("a quaternion of norm {norm}"),
            format!("a norm of 1 ± {UNIT_TOLERANCE}"),
        ));
    }
    Ok(Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_quaternion(q)))
}

/// A vector on the wire.
pub(super) fn vector_message(v: &Vector3<f64>) -> v1::Vector3 {
    v1::Vector3 { x: v.x, y: v.y, z: v.z }
}

/// A pose on the wire, in a frame that its field names.
pub(super) fn bare_pose_message(pose: &Isometry3<f64>) -> v1::Pose {
    let q = pose.rotation.quaternion();
    v1::Pose {
        position: Some(vector_message(&pose.translation.vector)),
        orientation: Some(v1::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// A pose on the wire, and its frame.
pub(super) fn pose_message(frame_id: &str, pose: &Isometry3<f64>) -> v1::PoseInFrame {
    v1::PoseInFrame { frame_id: frame_id.to_owned(), pose: Some(bare_pose_message(pose)) }
}
