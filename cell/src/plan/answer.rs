//! What the planner answers.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::pose::PoseRecord;

/// A ranked grasp: where the hand goes and what its actuators are told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedGrasp {
    /// Pose of the hand's root link before the straight approach, world frame.
    pub world_from_pregrasp: PoseRecord,
    /// Pose of the hand's root link at the grasp, world frame.
    pub world_from_hand: PoseRecord,
    /// Names of the actuators.
    pub actuators: Vec<String>,
    /// Their positions during the approach, radians or metres.
    pub open: Vec<f64>,
    /// Their positions where contact is expected.
    pub contact: Vec<f64>,
    /// Their positions to command when closing, beyond contact.
    pub squeezed: Vec<f64>,
    /// Predicted centroid of the grasped object, world frame, metres.
    pub centroid_m: [f64; 3],
    /// Rank, 0 to 1.
    pub score: f64,
    /// Ferrari-Canny margin.
    pub epsilon: f64,
    /// Room around the hand, metres.
    pub clearance_m: f64,
}

/// Why there is no grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EmptyReason {
    /// No depth fell into the workspace.
    NothingSeen,
    /// Nothing stands on the table.
    EmptyTable,
    /// No contact above the threshold.
    NoContacts,
    /// No centroid.
    NoCentroid,
    /// The target is not in the scene.
    TargetNotFound,
    /// Everything is wider than the hand opens.
    HandTooSmall,
    /// No room for the hand.
    HandTooLarge,
    /// Every candidate was rejected.
    AllRejected,
    /// The time was up.
    OutOfTime,
    /// A reason newer than this program.
    Other,
}

impl EmptyReason {
    /// True when it says that nothing is left to grasp.
    pub fn is_empty_tray(self) -> bool {
        matches!(self, Self::NothingSeen | Self::EmptyTable)
    }

    /// The reason of this name; [`EmptyReason::Other`] where there is none.
    pub fn named(name: &str) -> Self {
        let known = [
            Self::NothingSeen,
            Self::EmptyTable,
            Self::NoContacts,
            Self::NoCentroid,
            Self::TargetNotFound,
            Self::HandTooSmall,
            Self::HandTooLarge,
            Self::AllRejected,
            Self::OutOfTime,
        ];
        known.into_iter().find(|reason| reason.name() == name).unwrap_or(Self::Other)
    }

    /// The reason's name in records and tables.
    pub fn name(self) -> &'static str {
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
            Self::Other => "other",
        }
    }
}

/// The planner's word on why there is no grasp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoGrasp {
    /// Machine readable.
    pub reason: EmptyReason,
    /// For people: the nearest fix.
    pub nearest_fix: String,
}

/// An answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Best first.
    pub grasps: Vec<PlannedGrasp>,
    /// Why there is none.
    pub no_grasp: Option<NoGrasp>,
    /// Candidates that did not become a grasp, by reason.
    pub rejected: BTreeMap<String, i32>,
    /// From the arrival of the request to the answer, as the server measured it, seconds.
    pub plan_s: f64,
    /// Revision of the hand's description that was used.
    pub hand_revision: String,
    /// Contact estimator that was used.
    pub estimator: String,
}

impl Answer {
    /// The reasons of rejection, most frequent first, for people: `collision_table 31, no_contact 9`.
    pub fn rejections(&self) -> String {
        let mut counts: Vec<_> = self.rejected.iter().filter(|(_, n)| **n > 0).collect();
        counts.sort_by_key(|(_, n)| -**n);
        counts.iter().map(|(reason, n)| format!("{reason} {n}")).collect::<Vec<_>>().join(", ")
    }
}
