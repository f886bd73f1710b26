//! How far grasps are apart, and going from one to another no faster than is allowed.

use graspd_hands::Hand;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use super::answer::Change;
use super::options::Bounds;
use crate::grasp::{Grasp, Postures};

/// By how much two poses of a hand differ; `pivot` is the middle of its contact candidates, hand frame.
pub(super) fn change(from: &Isometry3<f64>, to: &Isometry3<f64>, pivot: &Vector3<f64>) -> Change {
    let pivot = Point3::from(*pivot);
    Change {
        translation_m: (to * pivot - from * pivot).norm(),
        rotation_rad: from.rotation.angle_to(&to.rotation),
    }
}

/// Share of a change that is allowed at once.
pub(super) fn allowed_share(change: &Change, bounds: &Bounds) -> f64 {
    let share = |found: f64, most: f64| if found > most { most / found } else { 1.0 };
    share(change.translation_m, bounds.translation_m).min(share(change.rotation_rad, bounds.rotation_rad))
}

/// The grasp that is `share` of the way from one to another, with the figures of the other.
pub(super) fn between(
    from: &Grasp,
    to: &Grasp,
    share: f64,
    hand: &Hand,
    pivot: &Vector3<f64>,
    world_from_camera: &Isometry3<f64>,
) -> Grasp {
    let mut out = to.clone();
    let middle = Point3::from(*pivot);
    let (a, b) = (from.world_from_hand * middle, to.world_from_hand * middle);
    let at = a + share * (b - a);
    // Opposite rotations have no shortest way; then the other one is taken at once.
    let rotation = from
        .world_from_hand
        .rotation
        .try_slerp(&to.world_from_hand.rotation, share, 1e-9)
        .unwrap_or(to.world_from_hand.rotation);
    let translation = at.coords - rotation * middle.coords;
    out.world_from_hand = Isometry3::from_parts(Translation3::from(translation), rotation);
    out.camera_from_hand = world_from_camera.inverse() * out.world_from_hand;
    let back = (to.world_from_pregrasp.translation.vector - to.world_from_hand.translation.vector).norm();
    out.world_from_pregrasp = standing_off(&out.world_from_hand, hand, back);
    mix(&from.joints, &mut out.joints, share);
    mix(&from.actuators, &mut out.actuators, share);
    out
}

/// The pose `back` metres before a grasp, against the approach.
pub(super) fn standing_off(world_from_hand: &Isometry3<f64>, hand: &Hand, back: f64) -> Isometry3<f64> {
    let retreat = world_from_hand.rotation * hand.approach.into_inner() * -back;
    Translation3::from(retreat) * world_from_hand
}

fn mix(from: &Postures, to: &mut Postures, share: f64) {
    let pairs =
        [(&from.open, &mut to.open), (&from.contact, &mut to.contact), (&from.squeezed, &mut to.squeezed)];
    for (from, to) in pairs {
        for (to, from) in to.iter_mut().zip(from) {
            *to = from + share * (*to - from);
        }
    }
}
