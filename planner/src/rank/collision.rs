//! Collision checks of a finished configuration: scene, table, keep-out boxes, itself, the approach.

use nalgebra::Vector3;

use crate::configuration::Configuration;
use crate::objective::{Objective, Obstacles, Scratch};

/// Spheres may be this deep in the scene, voxels: the resolution of what was seen.
pub(crate) const SCENE_TOLERANCE_VOXELS: f64 = 1.0;
/// Spheres may be this deep in the table, metres; negative: they keep this far from it. A depth camera knows the
/// table's height to some millimetres (Supplementary Fig. 8b).
pub(crate) const TABLE_TOLERANCE_M: f64 = -0.001;
/// Spheres of different fingers may overlap by this much, metres.
pub(crate) const SELF_TOLERANCE_M: f64 = 0.003;
/// On the way spheres may be this deep in the scene, voxels: nothing is meant to touch there.
const APPROACH_TOLERANCE_VOXELS: f64 = 0.5;
/// Distance between two checked poses of the approach, metres.
const APPROACH_STEP_M: f64 = 0.008;

/// Postures that are checked between open and contact.
const CLOSING_STEPS: usize = 8;

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
    let tolerance = SCENE_TOLERANCE_VOXELS * objective.obstacles.grid.voxel_m();
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
        deep[s.body] |= scene > tolerance;
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

/// What the straight approach and the closing after it meet, metres.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Approach {
    /// Largest depth beyond the tolerances in anything; negative is room.
    pub(crate) depth: f64,
    /// Room around the parts of the hand that do not touch at the grasp.
    pub(crate) room: f64,
}

/// Checks the straight approach, from `back` metres before the grasp to the grasp, hand open, and the closing there,
/// from open to contact.
pub(crate) fn approach(
    objective: &Objective<'_>,
    grasp: &Configuration,
    open: &[f64],
    back: f64,
    touching: &[bool],
    scratch: &mut Scratch,
) -> Approach {
    let mut moving = grasp.clone();
    moving.coordinates.copy_from_slice(open);
    let axis: Vector3<f64> = grasp.rotation * objective.model.approach;
    let steps = (back / APPROACH_STEP_M).ceil().max(1.0) as usize;
    let tolerance = APPROACH_TOLERANCE_VOXELS * objective.obstacles.grid.voxel_m();
    let mut met = Approach { depth: f64::NEG_INFINITY, room: f64::INFINITY };
    let mut look = |moving: &Configuration| {
        scratch.kinematics.forward(objective.model, moving);
        objective.place_spheres(scratch);
        for (s, center) in objective.model.spheres.iter().zip(&scratch.centers) {
            let scene = s.radius - objective.obstacles.scene(center).0;
            let (mut depth, mut into) = (scene - tolerance, scene);
            if let Some(table) = objective.obstacles.table_m {
                let table = s.radius - (center.z - table);
                depth = depth.max(table - TABLE_TOLERANCE_M);
                into = into.max(table);
            }
            for (pose, half) in &objective.obstacles.boxes {
                let inside = s.radius - Obstacles::keep_out(pose, half, center).0;
                depth = depth.max(inside);
                into = into.max(inside);
            }
            met.depth = met.depth.max(depth);
            if !touching[s.body] {
                met.room = met.room.min(-into);
            }
        }
    };
    for k in 0..=steps {
        moving.translation = grasp.translation - axis * (back * k as f64 / steps as f64);
        look(&moving);
    }
    // Fingers that close swing through what lies between open and contact.
    moving.translation = grasp.translation;
    for k in 1..CLOSING_STEPS {
        let share = k as f64 / CLOSING_STEPS as f64;
        for ((slot, open), contact) in moving.coordinates.iter_mut().zip(open).zip(&grasp.coordinates) {
            *slot = open + share * (contact - open);
        }
        look(&moving);
    }
    met
}
