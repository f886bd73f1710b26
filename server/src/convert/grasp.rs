//! Plans on the wire.

use std::collections::HashMap;
use std::time::Duration;

use graspd_hands::{CoordinateKind, Hand};
use graspd_planner::budget::Stop;
use graspd_planner::grasp::{
    BETTER_NOT, EmptyReason, Grasp, NoGrasp, ObjectiveTerms, Plan, PlanStats, Postures, ScoreParts,
};
use graspd_planner::workspace::Workspace;
use graspd_proto::v1;

use super::geometry::{pose_message, vector_message};
use super::{count_message, duration_message, hand_name};
use crate::calibration::Calibration;

/// What a plan does not know of itself and its answer needs.
#[derive(Debug, Clone)]
pub(crate) struct PlanContext<'a> {
    /// The hand that was planned for.
    pub(crate) hand: &'a Hand,
    /// Name of the world frame.
    pub(crate) world: &'a str,
    /// Name of the first camera's optical frame.
    pub(crate) camera: &'a str,
    /// When the first frame was taken, as sent.
    pub(crate) capture_time: Option<prost_types::Timestamp>,
    /// The estimator's name.
    pub(crate) estimator: &'a str,
    /// The seed.
    pub(crate) seed: u64,
    /// The plan's name.
    pub(crate) plan_id: &'a str,
    /// What scores become.
    pub(crate) calibration: Option<&'a Calibration>,
    /// Stages before those that the plan has timed: decode.
    pub(crate) stages: &'a [(&'static str, Duration)],
    /// Depth pixels that could not be distances.
    pub(crate) invalid_pixels: usize,
    /// Time in the queue.
    pub(crate) queued: Duration,
    /// Time since the call arrived.
    pub(crate) elapsed: Duration,
}

/// The answer for a plan.
pub(crate) fn plan_response(
    plan: &Plan,
    workspace: &Workspace,
    context: &PlanContext<'_>,
) -> v1::PlanGraspsResponse {
    v1::PlanGraspsResponse {
        grasps: plan.grasps.iter().map(|g| grasp_message(g, context)).collect(),
        no_grasp: plan.no_grasp.as_ref().map(no_grasp_message),
        workspace: Some(workspace_message(workspace, context.world)),
        stats: Some(stats_message(&plan.stats, context)),
        trace: plan.trace.iter().map(objective_message).collect(),
        capture_time: context.capture_time,
        plan_id: context.plan_id.to_owned(),
        recorded: false,
        calibration: context.calibration.map(calibration_message),
    }
}

/// The answer when the caller's budget ended before there was a scene to plan in.
pub(crate) fn out_of_time_response(context: &PlanContext<'_>) -> v1::PlanGraspsResponse {
    let stats = PlanStats { stopped: Some(Stop::Deadline), ..PlanStats::default() };
    let no_grasp = NoGrasp {
        reason: EmptyReason::OutOfTime,
        nearest_fix: format!(
            "the budget ended after {:?}, before the scene was read; allow more",
            context.elapsed
        ),
    };
    v1::PlanGraspsResponse {
        grasps: Vec::new(),
        no_grasp: Some(no_grasp_message(&no_grasp)),
        workspace: None,
        stats: Some(stats_message(&stats, context)),
        trace: Vec::new(),
        capture_time: context.capture_time,
        plan_id: context.plan_id.to_owned(),
        recorded: false,
        calibration: context.calibration.map(calibration_message),
    }
}

/// A grasp on the wire.
pub(super) fn grasp_message(grasp: &Grasp, context: &PlanContext<'_>) -> v1::Grasp {
    let hand = context.hand;
    let camera_from_world = grasp.camera_from_hand * grasp.world_from_hand.inverse();
    let camera_from_pregrasp = camera_from_world * grasp.world_from_pregrasp;
    let score = context.calibration.map_or(grasp.score, |c| c.share(grasp.score));
    let joint_names = hand.tree.joints.iter().map(|j| j.name.clone()).collect();
    let actuator_names = (hand.actuation.coordinates.iter())
        .filter(|c| c.kind == CoordinateKind::Actuator)
        .map(|c| c.name.clone())
        .collect();
    v1::Grasp {
        wrist_link: hand.tree.links.first().map_or_else(String::new, |l| l.name.clone()),
        wrist_pose: Some(pose_message(context.world, &grasp.world_from_hand)),
        wrist_pose_in_camera: Some(pose_message(context.camera, &grasp.camera_from_hand)),
        pregrasp_pose: Some(pose_message(context.world, &grasp.world_from_pregrasp)),
        pregrasp_pose_in_camera: Some(pose_message(context.camera, &camera_from_pregrasp)),
        joints: Some(postures_message(joint_names, &grasp.joints)),
        actuators: Some(postures_message(actuator_names, &grasp.actuators)),
        contacts: grasp.contacts.iter().map(|c| contact_message(c, hand)).collect(),
        jaw_width_m: grasp.jaw_width_m,
        score,
        score_parts: Some(parts_message(&grasp.parts)),
        objective: Some(objective_message(&grasp.objective)),
        epsilon: grasp.epsilon,
        clearance_m: grasp.clearance_m,
        centroid: Some(vector_message(&grasp.centroid.coords)),
        label: grasp.label.map(i32::from),
        uncalibrated_score: grasp.score,
        better_not: score < BETTER_NOT,
    }
}

fn calibration_message(calibration: &Calibration) -> v1::ScoreCalibration {
    let seconds = calibration.created_unix_s;
    v1::ScoreCalibration {
        name: calibration.name.clone(),
        outcome_count: i32::try_from(calibration.outcome_count).unwrap_or(i32::MAX),
        create_time: Some(prost_types::Timestamp { seconds, nanos: 0 }),
    }
}

fn postures_message(names: Vec<String>, postures: &Postures) -> v1::Postures {
    v1::Postures {
        names,
        open: postures.open.clone(),
        contact: postures.contact.clone(),
        squeezed: postures.squeezed.clone(),
    }
}

fn contact_message(contact: &graspd_planner::grasp::GraspContact, hand: &Hand) -> v1::Contact {
    let pad = hand.pads.get(contact.pad);
    let link = pad.and_then(|p| hand.tree.links.get(p.link));
    v1::Contact {
        point: Some(vector_message(&contact.point.coords)),
        normal: Some(vector_message(&contact.normal)),
        pad: pad.map_or_else(String::new, |p| p.name.clone()),
        finger: hand.fingers.get(contact.finger).map_or_else(String::new, |f| f.name.clone()),
        link: link.map_or_else(String::new, |l| l.name.clone()),
        certainty: contact.certainty,
    }
}

fn parts_message(parts: &ScoreParts) -> v1::ScoreParts {
    v1::ScoreParts {
        objective: parts.objective,
        force_closure: parts.force_closure,
        clearance: parts.clearance,
        certainty: parts.certainty,
    }
}

fn objective_message(terms: &ObjectiveTerms) -> v1::ObjectiveTerms {
    v1::ObjectiveTerms {
        contact_distance: terms.contact_distance,
        certainty: terms.certainty,
        orientation: terms.orientation,
        centroid: terms.centroid,
        independence: terms.independence,
        net_wrench: terms.net_wrench,
        approach: terms.approach,
        joint_limits: terms.joint_limits,
        coupling: terms.coupling,
        penetration: terms.penetration,
        total: terms.total,
    }
}

pub(super) fn workspace_message(workspace: &Workspace, world: &str) -> v1::Workspace {
    v1::Workspace {
        pose: Some(pose_message(world, &workspace.world_from_volume)),
        size_m: workspace.grid.size_m,
        resolution: count_message(workspace.grid.resolution),
        table_height_m: workspace.table_m,
    }
}

pub(super) fn stage_message((name, duration): &(&'static str, Duration)) -> v1::StageDuration {
    v1::StageDuration { name: (*name).to_owned(), duration: Some(duration_message(*duration)) }
}

fn stats_message(stats: &PlanStats, context: &PlanContext<'_>) -> v1::PlanStats {
    let stages = context.stages.iter().chain(&stats.stages).map(stage_message).collect();
    let rejected_counts: HashMap<String, i32> =
        stats.rejected.iter().map(|(reason, &n)| (reason.as_str().to_owned(), count_message(n))).collect();
    v1::PlanStats {
        stages,
        queue_duration: Some(duration_message(context.queued)),
        total_duration: Some(duration_message(context.elapsed)),
        focal_contact_count: count_message(stats.focal_contacts),
        focal_centroid_count: count_message(stats.focal_centroids),
        centered_centroid_count: count_message(stats.centered_centroids),
        candidate_count: count_message(stats.candidates),
        iteration_count: count_message(stats.iterations),
        rejected_counts,
        budget_exhausted: stats.stopped == Some(Stop::Deadline),
        estimator: context.estimator.to_owned(),
        hand: hand_name(&context.hand.id),
        hand_revision: context.hand.revision.clone(),
        seed: context.seed,
        invalid_pixel_count: i64::try_from(context.invalid_pixels).unwrap_or(i64::MAX),
    }
}

fn no_grasp_message(no_grasp: &NoGrasp) -> v1::NoGrasp {
    let reason = match no_grasp.reason {
        EmptyReason::NothingSeen => v1::NoGraspReason::NothingSeen,
        EmptyReason::EmptyTable => v1::NoGraspReason::EmptyTable,
        EmptyReason::NoContacts => v1::NoGraspReason::NoContacts,
        EmptyReason::NoCentroid => v1::NoGraspReason::NoCentroid,
        EmptyReason::TargetNotFound => v1::NoGraspReason::TargetNotFound,
        EmptyReason::HandTooSmall => v1::NoGraspReason::HandTooSmall,
        EmptyReason::HandTooLarge => v1::NoGraspReason::HandTooLarge,
        EmptyReason::AllRejected => v1::NoGraspReason::AllRejected,
        EmptyReason::OutOfTime => v1::NoGraspReason::OutOfTime,
        _ => v1::NoGraspReason::Unspecified,
    };
    v1::NoGrasp { reason: reason.into(), nearest_fix: no_grasp.nearest_fix.clone() }
}
