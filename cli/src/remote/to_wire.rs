//! Frames and options on the wire.

use std::time::Duration;

use graspd_client::{CameraIntrinsics, DepthFrame, depth_frame_f32, depth_frame_u16};
use graspd_planner::options::{PlanOptions, Reaching, SceneOptions, Target, VolumeKind, WorkspaceRequest};
use graspd_proto::v1;
use nalgebra::{Isometry3, Vector3};

use crate::commands::plan::FrameFiles;
use crate::input::depth::DepthValues;

/// A depth frame with its lens, pose and labels.
pub(crate) fn frame(files: &FrameFiles) -> DepthFrame {
    let lens = &files.file.intrinsics;
    let rectified = lens.distortion == [0.0; 8];
    let intrinsics = CameraIntrinsics {
        fx_px: lens.fx_px,
        fy_px: lens.fy_px,
        cx_px: lens.cx_px,
        cy_px: lens.cy_px,
        distortion: if rectified { Vec::new() } else { lens.distortion.to_vec() },
    };
    // Images are at most 8192 pixels wide.
    let (width, height) = (files.depth.width as i32, files.depth.height as i32);
    let mut frame = match &files.depth.values {
        DepthValues::U16(values) => {
            depth_frame_u16(width, height, files.file.depth_scale, values, intrinsics)
        }
        DepthValues::Metres(values) => depth_frame_f32(width, height, values, intrinsics),
    };
    frame.camera_pose = files
        .file
        .world_from_camera
        .map(|pose| v1::PoseInFrame { frame_id: "world".into(), pose: Some(pose_message(&pose)) });
    frame.labels = files.labels.as_ref().map(|labels| v1::LabelImage {
        encoding: v1::LabelEncoding::RawU8.into(),
        data: labels.clone().into(),
    });
    frame
}

/// How the scene is read.
pub(crate) fn scene_options(options: &SceneOptions, estimator: Option<&str>) -> v1::SceneOptions {
    let kind = match options.volume {
        VolumeKind::Tsdf => v1::VolumeKind::Tsdf,
        VolumeKind::Occupancy => v1::VolumeKind::Occupancy,
    };
    let workspace = match options.workspace {
        WorkspaceRequest::Auto => None,
        WorkspaceRequest::Placed { world_from_volume, table_m } => Some(v1::WorkspacePlacement {
            pose: Some(pose_message(&world_from_volume)),
            table_height_m: table_m,
        }),
    };
    v1::SceneOptions {
        volume_kind: kind.into(),
        estimator: estimator.unwrap_or_default().to_owned(),
        workspace,
        focal_contact_threshold: Some(options.focal_contact_threshold),
        focal_centroid_threshold: Some(options.focal_centroid_threshold),
        volume_size_m: Some(options.grid.size_m),
        volume_resolution: i32::try_from(options.grid.resolution).unwrap_or(i32::MAX),
        grasp_region: options.region.map(|region| v1::GraspRegion {
            pose: Some(pose_message(&region.world_from_box)),
            half_extents_m: Some(vector_message(&region.half_extents_m)),
        }),
    }
}

/// How grasps are searched.
///
/// # Errors
/// For a budget that the wire cannot carry.
pub(crate) fn plan_options(
    options: &PlanOptions,
    budget: Option<Duration>,
) -> anyhow::Result<v1::PlanOptions> {
    let budget = budget
        .map(|d| {
            d.try_into().map_err(|_| {
                anyhow::anyhow!("--budget-ms: found {} s, which no message can carry", d.as_secs())
            })
        })
        .transpose()?;
    let (reaching, direction) = match options.reaching {
        Reaching::TopDown => (v1::Reaching::TopDown, None),
        Reaching::CameraRay => (v1::Reaching::CameraRay, None),
        Reaching::Free => (v1::Reaching::Free, None),
        Reaching::Direction(d) => (v1::Reaching::Direction, Some(vector_message(&d))),
    };
    let target = options.target.map(|target| match target {
        Target::Label(label) => v1::plan_options::Target::TargetLabel(label.into()),
        Target::Point { point, radius_m } => v1::plan_options::Target::TargetPoint(v1::TargetPoint {
            point: Some(vector_message(&point.coords)),
            radius_m,
        }),
    });
    let boxes = options.keep_out.iter().map(|k| v1::KeepOutBox {
        pose: Some(pose_message(&k.world_from_box)),
        half_extents_m: Some(vector_message(&k.half_extents_m)),
    });
    let count = |n: usize| i32::try_from(n).unwrap_or(i32::MAX);
    Ok(v1::PlanOptions {
        batch_size: count(options.batch),
        scheme: Some(v1::Scheme {
            iteration_count: count(options.scheme.iterations),
            penetration_iteration_count: count(options.scheme.with_penetration),
        }),
        reaching: reaching.into(),
        reaching_direction: direction,
        orientation_limits: Some(v1::OrientationLimits {
            max_tilt_rad: Some(options.orientation.cone_rad),
            roll: options.orientation.roll_rad.map(|(min_rad, max_rad)| v1::RollRange { min_rad, max_rad }),
        }),
        keep_out_boxes: boxes.collect(),
        target,
        seed: options.seed,
        budget,
        max_grasp_count: count(options.max_grasps),
        min_score: Some(options.min_score),
        friction: Some(options.friction),
        pregrasp_offset_m: Some(options.pregrasp_offset_m),
        opening_fraction: Some(options.opening_fraction),
        trace: options.trace,
        ..v1::PlanOptions::default()
    })
}

fn vector_message(v: &Vector3<f64>) -> v1::Vector3 {
    v1::Vector3 { x: v.x, y: v.y, z: v.z }
}

fn pose_message(pose: &Isometry3<f64>) -> v1::Pose {
    let q = pose.rotation.coords;
    v1::Pose {
        position: Some(vector_message(&pose.translation.vector)),
        orientation: Some(v1::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_carried_or_refused_but_never_dropped() {
        let options = PlanOptions::default();
        assert_eq!(plan_options(&options, None).unwrap().budget, None);
        let carried = plan_options(&options, Some(Duration::from_millis(1500))).unwrap().budget.unwrap();
        assert_eq!((carried.seconds, carried.nanos), (1, 500_000_000));
        let message = plan_options(&options, Some(Duration::MAX)).unwrap_err().to_string();
        assert!(message.starts_with("--budget-ms: found"), "{message}");
    }

    #[test]
    fn the_estimator_is_named_only_where_it_was_asked_for() {
        assert_eq!(scene_options(&SceneOptions::default(), None).estimator, "");
        assert_eq!(scene_options(&SceneOptions::default(), Some("geometric")).estimator, "geometric");
    }
}
