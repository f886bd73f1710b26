//! Everything that is computed once per frame and shared by all hands.

use std::time::Duration;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::budget::Budget;
use crate::contact_field::ContactField;
use crate::estimator::ContactEstimator;
use crate::frame::Frame;
use crate::options::SceneOptions;
use crate::refine::Features;
use crate::volume::Volume;
use crate::workspace::Workspace;

/// One observation, refined: the input of every hand's optimization.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Where the volume stands.
    pub workspace: Workspace,
    /// What was seen.
    pub volume: Volume,
    /// What the estimator made of it.
    pub contact_field: ContactField,
    /// What the optimizer reads.
    pub features: Features,
    /// Pose of the first camera, world frame (identity when the caller gave none).
    pub world_from_camera: Isometry3<f64>,
    /// From the first camera towards the middle of what it sees, volume frame.
    pub view_direction: Unit<Vector3<f64>>,
    /// Durations of the stages so far, in order: `frame`, `volume`, `estimate`, `refine`.
    pub stages: Vec<(&'static str, Duration)>,
}

/// Why frames do not make a scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// There is no frame.
    #[error("frames: empty, expected at least one depth frame")]
    NoFrames,
    /// Work had to stop.
    #[error("stopped: {0:?}")]
    Stopped(crate::budget::Stop),
}

/// Runs frame → volume → contact field → features, once for any number of hands.
///
/// # Errors
/// [`SceneError`] for frames that cannot be read. A frame in which nothing is seen is not an error: it
/// gives a scene with empty features.
pub fn prepare(
    _frames: &[Frame],
    _options: &SceneOptions,
    _estimator: &dyn ContactEstimator,
    _budget: &dyn Budget,
) -> Result<Scene, SceneError> {
    Err(SceneError::NoFrames)
}

/// A scene from a contact field that was made elsewhere, with the solid voxels that came with it.
///
/// The volume's frame is the world frame, the camera looks down from above its middle.
pub fn from_contact_field(
    _field: ContactField,
    _solid: &[bool],
    _options: &SceneOptions,
    _budget: &dyn Budget,
) -> Result<Scene, SceneError> {
    let _ = Point3::<f64>::origin();
    Err(SceneError::NoFrames)
}
