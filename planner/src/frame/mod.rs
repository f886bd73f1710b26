//! Depth frames: an image, the lens that took it, and where the camera stood.

mod clean;
mod lens;

pub use clean::{CleanOptions, MAX_DEPTH_M, clean_depth};

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

/// What is wrong with a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Width or height is zero.
    #[error("image: found {width} x {height} pixels, expected at least 1 x 1")]
    EmptyImage {
        /// Found width, pixels.
        width: usize,
        /// Found height, pixels.
        height: usize,
    },
    /// Width or height is beyond what any sensor gives.
    #[error("image: found {width} x {height} pixels, expected at most {MAX_SIDE_PX} along each side")]
    ImageTooLarge {
        /// Found width, pixels.
        width: usize,
        /// Found height, pixels.
        height: usize,
    },
    /// The number of depth values is not `width * height`.
    #[error("image.depth: found {found} values, expected width * height = {expected}")]
    DepthSize {
        /// Found values.
        found: usize,
        /// Expected values.
        expected: usize,
    },
    /// The number of labels is not `width * height`.
    #[error("labels: found {found} values, expected width * height = {expected}")]
    LabelSize {
        /// Found values.
        found: usize,
        /// Expected values.
        expected: usize,
    },
    /// A focal length is not a positive number.
    #[error("intrinsics.{field}: found {found}, expected a finite value above 0 pixels")]
    FocalLength {
        /// `fx` or `fy`.
        field: &'static str,
        /// Found value.
        found: f64,
    },
    /// A principal point is not a number.
    #[error("intrinsics.{field}: found {found}, expected a finite value in pixels")]
    PrincipalPoint {
        /// `cx` or `cy`.
        field: &'static str,
        /// Found value.
        found: f64,
    },
    /// A distortion coefficient is not a number.
    #[error("intrinsics.distortion.{field}: found {found}, expected a finite value")]
    Distortion {
        /// Name of the coefficient, for example `k3`.
        field: &'static str,
        /// Found value.
        found: f64,
    },
    /// The pose has a value that is not a number or out of range, or a quaternion that is not of unit length.
    #[error("world_from_camera: found {found}, expected a translation within 1e6 m and a unit quaternion")]
    Pose {
        /// The offending part.
        found: String,
    },
}

/// Largest accepted image side, pixels.
pub const MAX_SIDE_PX: usize = 16_384;

/// Largest accepted coordinate of a pose, metres: beyond it the world frame leaves no precision for voxels.
pub const MAX_TRANSLATION_M: f64 = 1e6;

/// Names of the distortion coefficients in the order of [`Intrinsics::distortion`].
const DISTORTION_NAMES: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];

impl Intrinsics {
    /// Checks every number.
    ///
    /// # Errors
    /// [`FrameError`] with the field, what was found and what was expected.
    pub fn validate(&self) -> Result<(), FrameError> {
        for (field, found) in [("fx", self.fx_px), ("fy", self.fy_px)] {
            if !(found.is_finite() && found > 0.0) {
                return Err(FrameError::FocalLength { field, found });
            }
        }
        for (field, found) in [("cx", self.cx_px), ("cy", self.cy_px)] {
            if !found.is_finite() {
                return Err(FrameError::PrincipalPoint { field, found });
            }
        }
        for (field, found) in DISTORTION_NAMES.into_iter().zip(self.distortion) {
            if !found.is_finite() {
                return Err(FrameError::Distortion { field, found });
            }
        }
        Ok(())
    }
}

impl Frame {
    /// Checks sizes, intrinsics and pose. Depth values are not checked: a pixel without a usable depth is a
    /// hole, and an image of holes only is a frame in which nothing is seen.
    ///
    /// # Errors
    /// [`FrameError`] with the field, what was found and what was expected.
    pub fn validate(&self) -> Result<(), FrameError> {
        let (width, height) = (self.image.width, self.image.height);
        if width == 0 || height == 0 {
            return Err(FrameError::EmptyImage { width, height });
        }
        if width > MAX_SIDE_PX || height > MAX_SIDE_PX {
            return Err(FrameError::ImageTooLarge { width, height });
        }
        let expected = width * height;
        let found = self.image.depth_m.len();
        if found != expected {
            return Err(FrameError::DepthSize { found, expected });
        }
        if let Some(labels) = &self.labels
            && labels.len() != expected
        {
            return Err(FrameError::LabelSize { found: labels.len(), expected });
        }
        self.intrinsics.validate()?;
        if let Some(pose) = &self.world_from_camera {
            let t = pose.translation.vector;
            let norm = pose.rotation.as_ref().norm();
            if !t.iter().all(|v| v.abs() <= MAX_TRANSLATION_M) {
                return Err(FrameError::Pose { found: format!("translation ({}, {}, {})", t.x, t.y, t.z) });
            }
            if norm.is_nan() || (norm - 1.0).abs() > 1e-3 {
                return Err(FrameError::Pose { found: format!("quaternion of length {norm}") });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        Frame {
            image: DepthImage { width: 4, height: 3, depth_m: vec![1.0; 12] },
            intrinsics: Intrinsics { fx_px: 4.0, fy_px: 4.0, cx_px: 1.5, cy_px: 1.0, distortion: [0.0; 8] },
            world_from_camera: None,
            labels: None,
        }
    }

    #[test]
    fn accepts_a_sound_frame_and_one_of_holes_only() {
        assert_eq!(frame().validate(), Ok(()));
        let mut holes = frame();
        holes.image.depth_m = vec![f32::NAN; 12];
        assert_eq!(holes.validate(), Ok(()));
    }

    #[test]
    fn names_what_is_wrong() {
        let mut f = frame();
        f.image.depth_m.pop();
        assert_eq!(f.validate(), Err(FrameError::DepthSize { found: 11, expected: 12 }));
        let mut f = frame();
        f.labels = Some(vec![0; 5]);
        assert_eq!(f.validate(), Err(FrameError::LabelSize { found: 5, expected: 12 }));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut f = frame();
            f.intrinsics.fy_px = bad;
            assert!(matches!(f.validate(), Err(FrameError::FocalLength { field: "fy", .. })));
        }
        let mut f = frame();
        f.intrinsics.cx_px = f64::NAN;
        assert!(matches!(f.validate(), Err(FrameError::PrincipalPoint { field: "cx", .. })));
        let mut f = frame();
        f.intrinsics.distortion[4] = f64::INFINITY;
        assert!(matches!(f.validate(), Err(FrameError::Distortion { field: "k3", .. })));
        let mut f = frame();
        f.image.width = 0;
        assert_eq!(f.validate(), Err(FrameError::EmptyImage { width: 0, height: 3 }));
        let mut f = frame();
        f.world_from_camera = Some(Isometry3::translation(f64::NAN, 0.0, 0.0));
        assert!(matches!(f.validate(), Err(FrameError::Pose { .. })));
    }
}
