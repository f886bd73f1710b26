//! A planned grasp as a grasp of the benchmark's gripper.

use graspd_hands::Hand;
use graspd_planner::grasp::Grasp;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::jaw::{DEPTH_M, JawGrasp, MAX_WIDTH_M};

/// A planned grasp as the benchmark's gripper: the jaws open as far as on the approach.
pub(super) fn jaw_grasp(hand: &Hand, grasp: &Grasp) -> Option<JawGrasp> {
    let coordinate = hand.actuation.coordinates.first()?;
    let opening = hand.opening?;
    // The opening is linear in the actuator of a parallel jaw.
    let open = *grasp.actuators.open.first()?;
    let share = (open - coordinate.open) / (coordinate.closed - coordinate.open);
    let width_m = (opening.max_m + share * (opening.min_m - opening.max_m)).clamp(0.0, MAX_WIDTH_M);
    let count = grasp.contacts.len().max(1) as f64;
    let expected = grasp.contacts.iter().map(|c| c.point.coords).sum::<Vector3<f64>>() / count;
    Some(JawGrasp {
        world_from_jaw: grasp.world_from_hand * jaw_frame(hand),
        width_m,
        expected: Point3::from(expected),
    })
}

/// Takes the benchmark's gripper frame (z along the approach, y along the closing direction, fingers from −2 to
/// 6 cm) to the hand frame, from the pads of the open hand: their tips are the fingers' tips.
fn jaw_frame(hand: &Hand) -> Isometry3<f64> {
    let poses = hand.tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
    let links = hand.tree.link_poses(&poses);
    let pads: Vec<[Point3<f64>; 4]> =
        hand.pads.iter().map(|pad| pad.corners().map(|c| links[pad.link] * c)).collect();
    let center = |corners: &[Point3<f64>; 4]| corners.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let z = hand.approach.into_inner();
    let apart = center(&pads[1]) - center(&pads[0]);
    let y = (apart - z * z.dot(&apart)).normalize();
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[y.cross(&z), y, z]);
    let middle = 0.5 * (center(&pads[0]) + center(&pads[1]));
    let tip = pads.iter().flatten().map(|c| z.dot(&c.coords)).fold(f64::NEG_INFINITY, f64::max);
    let origin = middle + z * (tip - DEPTH_M - z.dot(&middle));
    Isometry3::from_parts(Translation3::from(origin), UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use graspd_hands::library;

    use super::*;

    #[test]
    fn the_antipodal_hand_is_the_benchmarks_gripper() {
        let frame = jaw_frame(library::hand("antipodal").unwrap());
        // Its origin is the hand's, z forward, y along the closing direction, up to its sign.
        assert!(frame.translation.vector.norm() < 1e-3, "{frame}");
        assert!((frame.rotation * Vector3::z() - Vector3::z()).norm() < 1e-3);
        assert!((frame.rotation * Vector3::y()).y.abs() > 0.999);
    }
}
