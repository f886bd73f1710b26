//! Where a grasp begins and what it is meant for: the hand set down at the pre-grasp, the object between its pads.

use std::sync::Arc;

use graspd_hands::{CoordinateKind, Hand};
use nalgebra::{Point3, Vector3};

use super::GraspCommand;
use crate::world::{HandId, ObjectId, World};

/// Puts a hand into the world at the pre-grasp, its fingers as they approach.
pub fn set_down(world: &mut World, hand: &Arc<Hand>, grasp: &GraspCommand) -> HandId {
    world.add_hand(Arc::clone(hand), &grasp.world_from_pregrasp, &coordinates(hand, &grasp.open))
}

/// A hand's coordinates from its actuators' positions. A command names actuators only: adaptive coordinates, and
/// actuators that it does not name, are open.
fn coordinates(hand: &Hand, actuators: &[f64]) -> Vec<f64> {
    let mut all = hand.actuation.open();
    let driven = all.iter_mut().zip(&hand.actuation.coordinates);
    let driven = driven.filter(|(_, c)| c.kind == CoordinateKind::Actuator);
    driven.zip(actuators).for_each(|((value, _), actuator)| *value = *actuator);
    all
}

/// The object nearest to the middle of the pads at the grasp; of those that contain it, the one whose origin is
/// nearest.
pub(super) fn meant(world: &World, hand: &Hand, grasp: &GraspCommand) -> Option<ObjectId> {
    let joints = hand.actuation.joints(&coordinates(hand, &grasp.contact));
    let links = hand.tree.link_poses(&hand.tree.body_poses(&joints));
    let sum = hand.pads.iter().fold(Vector3::zeros(), |sum, p| sum + (links[p.link] * p.center).coords);
    let middle = grasp.world_from_hand * Point3::from(sum / hand.pads.len().max(1) as f64);
    let nearness = |id: &ObjectId| {
        let outside = world.distance(*id, &middle).unwrap_or(f64::INFINITY).max(0.0);
        let origin = world.pose(*id).map_or(f64::INFINITY, |p| (p.translation.vector - middle.coords).norm());
        (outside, origin)
    };
    world.ids().into_iter().min_by(|a, b| {
        let ((a, at), (b, bt)) = (nearness(a), nearness(b));
        a.total_cmp(&b).then(at.total_cmp(&bt))
    })
}
