//! Poses between the protocol, the messages, and nalgebra.

use graspd_client::wire;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};

use crate::messages;

/// A pose of the protocol; `None` where a part is missing or is no number. The server's rotations are of unit length.
pub fn of_wire(pose: Option<&wire::Pose>) -> Option<Isometry3<f64>> {
    let (p, q) = (pose?.position.as_ref()?, pose?.orientation.as_ref()?);
    let quaternion = Quaternion::new(q.w, q.x, q.y, q.z);
    let finite = [p.x, p.y, p.z, q.x, q.y, q.z, q.w].iter().all(|v| v.is_finite());
    (finite && quaternion.norm() > 0.5).then(|| {
        let rotation = UnitQuaternion::from_quaternion(quaternion);
        Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), rotation)
    })
}

/// As a message.
pub fn message(pose: &Isometry3<f64>) -> messages::Pose {
    let q = pose.rotation.coords;
    messages::Pose {
        position: point(&Point3::from(pose.translation.vector)),
        orientation: messages::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w },
    }
}

/// As a message.
pub fn point(point: &Point3<f64>) -> messages::Point {
    messages::Point { x: point.x, y: point.y, z: point.z }
}

/// A vector of the protocol as a point; the origin where there is none.
pub fn vector(vector: Option<&wire::Vector3>) -> Point3<f64> {
    vector.map_or_else(Point3::origin, |v| Point3::new(v.x, v.y, v.z))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_pose_survives_the_way(t in proptest::array::uniform3(-2.0f64..2.0), r in proptest::array::uniform3(-3.0f64..3.0)) {
            let pose = Isometry3::new(Vector3::from(t), Vector3::from(r));
            let m = message(&pose);
            let wire = wire::Pose {
                position: Some(wire::Vector3 { x: m.position.x, y: m.position.y, z: m.position.z }),
                orientation: Some(wire::Quaternion {
                    x: m.orientation.x, y: m.orientation.y, z: m.orientation.z, w: m.orientation.w,
                }),
            };
            let back = of_wire(Some(&wire)).unwrap();
            prop_assert!((back.inverse() * pose).translation.vector.norm() < 1e-12);
            prop_assert!(back.rotation.angle_to(&pose.rotation) < 1e-7);
        }
    }

    #[test]
    fn what_is_no_pose_is_none() {
        assert_eq!(of_wire(None), None);
        assert_eq!(of_wire(Some(&wire::Pose::default())), None);
        let position = Some(wire::Vector3::default());
        let zero = wire::Pose { position, orientation: Some(wire::Quaternion::default()) };
        assert_eq!(of_wire(Some(&zero)), None);
    }
}
