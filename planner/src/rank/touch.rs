//! What a closed hand touches, and what is made of it: the object that is held, its middle, expected contacts.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::grasp::GraspContact;
use crate::hand_model::HandModel;

/// A candidate this close to the scene's surface is a contact, voxels.
pub(super) const CONTACT_VOXELS: f64 = 1.5;
/// Smallest cosine between a pad's normal and the inward direction that makes a contact.
pub(super) const ALIGNED: f64 = 0.2;
/// The line between two fingers may leave their friction cones by this much, radians.
const OPPOSED_SLACK_RAD: f64 = 0.2;

/// A contact in the volume frame.
pub(super) struct Touch {
    pub(super) point: Vector3<f64>,
    pub(super) inward: Unit<Vector3<f64>>,
    /// Group of the object that is touched; 0 where it is not known.
    pub(super) object: u16,
    pub(super) pad: usize,
    pub(super) body: usize,
    pub(super) certainty: f64,
    /// Outward normal of the pad: the way the finger presses.
    pub(super) pad_normal: Vector3<f64>,
}

/// Of touches on several objects those on the one that most candidates touch: a grasp holds one object, and a
/// finger on its neighbour, or on the noise of the table's surface, holds nothing.
pub(super) fn of_one_object(mut touches: Vec<Touch>) -> Vec<Touch> {
    touches.retain(|t| t.object > 0);
    let mut counts = BTreeMap::new();
    for t in &touches {
        *counts.entry(t.object).or_insert(0usize) += 1;
    }
    // The first of equals, so that the choice does not depend on anything but the scene.
    let most = counts.iter().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(a.0))).map(|(o, _)| *o);
    touches.retain(|t| Some(t.object) == most);
    touches
}

/// Middle of the contacts: the mean over pads of each pad's mean, so that a pad with many touching
/// candidates weighs no more than one with few.
pub(super) fn middle(touches: &[Touch]) -> Option<Vector3<f64>> {
    let pads: BTreeSet<usize> = touches.iter().map(|t| t.pad).collect();
    if pads.is_empty() {
        return None;
    }
    let sum: Vector3<f64> = pads.iter().map(|&p| mean_of(touches, |t| t.pad == p)).sum();
    Some(sum / pads.len() as f64)
}

fn mean_of(touches: &[Touch], keep: impl Fn(&Touch) -> bool) -> Vector3<f64> {
    let kept: Vec<Vector3<f64>> = touches.iter().filter(|t| keep(t)).map(|t| t.point).collect();
    kept.iter().sum::<Vector3<f64>>() / kept.len().max(1) as f64
}

/// How squarely two of the touched surfaces face away from each other, 0 to 1: the cosine between one pad's inward
/// direction and the reverse of another's, the best of all pairs. Grasps on surfaces that lean the same way have
/// force closure on paper, and slip where the friction is less.
pub(super) fn squareness(touches: &[Touch]) -> f64 {
    let pads: BTreeSet<usize> = touches.iter().map(|t| t.pad).collect();
    let inward = |pad: usize| -> Option<Unit<Vector3<f64>>> {
        let own = touches.iter().filter(|t| t.pad == pad).map(|t| t.inward.into_inner());
        Unit::try_new(own.sum(), 1e-6)
    };
    let ways: Vec<_> = pads.into_iter().filter_map(inward).collect();
    let pairs = ways.iter().enumerate().flat_map(|(i, a)| ways[..i].iter().map(move |b| -a.dot(b)));
    pairs.fold(0.0, f64::max).min(1.0)
}

/// One contact per touching pad, in the world frame.
pub(super) fn contacts_by_pad(
    model: &HandModel<'_>,
    touches: &[Touch],
    world_from_volume: &Isometry3<f64>,
) -> Vec<GraspContact> {
    (0..model.hand.pads.len())
        .filter_map(|pad| {
            let own: Vec<&Touch> = touches.iter().filter(|t| t.pad == pad).collect();
            let inward: Vector3<f64> = own.iter().map(|t| t.inward.into_inner()).sum();
            let inward = Unit::try_new(inward, 1e-6)?;
            let point = mean_of(touches, |t| t.pad == pad);
            Some(GraspContact {
                point: world_from_volume * Point3::from(point),
                normal: world_from_volume.rotation * -inward,
                pad,
                finger: model.hand.pads[pad].finger,
                certainty: own.iter().map(|t| t.certainty).sum::<f64>() / own.len() as f64,
            })
        })
        .collect()
}

/// Distance between the two fingers' contacts, for hands with two fingers.
pub(super) fn jaw_width(model: &HandModel<'_>, touches: &[Touch]) -> Option<f64> {
    if model.hand.fingers.len() != 2 {
        return None;
    }
    let of = |finger: usize| {
        touches
            .iter()
            .any(|t| model.hand.pads[t.pad].finger == finger)
            .then(|| mean_of(touches, |t| model.hand.pads[t.pad].finger == finger))
    };
    Some((of(0)? - of(1)?).norm())
}

pub(super) fn fingers_touching(model: &HandModel<'_>, touches: &[Touch]) -> usize {
    let fingers: BTreeSet<usize> = touches.iter().map(|t| model.hand.pads[t.pad].finger).collect();
    fingers.len()
}

/// Two fingers hold by opposing each other (Nguyen's test, with some slack for pads that are areas): the line between
/// their contacts must run inside both friction cones. More fingers hold in other ways too.
pub(super) fn opposed(model: &HandModel<'_>, touches: &[Touch], friction: f64) -> bool {
    let fingers: BTreeSet<usize> = touches.iter().map(|t| model.hand.pads[t.pad].finger).collect();
    let sides: Vec<(Vector3<f64>, Vector3<f64>)> = fingers
        .iter()
        .map(|finger| {
            let own = |t: &Touch| model.hand.pads[t.pad].finger == *finger;
            let inward: Vector3<f64> = touches.iter().filter(|t| own(t)).map(|t| t.inward.into_inner()).sum();
            (mean_of(touches, own), inward)
        })
        .collect();
    let [(a, into_a), (b, into_b)] = sides[..] else { return true };
    let least = (friction.atan() + OPPOSED_SLACK_RAD).min(std::f64::consts::FRAC_PI_2).cos();
    let along =
        |line: Vector3<f64>, inward: Vector3<f64>| line.dot(&inward) >= least * line.norm() * inward.norm();
    along(b - a, into_a) && along(a - b, into_b)
}

pub(super) fn touching_bodies(model: &HandModel<'_>, touches: &[Touch]) -> Vec<bool> {
    let mut touching = vec![false; model.hand.tree.bodies.len()];
    for t in touches {
        touching[t.body] = true;
    }
    touching
}
