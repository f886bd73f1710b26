//! Fingers of a URDF: chains that end in a movable part with collision geometry.

use nalgebra::Point3;

use crate::urdf::Model;

/// A finger.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    /// Name: that of the link that carries the last part's shapes.
    pub(super) name: String,
    /// Bodies that belong to this finger alone, from the palm outwards; the last carries the pad.
    pub(super) bodies: Vec<usize>,
    /// Middle of the last body's shapes, in its frame.
    pub(super) tip: Point3<f64>,
}

impl Chain {
    /// The body at the end.
    pub(super) fn last(&self) -> usize {
        self.bodies.last().copied().unwrap_or_default()
    }
}

/// Finds the fingers.
pub(super) fn find(model: &Model) -> Vec<Chain> {
    let tree = &model.tree;
    let mut ends: Vec<usize> = Vec::new();
    for leaf in 1..tree.bodies.len() {
        if tree.bodies.iter().any(|b| b.parent == Some(leaf)) {
            continue;
        }
        // A last joint that carries nothing solid (a sensor frame) leaves the part before it as the end.
        let mut at = leaf;
        while at != 0 && bounds(model, at).is_none() {
            at = tree.bodies[at].parent.unwrap_or(0);
        }
        if at != 0 && !ends.contains(&at) {
            ends.push(at);
        }
    }
    // An end that carries another end is no end.
    let all = ends.clone();
    ends.retain(|&e| !all.iter().any(|&other| other != e && tree.carries(e, other)));
    ends.iter()
        .filter_map(|&end| {
            let mut bodies = Vec::new();
            let mut at = Some(end);
            while let Some(body) = at {
                let shared = ends.iter().any(|&other| other != end && tree.carries(body, other));
                if body == 0 || shared {
                    break;
                }
                bodies.push(body);
                at = tree.bodies[body].parent;
            }
            bodies.reverse();
            let (low, high) = bounds(model, end)?;
            let link = model.collision.iter().find(|s| tree.links[s.link].body == end)?.link;
            Some(Chain { name: tree.links[link].name.clone(), bodies, tip: nalgebra::center(&low, &high) })
        })
        .collect()
}

/// Bounds of a body's shapes in its frame; `None` without shapes.
pub(super) fn bounds(model: &Model, body: usize) -> Option<(Point3<f64>, Point3<f64>)> {
    let mut out: Option<(Point3<f64>, Point3<f64>)> = None;
    for (_, _, solid) in super::solids(model, body) {
        let (low, high) = solid.bounds();
        out = Some(out.map_or((low, high), |(l, h)| (l.inf(&low), h.sup(&high))));
    }
    out
}
