//! The points of a depth image that table finding and placing look at: an even subsample, in the optical frame.

use nalgebra::{Isometry3, Point3};

use crate::budget::Budget;
use crate::frame::Frame;

/// About so many pixels are looked at.
const SAMPLES: usize = 20_000;

/// An even subsample of a frame's points.
#[derive(Debug, Clone)]
pub struct FramePoints {
    /// Points in the optical frame, metres.
    pub camera: Vec<Point3<f64>>,
    /// How far each point is from the image's middle: 0 there, 1 on the border, the larger of both axes.
    pub eccentricity: Vec<f64>,
    /// Pose of the camera; identity when the caller gave none.
    pub world_from_camera: Isometry3<f64>,
    /// True when the caller gave the pose, so that the world's z axis means up.
    pub posed: bool,
}

/// Points of every k-th pixel in both directions of a cleaned depth image (0 is a hole).
///
/// The budget is looked at in every row. When it ends the other rows are left out: the caller looks at it next.
pub fn frame_points(frame: &Frame, depth: &[f32], budget: &dyn Budget) -> FramePoints {
    let (width, height) = (frame.image.width, frame.image.height);
    let mut points = FramePoints {
        camera: Vec::new(),
        eccentricity: Vec::new(),
        world_from_camera: frame.world_from_camera.unwrap_or_else(Isometry3::identity),
        posed: frame.world_from_camera.is_some(),
    };
    if width == 0 || depth.len() != width * height {
        return points;
    }
    let step = (((width * height) as f64 / SAMPLES as f64).sqrt().floor() as usize).max(1);
    for row in (step / 2..height).step_by(step) {
        if budget.stop().is_some() {
            break;
        }
        for column in (step / 2..width).step_by(step) {
            let z = f64::from(depth[row * width + column]);
            if z <= 0.0 {
                continue;
            }
            let ray = frame.intrinsics.ray([column as f64, row as f64]);
            if let Some([x, y]) = ray {
                points.camera.push(Point3::new(x * z, y * z, z));
                let share = |at: usize, count: usize| (2.0 * (at as f64 + 0.5) / count as f64 - 1.0).abs();
                points.eccentricity.push(share(column, width).max(share(row, height)));
            }
        }
    }
    points
}
