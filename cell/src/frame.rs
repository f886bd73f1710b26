//! Depth frames as they are sent and recorded: whole millimetres, so that a record holds exactly what was planned
//! from.
//!
//! The files are those that `graspd plan` reads: a 16-bit grey PNG, and a JSON object with `fx`, `fy`, `cx`, `cy`,
//! `width`, `height`, `depth_scale`, `camera_to_world` (4 by 4, row major) and `distortion`.

use graspd_adapters_core::DepthFrame;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Metres for one unit of a pixel.
pub const DEPTH_SCALE_M: f64 = 0.001;
/// Largest image edge that is read back, pixels.
const MAX_EDGE: u32 = 8192;

/// Why a recorded frame cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// The image is not a 16-bit grey PNG.
    #[error("depth image: found {found}, expected a 16-bit grey PNG of {expected}")]
    Image {
        /// What was found.
        found: String,
        /// The expected size.
        expected: String,
    },
    /// The JSON is not that of a frame.
    #[error("frame file: {0}")]
    Json(#[from] serde_json::Error),
    /// The pose of the camera is not one.
    #[error("camera_to_world: found {found}, expected a rotation, a translation in metres and 0 0 0 1")]
    Pose {
        /// What was found.
        found: String,
    },
    /// The frame of a device is not whole.
    #[error("frame: found {found} pixels, expected {expected}")]
    Size {
        /// Pixels that came.
        found: usize,
        /// Width times height.
        expected: usize,
    },
    /// The PNG cannot be written.
    #[error("depth image cannot be encoded")]
    Encoding(#[from] png::EncodingError),
}

/// What stands in the JSON file beside a depth image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameInfo {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, x, pixels.
    pub cx: f64,
    /// Principal point, y, pixels.
    pub cy: f64,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Metres for one unit of a pixel.
    pub depth_scale: f64,
    /// Pose of the optical frame in the world, 4 by 4, row major.
    pub camera_to_world: [[f64; 4]; 4],
    /// k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV's order).
    pub distortion: [f64; 8],
}

/// A depth frame in whole millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Lens, size, pose.
    pub info: FrameInfo,
    /// Millimetres along the optical axis, row major; 0 is no return.
    pub millimetres: Vec<u16>,
}

impl Frame {
    /// The frame of a device, in whole millimetres; what is no number, negative or beyond 65.535 m is no return.
    /// `world_from_camera` stands in where the camera does not know its pose.
    ///
    /// The numbers of the frame are those that a reader of its files gets: so a plan from the files is the plan from
    /// the frame, bit for bit.
    ///
    /// # Errors
    /// [`FrameError`] for an image of another size than it says, or a pose that is not one.
    pub fn of(frame: &DepthFrame, world_from_camera: &Isometry3<f64>) -> Result<Self, FrameError> {
        let expected = frame.width.saturating_mul(frame.height);
        if frame.depth_m.len() != expected || expected == 0 {
            return Err(FrameError::Size { found: frame.depth_m.len(), expected });
        }
        let side = |n: usize| u32::try_from(n).map_err(|_| FrameError::Size { found: n, expected });
        let pose = frame.world_from_camera.as_ref().unwrap_or(world_from_camera).to_homogeneous();
        let info = FrameInfo {
            fx: frame.lens.fx_px,
            fy: frame.lens.fy_px,
            cx: frame.lens.cx_px,
            cy: frame.lens.cy_px,
            width: side(frame.width)?,
            height: side(frame.height)?,
            depth_scale: DEPTH_SCALE_M,
            camera_to_world: std::array::from_fn(|r| std::array::from_fn(|c| pose[(r, c)])),
            distortion: frame.lens.distortion,
        };
        let info: FrameInfo = serde_json::from_str(&serde_json::to_string(&info)?)?;
        let millimetres = frame.depth_m.iter().map(|&d| millimetres(d)).collect();
        let frame = Self { info, millimetres };
        frame.world_from_camera()?;
        Ok(frame)
    }

    /// Reads the two files of a frame.
    ///
    /// # Errors
    /// [`FrameError`] with what was found.
    pub fn read(png: &[u8], json: &[u8]) -> Result<Self, FrameError> {
        let info: FrameInfo = serde_json::from_slice(json)?;
        let expected = format!("{} x {}", info.width, info.height);
        let fault = |found: String| FrameError::Image { found, expected: expected.clone() };
        let decoder = png::Decoder::new(std::io::Cursor::new(png));
        let mut reader = decoder.read_info().map_err(|e| fault(e.to_string()))?;
        let head = reader.info();
        let (size, kind) = ((head.width, head.height), (head.color_type, head.bit_depth));
        if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen)
            || size != (info.width, info.height)
            || size.0.max(size.1) > MAX_EDGE
        {
            return Err(fault(format!("{} x {}, {:?} {:?}", size.0, size.1, kind.0, kind.1)));
        }
        let bytes = reader.output_buffer_size().ok_or_else(|| fault("a size that overflows".into()))?;
        let mut data = vec![0; bytes];
        reader.next_frame(&mut data).map_err(|e| fault(e.to_string()))?;
        let millimetres = data.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
        let frame = Self { info, millimetres };
        frame.world_from_camera()?;
        Ok(frame)
    }

    /// The image as a file.
    ///
    /// # Errors
    /// [`FrameError::Encoding`].
    pub fn png(&self) -> Result<Vec<u8>, FrameError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.info.width, self.info.height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.set_compression(png::Compression::Fast);
        let data: Vec<u8> = self.millimetres.iter().flat_map(|d| d.to_be_bytes()).collect();
        encoder.write_header()?.write_image_data(&data)?;
        Ok(bytes)
    }

    /// The JSON file beside the image.
    ///
    /// # Errors
    /// [`FrameError::Json`].
    pub fn json(&self) -> Result<String, FrameError> {
        Ok(serde_json::to_string(&self.info)?)
    }

    /// Pose of the camera.
    ///
    /// # Errors
    /// [`FrameError::Pose`] when the matrix is not a rigid motion.
    pub fn world_from_camera(&self) -> Result<Isometry3<f64>, FrameError> {
        let m = &self.info.camera_to_world;
        let linear = Matrix3::from_fn(|r, c| m[r][c]);
        let rigid = (linear * linear.transpose() - Matrix3::identity()).abs().max() < 1e-3
            && linear.determinant() > 0.0
            && m.iter().flatten().all(|x| x.is_finite())
            && m[3] == [0.0, 0.0, 0.0, 1.0];
        if !rigid {
            return Err(FrameError::Pose { found: format!("{m:?}") });
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(linear));
        Ok(Isometry3::from_parts(Translation3::from(Vector3::new(m[0][3], m[1][3], m[2][3])), rotation))
    }
}

fn millimetres(depth_m: f32) -> u16 {
    let mm = (f64::from(depth_m) / DEPTH_SCALE_M).round();
    if mm > 0.0 && mm <= f64::from(u16::MAX) { mm as u16 } else { 0 }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use graspd_adapters_core::Lens;
    use proptest::prelude::*;
    use std::sync::Arc;
    use std::time::Duration;

    pub(crate) fn device_frame(width: usize, height: usize, depth_m: Vec<f32>) -> DepthFrame {
        DepthFrame {
            width,
            height,
            depth_m: Arc::from(depth_m),
            lens: Lens { fx_px: 503.1, fy_px: 503.7, cx_px: 3.3, cy_px: 1.7, distortion: [0.0; 8] },
            world_from_camera: Some(Isometry3::new(
                Vector3::new(0.01, -0.25, 0.75),
                Vector3::new(2.7, 0.1, -0.03),
            )),
            sequence: 1,
            stamp: Duration::ZERO,
            age: Duration::ZERO,
        }
    }

    #[test]
    fn what_is_no_return_is_zero() {
        let found: Vec<u16> =
            [0.0, f32::NAN, -1.0, f32::INFINITY, 0.7004, 0.7006, 70.0].into_iter().map(millimetres).collect();
        assert_eq!(found, [0, 0, 0, 0, 700, 701, 0]);
    }

    #[test]
    fn a_frame_that_is_not_whole_is_refused() {
        let identity = Isometry3::identity();
        let error = Frame::of(&device_frame(3, 2, vec![0.5; 5]), &identity).unwrap_err();
        assert_eq!(error.to_string(), "frame: found 5 pixels, expected 6");
        assert!(Frame::of(&device_frame(0, 0, vec![]), &identity).is_err());
        let frame = Frame::of(&device_frame(3, 2, vec![0.5; 6]), &identity).unwrap();
        let wrong = Frame { info: FrameInfo { width: 2, height: 3, ..frame.info.clone() }, ..frame.clone() };
        let error = Frame::read(&frame.png().unwrap(), wrong.json().unwrap().as_bytes()).unwrap_err();
        assert!(error.to_string().contains("found 3 x 2"), "{error}");
    }

    proptest! {
        #[test]
        fn files_give_back_the_frame_bit_for_bit(
            depth in prop::collection::vec(-0.1..3.0f32, 12),
            r in prop::array::uniform3(-3.0..3.0f64),
            t in prop::array::uniform3(-3.0..3.0f64),
            f in 100.0..900.0f64,
        ) {
            let mut device = device_frame(4, 3, depth);
            device.world_from_camera = Some(Isometry3::new(Vector3::from(t), Vector3::from(r)));
            device.lens.fx_px = f;
            let frame = Frame::of(&device, &Isometry3::identity()).unwrap();
            let read = Frame::read(&frame.png().unwrap(), frame.json().unwrap().as_bytes()).unwrap();
            prop_assert_eq!(&read, &frame);
            prop_assert_eq!(read.world_from_camera().unwrap(), frame.world_from_camera().unwrap());
            let pose = device.world_from_camera.unwrap();
            prop_assert!((frame.world_from_camera().unwrap().inverse() * pose).rotation.angle() < 1e-7);
        }
    }
}
