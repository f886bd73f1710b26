//! Poses as they stand in records: position and quaternion, SI units.

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A pose in a record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseRecord {
    /// Metres.
    pub position_m: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation_xyzw: [f64; 4],
}

impl From<&Isometry3<f64>> for PoseRecord {
    fn from(pose: &Isometry3<f64>) -> Self {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        Self { position_m: [t.x, t.y, t.z], orientation_xyzw: [q.x, q.y, q.z, q.w] }
    }
}

impl PoseRecord {
    /// The pose; the quaternion is taken as unit.
    pub fn isometry(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.orientation_xyzw;
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        Isometry3::from_parts(Translation3::from(Vector3::from(self.position_m)), rotation)
    }
}

/// The pose of a hand's root link that points its approach axis straight down and has its tool point at
/// `position`, its lateral axis at `yaw_rad` from the world's x axis; any `lateral` that is not along `approach`.
pub fn pointing_down(
    approach: &Unit<Vector3<f64>>,
    lateral: &Vector3<f64>,
    tool_point: &Vector3<f64>,
    position: &Vector3<f64>,
    yaw_rad: f64,
) -> Isometry3<f64> {
    let z = *approach.as_ref();
    let sideways = lateral - z * lateral.dot(&z);
    let x = Unit::try_new(sideways, 1e-6).map_or_else(|| any_normal(&z), Unit::into_inner);
    // Columns: where the hand's (lateral, approach × lateral, approach) lie in the hand frame, and in the world.
    let in_hand = nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]);
    let (down, ahead) = (-Vector3::z(), Vector3::new(yaw_rad.cos(), yaw_rad.sin(), 0.0));
    let in_world = nalgebra::Matrix3::from_columns(&[ahead, down.cross(&ahead), down]);
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(in_world * in_hand.transpose());
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Isometry3::from_parts(Translation3::from(position - rotation * tool_point), rotation)
}

fn any_normal(z: &Vector3<f64>) -> Vector3<f64> {
    let other = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    (other - z * other.dot(z)).normalize()
}

/// The pose raised straight up so far that a point of it (its frame) stands at least at `z_m`, world frame.
pub fn raised_to(pose: &Isometry3<f64>, point: &Vector3<f64>, z_m: f64) -> Isometry3<f64> {
    let z = (pose * nalgebra::Point3::from(*point)).z;
    let mut raised = *pose;
    raised.translation.vector.z += (z_m - z).max(0.0);
    raised
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tool_point_arrives_and_the_hand_points_down(
            axis in prop::array::uniform3(-1.0..1.0f64),
            lateral in prop::array::uniform3(-1.0..1.0f64),
            tool in prop::array::uniform3(-0.3..0.3f64),
            at in prop::array::uniform3(-1.0..1.0f64),
            yaw in -3.0..3.0f64,
        ) {
            let axis = Vector3::from(axis);
            prop_assume!(axis.norm() > 1e-3);
            let approach = Unit::new_normalize(axis);
            let (tool, at) = (Vector3::from(tool), Vector3::from(at));
            let pose = pointing_down(&approach, &Vector3::from(lateral), &tool, &at, yaw);
            prop_assert!((pose * Point3::from(tool) - Point3::from(at)).norm() < 1e-9);
            prop_assert!((pose.rotation * approach.into_inner() + Vector3::z()).norm() < 1e-9);
            prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-9);
            let up = raised_to(&pose, &tool, 2.0);
            prop_assert!(((up * Point3::from(tool)).z - 2.0).abs() < 1e-9);
            prop_assert_eq!(raised_to(&up, &tool, 0.0), up);
        }

        #[test]
        fn records_give_back_the_pose(
            t in prop::array::uniform3(-1.0..1.0f64),
            r in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let pose = Isometry3::new(Vector3::from(t), Vector3::from(r));
            prop_assert_eq!(PoseRecord::from(&pose).isometry(), pose);
        }
    }
}
