//! Non-maximum suppression: of grasps that are nearly the same, only the best stays.

use nalgebra::Point3;

use crate::grasp::Grasp;

/// Grasps whose tool points are closer than this may be the same, metres.
const SAME_PLACE_M: f64 = 0.02;
/// And whose rotations differ by less than this, radians (30°, as the field's evaluation does).
const SAME_TURN_RAD: f64 = std::f64::consts::FRAC_PI_6;

/// True when two grasps of one hand are nearly the same.
fn same(a: &Grasp, b: &Grasp, tool: &Point3<f64>) -> bool {
    let apart = (a.world_from_hand * tool - b.world_from_hand * tool).norm();
    apart < SAME_PLACE_M && a.world_from_hand.rotation.angle_to(&b.world_from_hand.rotation) < SAME_TURN_RAD
}

/// Keeps of numbered grasps sorted best first those that no better one resembles; returns how many went.
pub(crate) fn suppress(grasps: &mut Vec<(usize, Grasp)>, tool: &Point3<f64>) -> usize {
    let before = grasps.len();
    let mut kept: Vec<(usize, Grasp)> = Vec::with_capacity(before);
    for grasp in grasps.drain(..) {
        if !kept.iter().any(|k| same(&k.1, &grasp.1, tool)) {
            kept.push(grasp);
        }
    }
    *grasps = kept;
    before - grasps.len()
}
