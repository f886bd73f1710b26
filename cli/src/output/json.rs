//! Plans as JSON: SI units, world frame, quaternions as [x, y, z, w].

use graspd_planner::grasp::ObjectiveTerms;
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
                        "link": c.link,
                        "certainty": c.certainty,
                    })
                })
                .collect();
            json!({
                "wrist_link": g.wrist_link,
                "world_from_hand": pose(&g.world_from_hand),
                "camera_from_hand": pose(&g.camera_from_hand),
                "world_from_pregrasp": pose(&g.world_from_pregrasp),
                "camera_from_pregrasp": pose(&g.camera_from_pregrasp),
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
    let origin = &outcome.origin;
    let workspace = origin.workspace.map(|w| {
        json!({
            "world_from_volume": pose(&w.world_from_volume),
            "size_m": w.grid.size_m,
            "resolution": w.grid.resolution,
            "table_height_m": w.table_m,
        })
    });
    let mut plan = json!({
        "hand": outcome.hand,
        "hand_revision": origin.hand_revision,
        "estimator": origin.estimator,
        "seed": origin.seed,
        "workspace": workspace,
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
            "queue_ms": outcome.queue.as_secs_f64() * 1e3,
            "total_ms": outcome.total.as_secs_f64() * 1e3,
            "budget_exhausted": outcome.stopped,
        },
    });
    if !outcome.trace.is_empty() {
        plan["trace"] = outcome.trace.iter().map(terms).collect();
    }
    plan
}

/// The objective of one iteration.
fn terms(t: &ObjectiveTerms) -> Value {
    json!({
        "contact_distance": t.contact_distance,
        "certainty": t.certainty,
        "orientation": t.orientation,
        "centroid": t.centroid,
        "independence": t.independence,
        "net_wrench": t.net_wrench,
        "approach": t.approach,
        "joint_limits": t.joint_limits,
        "coupling": t.coupling,
        "penetration": t.penetration,
        "total": t.total,
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
        assert_eq!(grasp["contacts"][0]["link"], "left_link");
        assert_eq!(grasp["wrist_link"], "base");
        assert_eq!(grasp["camera_from_pregrasp"]["position"], json!([0.023, 0.012, 0.23]));
        assert_eq!(value["plans"][0]["no_grasp"], Value::Null);
        assert_eq!(value["plans"][0].get("trace"), None);
    }

    #[test]
    fn what_was_planned_with_is_told() {
        let mut outcome = fixtures::toy_outcome();
        outcome.origin.seed = 7;
        outcome.origin.hand_revision = "abc".into();
        outcome.origin.workspace = Some(fixtures::toy_scene().workspace);
        outcome.trace = vec![ObjectiveTerms { total: 2.5, ..ObjectiveTerms::default() }];
        outcome.total = std::time::Duration::from_millis(30);
        let plan = &plans(&[outcome])["plans"][0];
        assert_eq!((&plan["seed"], &plan["hand_revision"]), (&json!(7), &json!("abc")));
        assert_eq!(plan["workspace"]["table_height_m"], json!(0.1));
        assert_eq!(plan["workspace"]["resolution"], json!(80));
        assert_eq!(plan["trace"][0]["total"], json!(2.5));
        assert_eq!(plan["stats"]["total_ms"], json!(30.0));
    }
}
