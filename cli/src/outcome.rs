//! What planning for one hand came to, whether it was planned here or by a server.
//!
//! Tables, JSON, pictures and pages read this type only.

use std::collections::BTreeMap;
use std::time::Duration;

use graspd_hands::Hand;
use graspd_planner::grasp::{EmptyReason, Grasp, ObjectiveTerms, Plan, Postures, ScoreParts};
use graspd_planner::workspace::Workspace;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

/// The answer for one hand.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outcome {
    /// Id of the hand.
    pub(crate) hand: String,
    /// Best first.
    pub(crate) grasps: Vec<GraspOutcome>,
    /// Reason and nearest fix, when there is no grasp.
    pub(crate) no_grasp: Option<(String, String)>,
    /// `N_fc`.
    pub(crate) focal_contacts: usize,
    /// `N_fe`.
    pub(crate) focal_centroids: usize,
    /// `N_ee`.
    pub(crate) centered_centroids: usize,
    /// Candidates started.
    pub(crate) candidates: usize,
    /// Iterations that every candidate completed.
    pub(crate) iterations: usize,
    /// Candidates that did not become a grasp, by reason.
    pub(crate) rejected: BTreeMap<String, usize>,
    /// Stage durations in the order of the pipeline.
    pub(crate) stages: Vec<(String, Duration)>,
    /// Planning stopped before its end.
    pub(crate) stopped: bool,
    /// What was planned with.
    pub(crate) origin: Origin,
    /// Time that the work waited for a free core.
    pub(crate) queue: Duration,
    /// From the arrival of the request to this answer.
    pub(crate) total: Duration,
    /// For each iteration the terms of the candidate that ended best, where that was asked for.
    pub(crate) trace: Vec<ObjectiveTerms>,
}

/// What an answer depends on besides the frame and the options.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Origin {
    /// Where the volume stood; unknown where time ended before that.
    pub(crate) workspace: Option<Workspace>,
    /// Contact estimator.
    pub(crate) estimator: String,
    /// Seed of the search.
    pub(crate) seed: u64,
    /// Revision of the hand's description.
    pub(crate) hand_revision: String,
}

/// One grasp, world frame.
#[derive(Debug, Clone)]
pub(crate) struct GraspOutcome {
    /// Name of the hand's root link, whose poses are given.
    pub(crate) wrist_link: String,
    /// Pose of the hand's root link at the grasp.
    pub(crate) world_from_hand: Isometry3<f64>,
    /// Pose of the hand's root link at the grasp, optical frame of the first camera.
    pub(crate) camera_from_hand: Isometry3<f64>,
    /// Pose of the hand's root link before the approach.
    pub(crate) world_from_pregrasp: Isometry3<f64>,
    /// Pose of the hand's root link before the approach, optical frame of the first camera.
    pub(crate) camera_from_pregrasp: Isometry3<f64>,
    /// Joint positions.
    pub(crate) joints: Named,
    /// Actuator positions: what to command.
    pub(crate) actuators: Named,
    /// Expected contacts.
    pub(crate) contacts: Vec<ContactOutcome>,
    /// Distance between opposed contacts, metres, for two fingers.
    pub(crate) jaw_width_m: Option<f64>,
    /// 0 to 1.
    pub(crate) score: f64,
    /// What the score is made of.
    pub(crate) parts: ScoreParts,
    /// `O_overall`.
    pub(crate) objective: f64,
    /// Ferrari-Canny margin.
    pub(crate) epsilon: f64,
    /// Smallest distance to everything else, metres.
    pub(crate) clearance_m: f64,
    /// Predicted centroid of the grasped object.
    pub(crate) centroid: Point3<f64>,
    /// Label of the grasped object.
    pub(crate) label: Option<u8>,
}

/// Postures and the names of their entries.
#[derive(Debug, Clone, Default)]
pub(crate) struct Named {
    /// One per entry.
    pub(crate) names: Vec<String>,
    /// The values.
    pub(crate) values: Postures,
}

/// An expected contact, world frame.
#[derive(Debug, Clone)]
pub(crate) struct ContactOutcome {
    /// Point.
    pub(crate) point: Point3<f64>,
    /// Outward normal of the object.
    pub(crate) normal: Unit<Vector3<f64>>,
    /// Name of the pad.
    pub(crate) pad: String,
    /// Name of the finger.
    pub(crate) finger: String,
    /// Name of the link that carries the pad.
    pub(crate) link: String,
    /// 0 to 1.
    pub(crate) certainty: f64,
}

impl Outcome {
    /// From a plan that was made in this process.
    pub(crate) fn from_plan(hand: &Hand, plan: Plan, origin: Origin, total: Duration) -> Self {
        let stages = plan.stats.stages.iter().map(|&(name, d)| (name.to_owned(), d)).collect();
        Self {
            hand: hand.id.clone(),
            grasps: plan.grasps.into_iter().map(|g| GraspOutcome::from_grasp(hand, g)).collect(),
            no_grasp: plan.no_grasp.map(|n| (n.reason.as_str().to_owned(), n.nearest_fix)),
            focal_contacts: plan.stats.focal_contacts,
            focal_centroids: plan.stats.focal_centroids,
            centered_centroids: plan.stats.centered_centroids,
            candidates: plan.stats.candidates,
            iterations: plan.stats.iterations,
            rejected: plan.stats.rejected.iter().map(|(r, &n)| (r.as_str().to_owned(), n)).collect(),
            stages,
            stopped: plan.stats.stopped.is_some(),
            origin,
            queue: Duration::ZERO,
            total,
            trace: plan.trace,
        }
    }

    /// The answer when time ended before the scene was read.
    pub(crate) fn out_of_time(hand: &Hand, origin: Origin, total: Duration) -> Self {
        let fix = "the budget ended while the scene was read; allow more time".to_owned();
        Self {
            hand: hand.id.clone(),
            no_grasp: Some((EmptyReason::OutOfTime.as_str().to_owned(), fix)),
            stopped: true,
            origin,
            total,
            ..Self::default()
        }
    }

    /// Duration of a stage, milliseconds.
    pub(crate) fn stage_ms(&self, name: &str) -> Option<f64> {
        self.stages.iter().find(|(n, _)| n == name).map(|(_, d)| d.as_secs_f64() * 1e3)
    }
}

impl GraspOutcome {
    fn from_grasp(hand: &Hand, grasp: Grasp) -> Self {
        let joint_names = hand.tree.joints.iter().map(|j| j.name.clone()).collect();
        let actuator_names = hand
            .actuation
            .coordinates
            .iter()
            .filter(|c| c.kind == graspd_hands::CoordinateKind::Actuator)
            .map(|c| c.name.clone())
            .collect();
        let contacts = grasp
            .contacts
            .iter()
            .map(|c| ContactOutcome {
                point: c.point,
                normal: c.normal,
                pad: hand.pads.get(c.pad).map(|p| p.name.clone()).unwrap_or_default(),
                finger: hand.fingers.get(c.finger).map(|f| f.name.clone()).unwrap_or_default(),
                link: hand
                    .pads
                    .get(c.pad)
                    .and_then(|p| hand.tree.links.get(p.link))
                    .map(|l| l.name.clone())
                    .unwrap_or_default(),
                certainty: c.certainty,
            })
            .collect();
        let hand_from_pregrasp = grasp.world_from_hand.inverse() * grasp.world_from_pregrasp;
        Self {
            wrist_link: hand.tree.links.first().map(|l| l.name.clone()).unwrap_or_default(),
            world_from_hand: grasp.world_from_hand,
            camera_from_hand: grasp.camera_from_hand,
            world_from_pregrasp: grasp.world_from_pregrasp,
            camera_from_pregrasp: grasp.camera_from_hand * hand_from_pregrasp,
            joints: Named { names: joint_names, values: grasp.joints },
            actuators: Named { names: actuator_names, values: grasp.actuators },
            contacts,
            jaw_width_m: grasp.jaw_width_m,
            score: grasp.score,
            parts: grasp.parts,
            objective: grasp.objective.total,
            epsilon: grasp.epsilon,
            clearance_m: grasp.clearance_m,
            centroid: grasp.centroid,
            label: grasp.label,
        }
    }
}
