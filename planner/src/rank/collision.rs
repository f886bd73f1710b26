//! Collision checks of a finished configuration: scene, table, keep-out boxes, itself, the approach.

use nalgebra::Vector3;

use crate::configuration::Configuration;
use crate::objective::{Objective, Obstacles, Scratch};

/// Spheres may be this deep in voxels of the scene: one voxel, the resolution of what was seen.
pub(crate) const SCENE_TOLERANCE_M: f64 = 0.005;
/// Spheres may be this deep in the table, metres.
pub(crate) const TABLE_TOLERANCE_M: f64 = 0.002;
/// Spheres of different fingers may overlap by this much, metres.
pub(crate) const SELF_TOLERANCE_M: f64 = 0.003;
/// Distance between two checked poses of the approach, metres.
const APPROACH_STEP_M: f64 = 0.008;

/// How deep a configuration is in what; metres, negative is room.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Depths {
    pub(crate) scene: f64,
    pub(crate) table: f64,
    pub(crate) keep_out: f64,
    pub(crate) itself: f64,
    /// Fingers that are in the scene deeper than the tolerance.
    pub(crate) fingers_in_scene: usize,
    /// Room around the parts of the hand that do not touch, metres.
    pub(crate) room: f64,
}

/// Checks one configuration. `touching` says for each body whether a contact belongs to it: its spheres
/// are expected at the surface and do not count for the room.
pub(crate) fn depths(
    objective: &Objective<'_>,
    configuration: &Configuration,
    touching: &[bool],
    scratch: &mut Scratch,
) -> Depths {
    let model = objective.model;
    scratch.kinematics.forward(model, configuration);
    objective.place_spheres(scratch);
    let never = f64::NEG_INFINITY;
    let mut all = Depths {
        scene: never,
        table: never,
        keep_out: never,
        itself: never,
        fingers_in_scene: 0,
        room: f64::INFINITY,
    };
    let mut deep = vec![false; model.hand.tree.bodies.len()];
    for (s, center) in model.spheres.iter().zip(&scratch.centers) {
        let scene = s.radius - objective.obstacles.scene(center).0;
        all.scene = all.scene.max(scene);
        deep[s.body] |= scene > SCENE_TOLERANCE_M;
        let mut worst = scene;
        if let Some(table) = objective.obstacles.table_m {
            let into = s.radius - (center.z - table);
            all.table = all.table.max(into);
            worst = worst.max(into);
        }
        for (pose, half) in &objective.obstacles.boxes {
            let into = s.radius - Obstacles::keep_out(pose, half, center).0;
            all.keep_out = all.keep_out.max(into);
            worst = worst.max(into);
        }
        if !touching[s.body] {
            all.room = all.room.min(-worst);
        }
    }
    for &(a, b) in &model.hand.self_pairs {
        let gap = (scratch.centers[a] - scratch.centers[b]).norm();
        all.itself = all.itself.max(model.spheres[a].radius + model.spheres[b].radius - gap);
    }
    let mut finger_deep = vec![false; model.hand.fingers.len()];
    for pad in &model.hand.pads {
        finger_deep[pad.finger] |= deep[model.hand.tree.links[pad.link].body];
    }
    all.fingers_in_scene = finger_deep.iter().filter(|d| **d).count();
    all
}

/// The worst of the straight approach: from `back` metres before the grasp to the grasp, hand open.
///
/// Returns the largest depth in anything (metres, negative is room).
pub(crate) fn approach_depth(
    objective: &Objective<'_>,
    grasp: &Configuration,
    open: &[f64],
    back: f64,
    scratch: &mut Scratch,
) -> f64 {
    let mut moving = grasp.clone();
    moving.coordinates.copy_from_slice(open);
    let axis: Vector3<f64> = grasp.rotation * objective.model.approach;
    let steps = (back / APPROACH_STEP_M).ceil().max(1.0) as usize;
    let mut worst = f64::NEG_INFINITY;
    for k in 0..=steps {
        let along = back * k as f64 / steps as f64;
        moving.translation = grasp.translation - axis * along;
        scratch.kinematics.forward(objective.model, &moving);
        objective.place_spheres(scratch);
        for (s, center) in objective.model.spheres.iter().zip(&scratch.centers) {
            let mut into = s.radius - objective.obstacles.scene(center).0 - SCENE_TOLERANCE_M;
            if let Some(table) = objective.obstacles.table_m {
                into = into.max(s.radius - (center.z - table) - TABLE_TOLERANCE_M);
            }
            for (pose, half) in &objective.obstacles.boxes {
                into = into.max(s.radius - Obstacles::keep_out(pose, half, center).0);
            }
            worst = worst.max(into);
        }
    }
    worst
}
