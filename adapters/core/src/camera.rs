//! Depth cameras.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use nalgebra::Isometry3;

use crate::DeviceError;

/// Pinhole intrinsics with Brown-Conrady distortion (OpenCV's rational model).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Principal point, x, pixels; the centre of the first pixel is 0.
    pub cx_px: f64,
    /// Principal point, y, pixels.
    pub cy_px: f64,
    /// k1, k2, p1, p2, k3, k4, k5, k6; zeros for a rectified image.
    pub distortion: [f64; 8],
}

/// What a camera is.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// Name for logs and errors.
    pub name: String,
    /// Model, for example `Azure Kinect NFOV unbinned`.
    pub model: String,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Frames per second that it delivers at most.
    pub frame_rate_hz: f64,
    /// Closest and farthest depth that it measures, metres.
    pub range_m: (f64, f64),
}

/// One depth frame.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFrame {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Distance along the optical axis, metres, row major; 0 where there was no return.
    pub depth_m: Arc<[f32]>,
    /// The lens.
    pub lens: Lens,
    /// Pose of the optical frame in the world at exposure; `None` where the camera does not know.
    pub world_from_camera: Option<Isometry3<f64>>,
    /// Counts the exposures of the device: two frames with one number are one exposure.
    pub sequence: u64,
    /// Time of exposure on the device's clock.
    pub stamp: Duration,
    /// Age of the exposure when the frame was handed over.
    pub age: Duration,
}

/// A depth camera.
#[async_trait]
pub trait DepthCamera: Send + Sync + std::fmt::Debug {
    /// What it is. Known without asking the device again.
    fn info(&self) -> CameraInfo;

    /// The next frame exposed after the call, no older than `max_age` when it is handed over.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`] when none comes in time, [`DeviceError::Stale`] when only older ones come,
    /// [`DeviceError::Disconnected`] when the device is away. A dropped frame is not an error while a later one
    /// comes in time.
    async fn capture(&self, max_age: Duration, timeout: Duration) -> Result<DepthFrame, DeviceError>;
}
