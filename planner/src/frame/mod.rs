//! Depth frames: an image, the lens that took it, and where the camera stood.

use nalgebra::Isometry3;

/// A depth image in metres, row major; a pixel without a return is NaN, zero or negative.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Distance along the optical axis, metres; `width * height` values.
    pub depth_m: Vec<f32>,
}

/// Pinhole intrinsics with Brown-Conrady distortion (OpenCV's rational model).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Principal point, x, pixels.
    pub cx_px: f64,
    /// Principal point, y, pixels.
    pub cy_px: f64,
    /// k1, k2, p1, p2, k3, k4, k5, k6; zeros for a rectified image.
    pub distortion: [f64; 8],
}

/// One view of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The image.
    pub image: DepthImage,
    /// The lens.
    pub intrinsics: Intrinsics,
    /// Pose of the optical frame; `None` when the caller knows nothing, then the camera frame is the world.
    pub world_from_camera: Option<Isometry3<f64>>,
    /// Object label of each pixel (0 background), same size as the image.
    pub labels: Option<Vec<u8>>,
}
