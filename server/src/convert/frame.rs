//! Depth frames from the wire: everything but the pixels is checked at once, announced sizes too; pixels are
//! decoded later on a planning thread.

use bytes::Bytes;
use graspd_planner::frame::{Frame, Intrinsics};
use graspd_proto::v1;
use nalgebra::Isometry3;

use super::geometry::pose;
use super::{join, known_enum};
use crate::decode::{self, DecodeError, DepthEncoding, LabelEncoding, Part};
use crate::error::{FieldError, FieldReason};

/// A checked frame whose pixels are still encoded. Cheap to move: the bytes are views into the message.
#[derive(Debug, Clone)]
pub(crate) struct EncodedFrame {
    /// Where it is in the request, for example `frames[0]`.
    pub(crate) path: String,
    /// Width and height, as the frame or its PNG announces them.
    size: (usize, usize),
    encoding: DepthEncoding,
    data: Bytes,
    intrinsics: Intrinsics,
    labels: Option<(LabelEncoding, Bytes)>,
    /// Takes camera coordinates to world coordinates; `None` when the caller gave none.
    pub(crate) world_from_camera: Option<Isometry3<f64>>,
    /// Name of the world frame; `None` when the caller gave no pose.
    pub(crate) world_frame_id: Option<String>,
    /// Name of the optical frame.
    pub(crate) camera_frame_id: String,
    /// As sent.
    pub(crate) capture_time: Option<prost_types::Timestamp>,
}

/// Pixels without a file around them.
#[derive(Debug)]
pub(crate) struct RawPixels<'a> {
    /// Pixels in a row.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// As viewers call it: `16UC1` or `32FC1`.
    pub(crate) encoding: &'static str,
    /// Bytes of a pixel.
    pub(crate) pixel_bytes: u32,
    /// Row by row, little-endian.
    pub(crate) data: &'a Bytes,
}

impl EncodedFrame {
    /// Checks a frame at `path`, for example `frames[0]`.
    pub(crate) fn parse(wire: v1::DepthFrame, path: String) -> Result<Self, FieldError> {
        let encoding = match known_enum(wire.encoding, &join(&path, "encoding"))? {
            v1::DepthEncoding::RawU16 => DepthEncoding::RawU16 { scale_m: wire.depth_scale_m },
            v1::DepthEncoding::RawF32 => DepthEncoding::RawF32,
            v1::DepthEncoding::PngU16 => DepthEncoding::PngU16 { scale_m: wire.depth_scale_m },
            v1::DepthEncoding::Unspecified => {
                return Err(FieldError::missing(join(&path, "encoding"), "RAW_U16, RAW_F32 or PNG_U16"));
            }
        };
        check_scale(encoding, &path)?;
        let may_be_unset = matches!(encoding, DepthEncoding::PngU16 { .. });
        let size = size(wire.width_px, wire.height_px, may_be_unset, &path)?;
        if wire.data.is_empty() {
            return Err(FieldError::missing(join(&path, "data"), "pixels"));
        }
        let size =
            decode::announced_size(encoding, size, &wire.data).map_err(|e| image_fault(e, &path, "data"))?;
        let intrinsics = intrinsics(wire.intrinsics.as_ref(), &join(&path, "intrinsics"))?;
        let labels = wire.labels.map(|labels| label_image(labels, size, &path)).transpose()?;
        let (world_from_camera, world_frame_id) = match &wire.camera_pose {
            None => (None, None),
            Some(given) => {
                let world_from_camera = pose(given.pose.as_ref(), &join(&path, "camera_pose.pose"))?;
                let id = frame_id(&given.frame_id, "world", &join(&path, "camera_pose.frame_id"))?;
                (Some(world_from_camera), Some(id))
            }
        };
        let camera_frame_id = frame_id(&wire.camera_frame_id, "camera", &join(&path, "camera_frame_id"))?;
        Ok(Self {
            path,
            size,
            encoding,
            data: wire.data,
            intrinsics,
            labels,
            world_from_camera,
            world_frame_id,
            camera_frame_id,
            capture_time: wire.capture_time,
        })
    }

    /// Pixels as they were sent, unless they are a PNG.
    pub(crate) fn raw_pixels(&self) -> Option<RawPixels<'_>> {
        let (encoding, pixel_bytes) = match self.encoding {
            DepthEncoding::RawU16 { .. } => ("16UC1", 2),
            DepthEncoding::RawF32 => ("32FC1", 4),
            DepthEncoding::PngU16 { .. } => return None,
        };
        let (width, height) = self.size;
        Some(RawPixels { width, height, encoding, pixel_bytes, data: &self.data })
    }

    /// True when every pixel may carry an object label.
    pub(crate) fn has_labels(&self) -> bool {
        self.labels.is_some()
    }

    /// Pixels that the depth image will have.
    pub(crate) fn pixel_count(&self) -> usize {
        self.size.0 * self.size.1
    }

    /// True if both show the same from the same place, whatever they call it.
    pub(crate) fn is_same_view(&self, other: &Self) -> bool {
        (self.size, self.encoding, self.intrinsics, self.world_from_camera)
            == (other.size, other.encoding, other.intrinsics, other.world_from_camera)
            && self.labels == other.labels
            && self.data == other.data
    }

    /// Hashes enough of the frame to tell most frames apart, and little enough to cost nothing.
    pub(crate) fn hash_samples(&self, hasher: &mut impl std::hash::Hasher) {
        const PIECES: usize = 64;
        const PIECE_BYTES: usize = 64;
        hasher.write_usize(self.data.len());
        let stride = (self.data.len() / PIECES).max(PIECE_BYTES);
        for piece in self.data.chunks(stride) {
            hasher.write(&piece[..piece.len().min(PIECE_BYTES)]);
        }
    }

    /// Decodes the pixels: the frame, and how many pixels were invalid.
    pub(crate) fn decode(&self) -> Result<(Frame, usize), FieldError> {
        let depth = decode::depth(self.encoding, Some(self.size), &self.data)
            .map_err(|e| image_fault(e, &self.path, "data"))?;
        let image = depth.image;
        let labels = match &self.labels {
            None => None,
            Some((encoding, data)) => Some(
                decode::labels(*encoding, image.width, image.height, data)
                    .map_err(|e| image_fault(e, &self.path, "labels.data"))?,
            ),
        };
        let frame =
            Frame { image, intrinsics: self.intrinsics, world_from_camera: self.world_from_camera, labels };
        Ok((frame, depth.invalid_pixels))
    }
}

/// A fault of an image, at its field.
fn image_fault(error: DecodeError, path: &str, data: &str) -> FieldError {
    let field = match error.part {
        Part::Data => join(path, data),
        Part::Width if data == "data" => join(path, "width_px"),
        Part::Height if data == "data" => join(path, "height_px"),
        Part::Scale => join(path, "depth_scale_m"),
        // A label image has no size of its own: its depth image's size was contradicted.
        Part::Width | Part::Height => join(path, data),
    };
    FieldError::new(FieldReason::Image, field, error.found, error.expected)
}

fn check_scale(encoding: DepthEncoding, path: &str) -> Result<(), FieldError> {
    match encoding {
        DepthEncoding::RawF32 => Ok(()),
        DepthEncoding::RawU16 { scale_m } | DepthEncoding::PngU16 { scale_m } => {
            decode::checked_scale(scale_m).map(drop).map_err(|e| image_fault(e, path, "data"))
        }
    }
}

fn size(
    width: i32,
    height: i32,
    may_be_unset: bool,
    path: &str,
) -> Result<Option<(usize, usize)>, FieldError> {
    if may_be_unset && width == 0 && height == 0 {
        return Ok(None);
    }
    let side = |value: i32, name: &str| {
        usize::try_from(value)
            .ok()
            .filter(|v| *v > 0)
            .ok_or_else(|| FieldError::new(FieldReason::Image, join(path, name), value, "at least 1 pixel"))
    };
    Ok(Some((side(width, "width_px")?, side(height, "height_px")?)))
}

fn label_image(
    wire: v1::LabelImage,
    (width, height): (usize, usize),
    frame_path: &str,
) -> Result<(LabelEncoding, Bytes), FieldError> {
    let path = join(frame_path, "labels");
    let encoding = match known_enum(wire.encoding, &join(&path, "encoding"))? {
        v1::LabelEncoding::Unspecified | v1::LabelEncoding::RawU8 => LabelEncoding::RawU8,
        v1::LabelEncoding::PngU8 => LabelEncoding::PngU8,
    };
    if wire.data.is_empty() {
        return Err(FieldError::missing(join(&path, "data"), "pixels"));
    }
    decode::check_label_size(encoding, width, height, &wire.data)
        .map_err(|e| image_fault(e, frame_path, "labels.data"))?;
    Ok((encoding, wire.data))
}

/// The lens: positive focal lengths, everything finite, and a known number of distortion coefficients.
fn intrinsics(wire: Option<&v1::CameraIntrinsics>, path: &str) -> Result<Intrinsics, FieldError> {
    let wire = wire.ok_or_else(|| FieldError::missing(path, "the camera's intrinsics"))?;
    let fault = |name: String, found: f64, expected: &str| {
        Err(FieldError::new(FieldReason::Intrinsics, join(path, name), found, expected))
    };
    for (name, value) in [("fx_px", wire.fx_px), ("fy_px", wire.fy_px)] {
        if !(value.is_finite() && value > 0.0 && value < 1e7) {
            return fault(name.to_owned(), value, "a finite number above 0, pixels");
        }
    }
    for (name, value) in [("cx_px", wire.cx_px), ("cy_px", wire.cy_px)] {
        if !(value.is_finite() && value.abs() < 1e7) {
            return fault(name.to_owned(), value, "a finite number, pixels");
        }
    }
    let given = wire.distortion.len();
    if ![0, 4, 5, 8].contains(&given) {
        return Err(FieldError::new(
            FieldReason::Intrinsics,
            join(path, "distortion"),
            format!("{given} coefficients"),
            "0, 4, 5 or 8 coefficients: k1, k2, p1, p2, k3, k4, k5, k6",
        ));
    }
    let mut distortion = [0.0; 8];
    for (i, (slot, &value)) in distortion.iter_mut().zip(&wire.distortion).enumerate() {
        if !(value.is_finite() && value.abs() < 1e6) {
            return fault(format!("distortion[{i}]"), value, "a finite number");
        }
        *slot = value;
    }
    Ok(Intrinsics { fx_px: wire.fx_px, fy_px: wire.fy_px, cx_px: wire.cx_px, cy_px: wire.cy_px, distortion })
}

/// The name of a frame of reference.
fn frame_id(given: &str, default: &str, path: &str) -> Result<String, FieldError> {
    const LONGEST: usize = 256;
    if given.is_empty() {
        return Ok(default.to_owned());
    }
    if given.len() > LONGEST {
        return Err(FieldError::value(
            path,
            format!("{} bytes", given.len()),
            format!("at most {LONGEST} bytes"),
        ));
    }
    Ok(given.to_owned())
}
