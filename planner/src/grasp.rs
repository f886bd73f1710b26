//! What planning returns: ranked grasps, statistics, and why there is nothing where there is nothing.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::budget::Stop;

/// Values at the three moments of a grasp, one entry per joint or per actuator.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Postures {
    /// At the pre-grasp and during the approach.
    pub open: Vec<f64>,
    /// When the pads touch.
    pub contact: Vec<f64>,
    /// What to command so that the fingers press: beyond contact, towards closed.
    pub squeezed: Vec<f64>,
}

/// An expected contact.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspContact {
    /// Point, world frame, metres.
    pub point: Point3<f64>,
    /// Outward normal of the object, world frame.
    pub normal: Unit<Vector3<f64>>,
    /// Index into the hand's pads.
    pub pad: usize,
    /// Index into the hand's fingers.
    pub finger: usize,
    /// Certainty of the contact field there, 0 to 1.
    pub certainty: f64,
}

/// The parts of a score, each 0 to 1, larger is better.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScoreParts {
    /// From the optimized objective.
    pub objective: f64,
    /// Force-closure margin with friction (Ferrari-Canny, torques scaled by the object's size), times how squarely two
    /// of the touched surfaces face away from each other.
    pub force_closure: f64,
    /// Room around the parts that do not touch, at the grasp and on the approach.
    pub clearance: f64,
    /// Mean certainty of the contacts.
    pub certainty: f64,
}

/// The unweighted terms of the objective of one candidate; see `objective` for their meaning.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObjectiveTerms {
    /// Distance of the contact candidates to the nearest focal contacts.
    pub contact_distance: f64,
    /// Lack of certainty at the contact candidates.
    pub certainty: f64,
    /// Mismatch of pad normals and contact orientations.
    pub orientation: f64,
    /// Distance of the mean contact to the nearest centred centroid.
    pub centroid: f64,
    /// Lack of linear independence of the contact wrenches.
    pub independence: f64,
    /// Net wrench.
    pub net_wrench: f64,
    /// Departure from the reaching direction, `O_ab`.
    pub approach: f64,
    /// Joints beyond their limits.
    pub joint_limits: f64,
    /// Soft couplings of adaptive fingers.
    pub coupling: f64,
    /// Penetration `O_pn` of scene, table, keep-out boxes and the hand itself.
    pub penetration: f64,
    /// The weighted sum, `O_overall`.
    pub total: f64,
}

/// Grasps of a smaller probability are likelier to be lost than kept: look again, or ask for more candidates.
pub const BETTER_NOT: f64 = 0.5;

/// A ranked grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Pose of the hand's root link, world frame.
    pub world_from_hand: Isometry3<f64>,
    /// Pose of the hand's root link in the optical frame of the first camera.
    pub camera_from_hand: Isometry3<f64>,
    /// Pose before the straight approach, world frame.
    pub world_from_pregrasp: Isometry3<f64>,
    /// Joint positions in the order of the tree's joints.
    pub joints: Postures,
    /// Actuator positions in the order of the hand's actuators.
    pub actuators: Postures,
    /// Expected contacts.
    pub contacts: Vec<GraspContact>,
    /// Distance between the opposed contacts, metres, for a hand with two fingers.
    pub jaw_width_m: Option<f64>,
    /// Probability that the hand lifts the object and keeps it, 0 to 1, as simulated executions have it
    /// ([`graspd_hands::Confidence`]); larger is better. Under [`BETTER_NOT`]: better not.
    pub score: f64,
    /// What the score is made of.
    pub parts: ScoreParts,
    /// The optimized objective.
    pub objective: ObjectiveTerms,
    /// Ferrari-Canny margin: the smallest wrench that breaks the grasp, per newton of grip; 0 without closure.
    pub epsilon: f64,
    /// Smallest distance between the parts of the hand that do not touch and everything else, at the grasp and on
    /// the approach, metres. May be negative within the collision tolerance of one voxel.
    pub clearance_m: f64,
    /// Predicted centroid of the grasped object, world frame.
    pub centroid: Point3<f64>,
    /// Label of the grasped object, where the frames had labels.
    pub label: Option<u8>,
}

/// Why a candidate did not become a grasp. Ordered as the checks are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum RejectReason {
    /// The budget ended before its first iteration, or before it was looked at.
    Unfinished,
    /// The optimization left the finite numbers.
    Diverged,
    /// The hand's contacts left the volume.
    OutOfWorkspace,
    /// The approach axis or the roll left what is allowed.
    OrientationLimit,
    /// The grasp is not at the asked target.
    NotTarget,
    /// Fewer than two fingers reach a contact.
    NoContact,
    /// What is between the fingers is wider than they open.
    TooWide,
    /// The hand is in an object at the grasp.
    CollisionScene,
    /// The hand is in the table.
    CollisionTable,
    /// The hand is in itself.
    CollisionSelf,
    /// The hand is in a keep-out box.
    KeepOut,
    /// The straight approach from the pre-grasp hits something.
    ApproachBlocked,
    /// The contacts cannot hold against every small disturbance.
    NoForceClosure,
    /// The score is under the asked minimum.
    LowScore,
    /// Another grasp, nearly the same, is better.
    Duplicate,
    /// Good, but more were found than asked for.
    BeyondLimit,
}

impl RejectReason {
    /// The reason as it appears on the wire and in tables, for example `collision_scene`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unfinished => "unfinished",
            Self::Diverged => "diverged",
            Self::OutOfWorkspace => "out_of_workspace",
            Self::OrientationLimit => "orientation_limit",
            Self::NotTarget => "not_target",
            Self::NoContact => "no_contact",
            Self::TooWide => "too_wide",
            Self::CollisionScene => "collision_scene",
            Self::CollisionTable => "collision_table",
            Self::CollisionSelf => "collision_self",
            Self::KeepOut => "keep_out",
            Self::ApproachBlocked => "approach_blocked",
            Self::NoForceClosure => "no_force_closure",
            Self::LowScore => "low_score",
            Self::Duplicate => "duplicate",
            Self::BeyondLimit => "beyond_limit",
        }
    }
}

/// Why there is no grasp at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EmptyReason {
    /// No depth fell into the workspace.
    NothingSeen,
    /// Nothing stands on the table.
    EmptyTable,
    /// The contact field has no contact above its threshold.
    NoContacts,
    /// The contact field has no centroid.
    NoCentroid,
    /// The asked target is not in the scene.
    TargetNotFound,
    /// Everything seen is wider than the hand opens.
    HandTooSmall,
    /// The hand is too large for the room around anything seen.
    HandTooLarge,
    /// Candidates were found and every one was rejected; see the counted reasons.
    AllRejected,
    /// The budget ended before anything could be ranked.
    OutOfTime,
}

impl EmptyReason {
    /// The reason as it appears on the wire and in tables, for example `empty_table`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NothingSeen => "nothing_seen",
            Self::EmptyTable => "empty_table",
            Self::NoContacts => "no_contacts",
            Self::NoCentroid => "no_centroid",
            Self::TargetNotFound => "target_not_found",
            Self::HandTooSmall => "hand_too_small",
            Self::HandTooLarge => "hand_too_large",
            Self::AllRejected => "all_rejected",
            Self::OutOfTime => "out_of_time",
        }
    }
}

/// Why there is no grasp, and what would help most.
#[derive(Debug, Clone, PartialEq)]
pub struct NoGrasp {
    /// Machine readable.
    pub reason: EmptyReason,
    /// For people: the nearest fix with its figures, for example
    /// "widest opening 0.085 m, narrowest contact pair 0.112 m".
    pub nearest_fix: String,
}

/// Figures of one plan. Present whether or not there is a grasp.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanStats {
    /// `N_fc`.
    pub focal_contacts: usize,
    /// `N_fe`.
    pub focal_centroids: usize,
    /// `N_ee`.
    pub centered_centroids: usize,
    /// Candidates started.
    pub candidates: usize,
    /// Iterations that every candidate completed.
    pub iterations: usize,
    /// Candidates that did not become a grasp, by reason.
    pub rejected: BTreeMap<RejectReason, usize>,
    /// Stage durations in the order of the pipeline, for example `("optimize", 21 ms)`.
    pub stages: Vec<(&'static str, Duration)>,
    /// What stopped planning before its end.
    pub stopped: Option<Stop>,
}

/// What planning for one hand returns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// Best first.
    pub grasps: Vec<Grasp>,
    /// Figures.
    pub stats: PlanStats,
    /// Set exactly when there is no grasp.
    pub no_grasp: Option<NoGrasp>,
    /// With [`crate::options::PlanOptions::trace`]: per iteration the terms of the candidate behind the best grasp
    /// (of the lowest objective, where there is no grasp).
    pub trace: Vec<ObjectiveTerms>,
}
