//! Which field of a request does not make a scene.

use graspd_planner::grid::{GridError, MAX_RESOLUTION, MAX_SIZE_M, MIN_RESOLUTION, MIN_SIZE_M};
use graspd_planner::scene::SceneError;

use crate::convert::SceneRequest;
use crate::error::{FieldError, FieldReason};

/// The field of a request that does not make a scene. The conversion refuses nearly all of them before.
pub(super) fn scene_fault(error: &SceneError, scene: &SceneRequest) -> FieldError {
    let value = |field: &str, found: &dyn std::fmt::Display, expected: &str| {
        FieldError::value(scene.field(field), found, expected)
    };
    match error {
        SceneError::NoFrames => FieldError::missing(scene.field("frames"), "at least one depth frame"),
        SceneError::Frame { index, source } => FieldError::new(
            FieldReason::Image,
            scene.field(&format!("frames[{index}]")),
            source,
            "a frame that can be read",
        ),
        SceneError::MissingPose { index, .. } => FieldError::missing(
            scene.field(&format!("frames[{index}].camera_pose")),
            "a pose for each of several frames",
        ),
        SceneError::Workspace { field: "table_m", found, expected } => {
            value("scene_options.workspace.table_height_m", found, expected)
        }
        SceneError::Workspace { found, expected, .. } => {
            value("scene_options.workspace.pose", found, expected)
        }
        SceneError::Region { field, found, expected } => {
            let field = if *field == "world_from_box" { "pose" } else { field };
            value(&format!("scene_options.grasp_region.{field}"), found, expected)
        }
        SceneError::Threshold { field, found } => {
            value(&format!("scene_options.{field}"), found, "a share from 0 to 1")
        }
        SceneError::Grid(GridError::Resolution { found }) => {
            let expected = format!("{MIN_RESOLUTION} to {MAX_RESOLUTION} voxels");
            value("scene_options.volume_resolution", found, &expected)
        }
        SceneError::Grid(GridError::Size { found }) => {
            value("scene_options.volume_size_m", found, &format!("{MIN_SIZE_M} to {MAX_SIZE_M}"))
        }
        other => value("scene_options", other, "options that make a scene"),
    }
}
