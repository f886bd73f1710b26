//! Section of the dynamic grasp servo: a camera in the palm, and how the hand follows what it sees.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::pose::PoseRecord;

/// What becomes of frames after the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ServoMode {
    /// Every frame refines the grasp.
    #[default]
    Dynamic,
    /// The first frame decides; for comparison.
    Static,
}

/// `[servo]`: present, the cell's camera sits in the palm and every grasp is refined while the hand approaches
/// (Supplementary Note 7, Task 2).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServoConfig {
    /// Dynamic or static.
    pub mode: ServoMode,
    /// Where the camera first looks from, world frame, metres.
    pub eye_m: [f64; 3],
    /// What it looks at from there, world frame, metres.
    pub looks_at_m: [f64; 3],
    /// Pose of the camera's optical frame in the hand's root link. Left out: the simulated camera sits where the palm is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hand_from_camera: Option<PoseRecord>,
    /// Iterations for each frame.
    pub iterations: u32,
    /// Distance from the grasp at which the approach begins, metres.
    pub standoff_start_m: f64,
    /// Distance from which the hand goes straight in, metres.
    pub standoff_end_m: f64,
    /// How fast the stand-off shrinks, metres per second.
    pub standoff_speed_m_s: f64,
    /// How fast the arm follows, metres per second.
    pub speed_m_s: f64,
    /// So many frames are on their way to the planner at a time: with 1 the camera looks again when there is an answer,
    /// with 2 meanwhile.
    pub frames_under_way: u32,
    /// Without an answer for so long the arm is held where it is; without a word from the cell it stops by itself, seconds.
    pub silence_s: f64,
    /// Without an answer for so long the stream counts as broken, seconds.
    pub answer_s: f64,
    /// So many answers in a row without anything to follow end the approach.
    pub lost_answers: u32,
    /// An approach that takes longer is given up, seconds on the camera's clock.
    pub longest_s: f64,
}

impl Default for ServoConfig {
    fn default() -> Self {
        Self {
            mode: ServoMode::Dynamic,
            eye_m: [0.0, -0.06, 0.46],
            looks_at_m: [0.0, 0.0, 0.02],
            hand_from_camera: None,
            iterations: 3,
            standoff_start_m: 0.15,
            standoff_end_m: 0.05,
            standoff_speed_m_s: 0.06,
            speed_m_s: 0.25,
            frames_under_way: 1,
            silence_s: 1.0,
            answer_s: 20.0,
            lost_answers: 8,
            longest_s: 20.0,
        }
    }
}

impl ServoConfig {
    /// Pose of the camera in the hand; the hand's own where nobody has said it.
    pub fn hand_from_camera(&self) -> Isometry3<f64> {
        self.hand_from_camera.as_ref().map_or_else(Isometry3::identity, PoseRecord::isometry)
    }
}
