//! A scene that was read, on the wire: where its volume stands, what the search reads of the contact field, and the
//! points of its frames.

use std::time::Duration;

use graspd_planner::frame::Frame;
use graspd_planner::scene::Scene;
use graspd_proto::v1;
use nalgebra::{Isometry3, Point3, Vector3};

use super::count_message;
use super::grasp::{stage_message, workspace_message};

/// What an answer tells besides the scene.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SceneContext<'a> {
    /// Name of the world frame.
    pub(crate) world: &'a str,
    /// The estimator's name.
    pub(crate) estimator: &'a str,
    /// Stages before those that the scene itself has timed.
    pub(crate) stages: &'a [(&'static str, Duration)],
    /// Points of each frame at most; 0: none are sent.
    pub(crate) most_points: usize,
}

/// A scene on the wire; `frames` are those that it was read from.
pub(crate) fn scene_response(
    scene: &Scene,
    frames: &[Frame],
    context: &SceneContext<'_>,
) -> v1::ReadSceneResponse {
    let points = match context.most_points {
        0 => Vec::new(),
        most => frames.iter().map(|frame| points_message(frame, &pose(frame), most)).collect(),
    };
    v1::ReadSceneResponse {
        workspace: Some(workspace_message(&scene.workspace, context.world)),
        contact_field: Some(field_message(scene)),
        points,
        stages: context.stages.iter().chain(&scene.stages).map(stage_message).collect(),
        estimator: context.estimator.to_owned(),
    }
}

/// Where the frame was taken; the camera's own frame is the world where nobody said.
fn pose(frame: &Frame) -> Isometry3<f64> {
    frame.world_from_camera.unwrap_or_else(Isometry3::identity)
}

fn field_message(scene: &Scene) -> v1::ContactField {
    let (features, field) = (&scene.features, &scene.contact_field);
    let to_world = &scene.workspace.world_from_volume;
    let grid = features.grid;
    let mut message = v1::ContactField::default();
    for &index in &features.focal_contacts {
        let index = index as usize;
        let (Some(&certainty), Some(&inward)) = (field.certainty.get(index), field.inward.get(index)) else {
            continue;
        };
        push(&mut message.contacts_m, &(to_world * grid.center(grid.voxel(index))).coords);
        push(&mut message.inward, &(to_world.rotation * Vector3::from(inward.map(f64::from))));
        message.certainties.push(certainty);
    }
    for centroid in &features.centroids {
        push(&mut message.centroids_m, &(to_world * centroid.position).coords);
        message.centroid_weights.push(centroid.weight as f32);
    }
    message
}

/// Every n-th pixel of every n-th row, so that there are at most so many.
fn points_message(frame: &Frame, world_from_camera: &Isometry3<f64>, most: usize) -> v1::FramePoints {
    let (full_width, full_height) = (frame.image.width, frame.image.height);
    let stride = (1..=full_width.max(full_height))
        .find(|n| full_width.div_ceil(*n) * full_height.div_ceil(*n) <= most)
        .unwrap_or(full_width.max(full_height).max(1));
    let (width, height) = (full_width.div_ceil(stride), full_height.div_ceil(stride));
    let mut points_m = Vec::with_capacity(3 * width * height);
    for v in (0..full_height).step_by(stride) {
        for u in (0..full_width).step_by(stride) {
            let depth = frame.image.depth_m.get(v * full_width + u).copied().map_or(0.0, f64::from);
            let seen = depth.is_finite() && depth > 0.0;
            let ray = if seen { frame.intrinsics.ray([u as f64, v as f64]) } else { None };
            match ray {
                Some([x, y]) => {
                    let point = world_from_camera * Point3::new(x * depth, y * depth, depth);
                    push(&mut points_m, &point.coords);
                }
                None => points_m.extend([f32::NAN; 3]),
            }
        }
    }
    v1::FramePoints { width: count_message(width), height: count_message(height), points_m }
}

fn push(list: &mut Vec<f32>, v: &Vector3<f64>) {
    list.extend([v.x as f32, v.y as f32, v.z as f32]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_planner::frame::{DepthImage, Intrinsics};

    #[test]
    fn points_keep_their_places_and_their_number() {
        let intrinsics =
            Intrinsics { fx_px: 100.0, fy_px: 100.0, cx_px: 10.0, cy_px: 8.0, distortion: [0.0; 8] };
        let mut depth_m = vec![0.5f32; 21 * 16];
        depth_m[0] = 0.0;
        depth_m[2] = f32::NAN;
        depth_m[4] = f32::INFINITY;
        let image = DepthImage { width: 21, height: 16, depth_m };
        let frame = Frame { image, intrinsics, world_from_camera: None, labels: None };
        let up = Isometry3::translation(0.0, 0.0, 2.0);
        let all = points_message(&frame, &up, 21 * 16);
        assert_eq!((all.width, all.height, all.points_m.len()), (21, 16, 3 * 21 * 16));
        let at = 3 * (8 * 21 + 20);
        assert!((all.points_m[at] - 0.05).abs() < 1e-6);
        assert_eq!(all.points_m[at + 1..at + 3], [0.0, 2.5]);
        let holes = all.points_m.iter().filter(|x| x.is_nan()).count();
        assert_eq!(holes, 9);
        let few = points_message(&frame, &up, 21 * 16 - 1);
        assert_eq!((few.width, few.height), (11, 8));
        assert!(few.points_m[..9].iter().all(|x| x.is_nan()), "the same pixels, every second one");
        let one = points_message(&frame, &up, 1);
        assert_eq!((one.width, one.height), (1, 1));
    }
}
