//! What a servo may be asked for.

use nalgebra::Isometry3;

use super::standoff::StandoffOptions;
use crate::options::{PlanOptions, SceneOptions, Scheme};

/// What becomes of frames after the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Every frame refines the grasp.
    #[default]
    Dynamic,
    /// The first frame decides (the comparison of Supplementary Note 7); later ones only let the stand-off shrink.
    Static,
}

/// Largest change of a grasp from one answer to the next while it counts as tracking.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Of the middle of the hand's contact candidates, metres.
    pub translation_m: f64,
    /// Radians.
    pub rotation_rad: f64,
}

/// How fast a camera can move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraBounds {
    /// Metres per second.
    pub speed_m_s: f64,
    /// Radians per second.
    pub turn_rad_s: f64,
}

/// How a grasp is tracked. The defaults are the supplement's where it names a value.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoOptions {
    /// Dynamic or static.
    pub mode: Mode,
    /// How the scene is read.
    pub scene: SceneOptions,
    /// The first plan (96 candidates of 48 iterations), and what every later grasp must keep to.
    pub plan: PlanOptions,
    /// Iterations of the one candidate for each frame.
    pub iterations: usize,
    /// Edge of the window about the target in which features are made anew, voxels; a multiple of 8.
    pub window_voxels: usize,
    /// What was seen counts as at most so many frames when a new one comes.
    pub memory: u16,
    /// How the hand comes nearer.
    pub standoff: StandoffOptions,
    /// What counts as the same grasp from one answer to the next.
    pub bounds: Bounds,
    /// Frames for which a grasp is held that the newest evidence speaks against, before another one is searched.
    pub patience: usize,
    /// Searches in vain before the target counts as lost.
    pub give_up: usize,
    /// Every so many frames another grasp of the target is refined and judged beside the one that is followed; in the
    /// frames between it is the grasp itself with more iterations. 0: never another one.
    pub reconsider_every: usize,
    /// Another grasp must score this much more to be taken.
    pub reconsider_margin: f64,
    /// Poses that ask for more are wild.
    pub camera: CameraBounds,
    /// Nearer than this to its target a camera may be blind: the nearest depth that it measures, and half an object more.
    /// What it does not see from there is no reason to wait, metres.
    pub blind_within_m: f64,
    /// Pose of the camera in the hand's root frame, for a camera that the hand carries: tells where the hand is in frames
    /// that do not say so themselves.
    pub hand_from_camera: Option<Isometry3<f64>>,
}

impl Default for ServoOptions {
    fn default() -> Self {
        let standoff = StandoffOptions::default();
        Self {
            mode: Mode::Dynamic,
            scene: SceneOptions::default(),
            plan: PlanOptions {
                batch: 96,
                scheme: Scheme { iterations: 48, with_penetration: 16 },
                pregrasp_offset_m: standoff.start_m,
                ..PlanOptions::default()
            },
            iterations: 3,
            window_voxels: 56,
            memory: 6,
            standoff,
            bounds: Bounds { translation_m: 0.008, rotation_rad: 0.06 },
            patience: 5,
            give_up: 5,
            reconsider_every: 2,
            reconsider_margin: 0.15,
            camera: CameraBounds { speed_m_s: 2.0, turn_rad_s: 6.0 },
            blind_within_m: 0.15,
            hand_from_camera: None,
        }
    }
}

impl ServoOptions {
    /// The static grasping that Supplementary Note 7 compares with: 96 candidates of 128 iterations on the first frame.
    pub fn of_first_frame() -> Self {
        let options = Self::default();
        let scheme = Scheme { iterations: 128, with_penetration: 32 };
        Self { mode: Mode::Static, plan: PlanOptions { scheme, ..options.plan.clone() }, ..options }
    }

    /// Checks every number that is the servo's own; scene options are checked with the first frame.
    ///
    /// # Errors
    /// [`ServoOptionsError`] with the field, what was found and what was expected.
    pub fn validate(&self) -> Result<(), ServoOptionsError> {
        let error = |field, found: String, expected| Err(ServoOptionsError { field, found, expected });
        let whole = [
            ("iterations", self.iterations, (1, 100)),
            ("patience", self.patience, (0, 100)),
            ("give_up", self.give_up, (1, 100)),
            ("reconsider_every", self.reconsider_every, (0, 10_000)),
            ("memory", usize::from(self.memory), (1, 1000)),
        ];
        for (field, found, (low, high)) in whole {
            if !(low..=high).contains(&found) {
                let expected = if low == 0 { "a small whole number" } else { "a small whole number from 1" };
                return error(field, found.to_string(), expected);
            }
        }
        let resolution = self.scene.grid.resolution;
        if !self.window_voxels.is_multiple_of(8) || !(16..=resolution.max(16)).contains(&self.window_voxels) {
            let expected = "a multiple of 8 from 16 up to the volume's resolution";
            return error("window_voxels", self.window_voxels.to_string(), expected);
        }
        let s = &self.standoff;
        let lengths = [
            ("standoff.start_m", s.start_m, s.end_m.max(0.0)..=0.5),
            ("standoff.end_m", s.end_m, 0.0..=0.5),
            ("standoff.speed_m_s", s.speed_m_s, 1e-3..=1.0),
            ("standoff.lag_m", s.lag_m, 1e-3..=0.2),
            ("bounds.translation_m", self.bounds.translation_m, 1e-4..=0.1),
            ("bounds.rotation_rad", self.bounds.rotation_rad, 1e-3..=3.2),
            ("reconsider_margin", self.reconsider_margin, 0.0..=1.0),
            ("blind_within_m", self.blind_within_m, 0.0..=1.0),
            ("camera.speed_m_s", self.camera.speed_m_s, 0.01..=100.0),
            ("camera.turn_rad_s", self.camera.turn_rad_s, 0.01..=1000.0),
        ];
        for (field, found, range) in lengths {
            if !range.contains(&found) {
                return error(field, found.to_string(), "a value of a usual size");
            }
        }
        Ok(())
    }
}

/// An option that cannot be taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct ServoOptionsError {
    /// The option.
    pub field: &'static str,
    /// Found value.
    pub found: String,
    /// What is expected.
    pub expected: &'static str,
}
