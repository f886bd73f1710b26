//! Answers from the wire.

use std::time::Duration;

use anyhow::Context as _;
use graspd_planner::grasp::{ObjectiveTerms, Postures, ScoreParts};
use graspd_planner::grid::Grid;
use graspd_planner::workspace::Workspace;
use graspd_proto::v1;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use crate::outcome::{ContactOutcome, GraspOutcome, Named, Origin, Outcome};

/// The answer for a hand.
///
/// # Errors
/// If the server left out what the protocol promises.
pub(crate) fn outcome(hand: &str, response: &v1::PlanGraspsResponse) -> anyhow::Result<Outcome> {
    let stats = response.stats.clone().unwrap_or_default();
    let count = |n: i32| usize::try_from(n).unwrap_or(0);
    let duration = |d: &Option<_>| d.and_then(|d| Duration::try_from(d).ok()).unwrap_or_default();
    let origin = Origin {
        workspace: response.workspace.as_ref().map(workspace).transpose()?,
        estimator: stats.estimator.clone(),
        seed: stats.seed,
        hand_revision: stats.hand_revision.clone(),
    };
    Ok(Outcome {
        hand: hand.to_owned(),
        grasps: response.grasps.iter().map(grasp).collect::<anyhow::Result<_>>()?,
        no_grasp: response.no_grasp.as_ref().map(|n| (reason(n.reason()), n.nearest_fix.clone())),
        focal_contacts: count(stats.focal_contact_count),
        focal_centroids: count(stats.focal_centroid_count),
        centered_centroids: count(stats.centered_centroid_count),
        candidates: count(stats.candidate_count),
        iterations: count(stats.iteration_count),
        rejected: stats.rejected_counts.iter().map(|(r, &n)| (r.clone(), count(n))).collect(),
        stages: stats.stages.iter().map(|s| (s.name.clone(), duration(&s.duration))).collect(),
        stopped: stats.budget_exhausted,
        origin,
        queue: duration(&stats.queue_duration),
        total: duration(&stats.total_duration),
        trace: response.trace.iter().map(terms).collect(),
    })
}

fn workspace(workspace: &v1::Workspace) -> anyhow::Result<Workspace> {
    let resolution = usize::try_from(workspace.resolution)
        .with_context(|| format!("the server's answer has a workspace of {} voxels", workspace.resolution))?;
    Ok(Workspace {
        world_from_volume: pose(&workspace.pose, "workspace.pose")?,
        grid: Grid { resolution, size_m: workspace.size_m },
        table_m: workspace.table_height_m,
    })
}

fn terms(t: &v1::ObjectiveTerms) -> ObjectiveTerms {
    ObjectiveTerms {
        contact_distance: t.contact_distance,
        certainty: t.certainty,
        orientation: t.orientation,
        centroid: t.centroid,
        independence: t.independence,
        net_wrench: t.net_wrench,
        approach: t.approach,
        joint_limits: t.joint_limits,
        coupling: t.coupling,
        penetration: t.penetration,
        total: t.total,
    }
}

/// The reason as tables and the planner call it, for example `empty_table`.
fn reason(reason: v1::NoGraspReason) -> String {
    reason.as_str_name().trim_start_matches("NO_GRASP_REASON_").to_lowercase()
}

fn grasp(grasp: &v1::Grasp) -> anyhow::Result<GraspOutcome> {
    let parts = grasp.score_parts.unwrap_or_default();
    Ok(GraspOutcome {
        wrist_link: grasp.wrist_link.clone(),
        world_from_hand: pose(&grasp.wrist_pose, "wrist_pose")?,
        camera_from_hand: pose(&grasp.wrist_pose_in_camera, "wrist_pose_in_camera")?,
        world_from_pregrasp: pose(&grasp.pregrasp_pose, "pregrasp_pose")?,
        camera_from_pregrasp: pose(&grasp.pregrasp_pose_in_camera, "pregrasp_pose_in_camera")?,
        joints: named(&grasp.joints),
        actuators: named(&grasp.actuators),
        contacts: grasp.contacts.iter().map(contact).collect::<anyhow::Result<_>>()?,
        jaw_width_m: grasp.jaw_width_m,
        score: grasp.score,
        parts: ScoreParts {
            objective: parts.objective,
            force_closure: parts.force_closure,
            clearance: parts.clearance,
            certainty: parts.certainty,
        },
        objective: grasp.objective.as_ref().map_or(0.0, |o| o.total),
        epsilon: grasp.epsilon,
        clearance_m: grasp.clearance_m,
        centroid: Point3::from(vector(&grasp.centroid, "centroid")?),
        label: grasp.label.and_then(|l| u8::try_from(l).ok()),
    })
}

fn contact(contact: &v1::Contact) -> anyhow::Result<ContactOutcome> {
    Ok(ContactOutcome {
        point: Point3::from(vector(&contact.point, "contacts.point")?),
        normal: Unit::new_normalize(vector(&contact.normal, "contacts.normal")?),
        pad: contact.pad.clone(),
        finger: contact.finger.clone(),
        link: contact.link.clone(),
        certainty: contact.certainty,
    })
}

fn named(postures: &Option<v1::Postures>) -> Named {
    let p = postures.clone().unwrap_or_default();
    Named { names: p.names, values: Postures { open: p.open, contact: p.contact, squeezed: p.squeezed } }
}

fn vector(v: &Option<v1::Vector3>, field: &str) -> anyhow::Result<Vector3<f64>> {
    let v = v.as_ref().with_context(|| format!("the server's answer has no {field}"))?;
    Ok(Vector3::new(v.x, v.y, v.z))
}

fn pose(pose: &Option<v1::PoseInFrame>, field: &str) -> anyhow::Result<Isometry3<f64>> {
    let missing = || format!("the server's answer has no {field}");
    let pose = pose.as_ref().and_then(|p| p.pose.as_ref()).with_context(missing)?;
    let q = pose.orientation.as_ref().with_context(missing)?;
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(q.w, q.x, q.y, q.z));
    Ok(Isometry3::from_parts(Translation3::from(vector(&pose.position, field)?), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_called_as_the_planner_calls_them() {
        use graspd_planner::grasp::EmptyReason;
        assert_eq!(reason(v1::NoGraspReason::EmptyTable), EmptyReason::EmptyTable.as_str());
        assert_eq!(reason(v1::NoGraspReason::AllRejected), EmptyReason::AllRejected.as_str());
        assert_eq!(reason(v1::NoGraspReason::NoContacts), EmptyReason::NoContacts.as_str());
    }

    #[test]
    fn a_grasp_without_a_pose_is_an_error_that_names_it() {
        let response = v1::PlanGraspsResponse { grasps: vec![v1::Grasp::default()], ..Default::default() };
        let message = outcome("leap", &response).unwrap_err().to_string();
        assert_eq!(message, "the server's answer has no wrist_pose");
    }
}
