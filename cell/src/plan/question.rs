//! What is asked of the planner, besides the frame; recorded, so that it can be asked again.

use serde::{Deserialize, Serialize};

use crate::pose::PoseRecord;

/// Along which direction the hand reaches for objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReachingChoice {
    /// Straight down.
    TopDown,
    /// Along the ray from the camera to the middle of what it sees.
    CameraRay,
    /// Any direction within 75 degrees of straight down.
    Free,
}

/// Where the volume stands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkspaceRecord {
    /// Pose of the volume's lower corner, z up, world frame.
    pub pose: PoseRecord,
    /// Edge of the cube, metres.
    pub size_m: f64,
    /// Height of the tray's floor in the volume, metres; `None` lets the planner find it.
    pub table_height_m: Option<f64>,
}

/// An upright box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoxRecord {
    /// Pose of its centre, world frame.
    pub pose: PoseRecord,
    /// Half extents along its axes, metres.
    pub half_extents_m: [f64; 3],
}

/// A question to the planner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// Id of the hand.
    pub hand: String,
    /// Seed of the search.
    pub seed: u64,
    /// Reaching direction.
    pub reaching: ReachingChoice,
    /// Largest angle from the reaching direction, radians; `None`: the planner's default.
    pub max_tilt_rad: Option<f64>,
    /// Where the volume stands.
    pub workspace: WorkspaceRecord,
    /// Only contacts inside may be grasped.
    pub region: Option<BoxRecord>,
    /// No part of the hand may be in these boxes; records of older runs have none.
    #[serde(default)]
    pub keep_out: Vec<BoxRecord>,
    /// Contact estimator by name; empty: the server's default.
    pub estimator: String,
    /// Candidates that are optimized together.
    pub batch: u32,
    /// Iterations, of which the last so many avoid penetration.
    pub scheme: [u32; 2],
    /// At most so many grasps.
    pub max_grasps: u32,
    /// Grasps that score less are left out, 0 to 1.
    pub min_score: f64,
    /// Coulomb friction between pads and objects.
    pub friction: f64,
    /// Distance of the pre-grasp from the grasp, metres.
    pub pregrasp_offset_m: f64,
}

impl Question {
    /// The question as a reader of its record has it: asked so, it can be asked again bit for bit.
    ///
    /// # Errors
    /// When it holds numbers that JSON has no words for.
    pub fn as_recorded(&self) -> Result<Self, serde_json::Error> {
        serde_json::from_str(&serde_json::to_string(self)?)
    }
}
