//! Plans as JSON: SI units, world frame, quaternions as [x, y, z, w].

use nalgebra::Isometry3;
use serde_json::{Map, Value, json};

use crate::outcome::{Named, Outcome};

/// The answer for every hand.
pub(crate) fn plans(outcomes: &[Outcome]) -> Value {
    json!({ "plans": outcomes.iter().map(plan).collect::<Vec<_>>() })
}

fn plan(outcome: &Outcome) -> Value {
    let stages: Map<String, Value> =
        outcome.stages.iter().map(|(name, d)| (name.clone(), json!(d.as_secs_f64() * 1e3))).collect();
    let grasps: Vec<Value> = outcome
        .grasps
        .iter()
        .map(|g| {
            let contacts: Vec<Value> = g
                .contacts
                .iter()
                .map(|c| {
                    json!({
                        "point": c.point.coords.as_slice(),
                        "normal": c.normal.as_slice(),
                        "pad": c.pad,
                        "finger": c.finger,
                        "certainty": c.certainty,
                    })
                })
                .collect();
            json!({
                "world_from_hand": pose(&g.world_from_hand),
                "camera_from_hand": pose(&g.camera_from_hand),
                "world_from_pregrasp": pose(&g.world_from_pregrasp),
                "joints": named(&g.joints),
                "actuators": named(&g.actuators),
                "contacts": contacts,
                "jaw_width_m": g.jaw_width_m,
                "score": g.score,
                "score_parts": {
                    "objective": g.parts.objective,
                    "force_closure": g.parts.force_closure,
                    "clearance": g.parts.clearance,
                    "certainty": g.parts.certainty,
                },
                "objective": g.objective,
                "epsilon": g.epsilon,
                "clearance_m": g.clearance_m,
                "centroid": g.centroid.coords.as_slice(),
                "label": g.label,
            })
        })
        .collect();
    json!({
        "hand": outcome.hand,
        "grasps": grasps,
        "no_grasp": outcome.no_grasp.as_ref().map(|(reason, fix)| json!({ "reason": reason, "nearest_fix": fix })),
        "stats": {
            "focal_contacts": outcome.focal_contacts,
            "focal_centroids": outcome.focal_centroids,
            "centered_centroids": outcome.centered_centroids,
            "candidates": outcome.candidates,
            "iterations": outcome.iterations,
            "rejected": outcome.rejected,
            "stages_ms": stages,
            "budget_exhausted": outcome.stopped,
        },
    })
}

fn pose(pose: &Isometry3<f64>) -> Value {
    json!({
        "position": pose.translation.vector.as_slice(),
        "orientation_xyzw": pose.rotation.coords.as_slice(),
    })
}

fn named(named: &Named) -> Value {
    json!({
        "names": named.names,
        "open": named.values.open,
        "contact": named.values.contact,
        "squeezed": named.values.squeezed,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::fixtures;

    #[test]
    fn grasps_keep_their_frames_and_units() {
        let value = plans(&[fixtures::toy_outcome()]);
        let grasp = &value["plans"][0]["grasps"][0];
        assert_eq!(grasp["world_from_hand"]["position"], json!([0.023, 0.012, 0.13]));
        assert_eq!(grasp["actuators"]["squeezed"], json!([0.02]));
        assert_eq!(grasp["contacts"][0]["finger"], "left");
        assert_eq!(value["plans"][0]["no_grasp"], Value::Null);
    }
}
