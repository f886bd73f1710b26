//! A hand laid out for the iteration loop: bodies, contact candidates and spheres in flat arrays.
//!
//! Built once per plan from a [`Hand`]; nothing in here allocates after that.

use graspd_hands::{Hand, JointKind};
use nalgebra::{Matrix3, Vector3};

/// One moving body: everything that its joint's transform needs.
#[derive(Debug, Clone)]
pub(crate) struct BodyModel {
    /// Parent body; smaller than the own index.
    pub(crate) parent: usize,
    /// Rotation of the joint frame in the parent body.
    pub(crate) rotation: Matrix3<f64>,
    /// Origin of the joint frame in the parent body.
    pub(crate) origin: Vector3<f64>,
    /// Joint axis in the joint frame.
    pub(crate) axis: Vector3<f64>,
    /// Rotation or translation.
    pub(crate) revolute: bool,
    /// Index into the joint vector.
    pub(crate) joint: usize,
}

/// A point of a body with a direction (a contact candidate).
#[derive(Debug, Clone)]
pub(crate) struct PointModel {
    pub(crate) body: usize,
    pub(crate) point: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
}

/// A collision sphere of a body.
#[derive(Debug, Clone)]
pub(crate) struct SphereModel {
    pub(crate) body: usize,
    pub(crate) center: Vector3<f64>,
    pub(crate) radius: f64,
}

/// A hand for the optimizer.
#[derive(Debug, Clone)]
pub(crate) struct HandModel<'a> {
    pub(crate) hand: &'a Hand,
    /// Body 0 (the root) is not in the list: entry `i` is body `i + 1`.
    pub(crate) moving: Vec<BodyModel>,
    pub(crate) points: Vec<PointModel>,
    pub(crate) spheres: Vec<SphereModel>,
    /// Approach direction in the hand frame.
    pub(crate) approach: Vector3<f64>,
    /// Mean contact candidate with the hand open, hand frame: rotations turn about it.
    pub(crate) pivot: Vector3<f64>,
    pub(crate) joint_count: usize,
    pub(crate) coordinate_count: usize,
    /// Step scale of each coordinate: 1 for those that move joints by metres, see [`step_scale`].
    pub(crate) step_scale: Vec<f64>,
}

impl<'a> HandModel<'a> {
    pub(crate) fn new(hand: &'a Hand) -> Self {
        let tree = &hand.tree;
        let moving = tree
            .bodies
            .iter()
            .skip(1)
            .map(|b| {
                let j = b.joint.unwrap_or(0);
                let joint = &tree.joints[j];
                BodyModel {
                    parent: b.parent.unwrap_or(0),
                    rotation: *b.parent_from_joint.rotation.to_rotation_matrix().matrix(),
                    origin: b.parent_from_joint.translation.vector,
                    axis: joint.axis.into_inner(),
                    revolute: joint.kind == JointKind::Revolute,
                    joint: j,
                }
            })
            .collect();
        let points: Vec<PointModel> = hand
            .candidates
            .iter()
            .map(|c| PointModel { body: c.body, point: c.point.coords, normal: c.normal.into_inner() })
            .collect();
        let spheres = hand
            .spheres
            .iter()
            .map(|s| SphereModel { body: s.body, center: s.center.coords, radius: s.radius })
            .collect();
        let poses = tree.body_poses(&hand.actuation.joints(&hand.actuation.open()));
        let sum: Vector3<f64> = hand.candidates.iter().map(|c| (poses[c.body] * c.point).coords).sum();
        let pivot = sum / points.len().max(1) as f64;
        Self {
            hand,
            moving,
            points,
            spheres,
            approach: hand.approach.into_inner(),
            pivot,
            joint_count: tree.joints.len(),
            coordinate_count: hand.actuation.coordinates.len(),
            step_scale: step_scale(hand),
        }
    }
}

/// How many units of each coordinate move a fingertip by about a metre.
///
/// Adam takes steps of equal size in every variable. A metre of translation and a radian of a finger of
/// 0.1 m are not the same size of step: angles get longer steps, so that a finger closes as fast as a jaw.
fn step_scale(hand: &Hand) -> Vec<f64> {
    let q = hand.actuation.joints(&hand.actuation.open());
    let poses = hand.tree.body_poses(&q);
    (0..hand.actuation.coordinates.len())
        .map(|c| {
            let mut reach: f64 = 0.0;
            let mut angular = false;
            for (j, row) in hand.actuation.rows.iter().enumerate() {
                let Some(&(_, coefficient)) = row.terms.iter().find(|t| t.0 == c) else { continue };
                if hand.tree.joints[j].kind == JointKind::Prismatic {
                    reach = reach.max(coefficient.abs());
                    continue;
                }
                angular = true;
                let Some(body) = hand.tree.bodies.iter().position(|b| b.joint == Some(j)) else { continue };
                let origin = poses[body].translation.vector;
                for candidate in hand.candidates.iter().filter(|k| hand.tree.carries(body, k.body)) {
                    let arm = ((poses[candidate.body] * candidate.point).coords - origin).norm();
                    reach = reach.max(arm * coefficient.abs());
                }
            }
            match (angular, reach > 0.0) {
                (_, false) => 1.0,
                (true, true) => (1.0 / reach).clamp(1.0, 20.0),
                (false, true) => 1.0 / reach,
            }
        })
        .collect()
}
