//! A second way to close: the hand is placed anew with its fingers part of the way closed.
//!
//! The optimizer flattens a hand over a small object, since open fingers lie lower than curled ones, and fingers
//! that turn about their knuckles then meet somewhere else than where they were. Here the hand takes a few shapes
//! between open and closed; in each, the place where its pads balance each other goes to the object's centroid,
//! the hand is drawn back along its approach until it is free, and closed from there.

use nalgebra::Vector3;

use super::opposition;
use crate::balance;
use crate::configuration::Configuration;
use crate::objective::{Objective, Scratch};

/// Shapes that are tried: shares of the way from where the optimizer left the fingers to closed.
const SHAPES: [f64; 5] = [0.2, 0.4, 0.55, 0.7, 0.85];
/// A pad touches when a candidate is this close to the surface, voxels ...
const CONTACT_VOXELS: f64 = 1.5;
/// ... and faces it, by this cosine at least.
const ALIGNED: f64 = 0.2;
/// The hand is drawn back by at least this much at a time, metres ...
const LEAST_STEP_M: f64 = 0.001;
/// ... and this far at most.
const FARTHEST_M: f64 = 0.06;
/// Its spheres may then be this deep in the scene, voxels.
const FREE_VOXELS: f64 = 0.5;
/// Room between the hand and the table, metres.
const TABLE_ROOM_M: f64 = 0.003;

/// How well fingers hold: 0 where no two of those that touch face each other, else the sum over the touching fingers
/// of 1 at contact down to 0 at the distance that just counts as one.
pub(crate) fn hold(objective: &Objective<'_>, at: &Configuration, scratch: &mut Scratch) -> f64 {
    let model = objective.model;
    let hand = model.hand;
    scratch.kinematics.forward(model, at);
    let kinematics = &scratch.kinematics;
    let reach = CONTACT_VOXELS * objective.obstacles.grid.voxel_m();
    let mut nearness = vec![0.0_f64; hand.fingers.len()];
    let touches = model.points.iter().zip(&hand.candidates).filter_map(|(p, c)| {
        let point = kinematics.point(p.body, &p.point);
        let (gap, away) = objective.obstacles.scene(&point);
        let normal = kinematics.direction(p.body, &p.normal);
        if gap > reach || -normal.dot(&away) < ALIGNED * away.norm() {
            return None;
        }
        let finger = hand.pads[c.pad].finger;
        nearness[finger] = nearness[finger].max(1.0 - gap.max(0.0) / reach);
        Some((finger, point, normal))
    });
    let sides = opposition::sides(hand.fingers.len(), touches);
    if opposition::face_each_other(&sides) { nearness.iter().sum() } else { 0.0 }
}

/// Tries the shapes and leaves the best in `configuration`, if one holds; `close` closes the fingers of
/// a hand that has been drawn back so far (metres).
pub(crate) fn regrip(
    objective: &Objective<'_>,
    start: &Configuration,
    configuration: &mut Configuration,
    scratch: &mut Scratch,
    close: &mut dyn FnMut(&mut Configuration, f64, &mut Scratch),
) {
    let model = objective.model;
    let mean = {
        scratch.kinematics.forward(model, start);
        let points = model.points.iter().zip(&scratch.contacts.share);
        points.map(|(p, w)| scratch.kinematics.point(p.body, &p.point) * *w).sum::<Vector3<f64>>()
    };
    let apart = |p: &Vector3<f64>| (p - mean).norm_squared();
    let centroids = objective.centroids.iter().map(|c| c.position.coords);
    let Some(target) = centroids.min_by(|a, b| apart(a).total_cmp(&apart(b))) else { return };
    let back = -(start.rotation * model.approach);
    let mut best: Option<(f64, Configuration)> = None;
    for shape in SHAPES {
        let mut at = start.clone();
        for (u, c) in at.coordinates.iter_mut().zip(&model.hand.actuation.coordinates) {
            if c.closed != c.open {
                *u += shape * (c.closed - *u);
            }
        }
        scratch.kinematics.forward(model, &at);
        let normals: Vec<Vector3<f64>> =
            model.points.iter().map(|p| scratch.kinematics.direction(p.body, &p.normal)).collect();
        let shares = balance::shares(&normals, model.hand.pads.len());
        let grip: Vector3<f64> = model
            .points
            .iter()
            .zip(&shares)
            .map(|(p, w)| scratch.kinematics.point(p.body, &p.point) * *w)
            .sum();
        at.translation += target - grip;
        let began = at.translation;
        if !draw_back(objective, &mut at, &back, scratch) {
            continue;
        }
        let drawn = (at.translation - began).norm();
        close(&mut at, drawn, scratch);
        let hold = hold(objective, &at, scratch);
        if hold > best.as_ref().map_or(0.0, |b| b.0) {
            best = Some((hold, at));
        }
    }
    if let Some((_, best)) = best {
        configuration.copy_from(&best);
    }
}

/// Draws the hand back until nothing of it is in the scene or too near to the table; false where that is too far.
fn draw_back(
    objective: &Objective<'_>,
    at: &mut Configuration,
    back: &Vector3<f64>,
    scratch: &mut Scratch,
) -> bool {
    let model = objective.model;
    let mut drawn = 0.0;
    loop {
        scratch.kinematics.forward(model, at);
        objective.place_spheres(scratch);
        let tolerance = FREE_VOXELS * objective.obstacles.grid.voxel_m();
        let mut deepest = f64::NEG_INFINITY;
        for (s, center) in model.spheres.iter().zip(&scratch.centers) {
            deepest = deepest.max(s.radius - objective.obstacles.scene(center).0 - tolerance);
            if let Some(table) = objective.obstacles.table_m {
                deepest = deepest.max(s.radius - (center.z - table) + TABLE_ROOM_M);
            }
        }
        if deepest <= 0.0 {
            return true;
        }
        let step = deepest + LEAST_STEP_M;
        drawn += step;
        if drawn > FARTHEST_M {
            return false;
        }
        at.translation += back * step;
    }
}
