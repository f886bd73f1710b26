//! A depth frame of the protocol from `sensor_msgs/Image` and `sensor_msgs/CameraInfo`.
//!
//! Depth is along the optical axis: `16UC1` (or `mono16`) in millimetres, `32FC1` in metres, as REP 118 has it; 0, NaN and
//! infinities are no return (REP 117). Everything that does not fit is refused by the field's name.

use graspd_client::wire::{LabelEncoding, LabelImage};
use graspd_client::{CameraIntrinsics, DepthFrame, depth_frame_f32, depth_frame_u16};

use crate::messages::{CameraInfo, Image, Stamp};

/// Most pixels of an image: the protocol's limit.
const MAX_PIXELS: u64 = 1 << 23;
/// Metres for one unit of a 16-bit pixel.
const MILLIMETRE_M: f64 = 0.001;

/// A message that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct FrameError {
    /// Message and field, for example `image.encoding`.
    pub field: &'static str,
    /// What it holds.
    pub found: String,
    /// What it should hold.
    pub expected: &'static str,
}

fn refused<T>(field: &'static str, found: impl ToString, expected: &'static str) -> Result<T, FrameError> {
    Err(FrameError { field, found: found.to_string(), expected })
}

/// Which of a camera's matrices is that of its image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Lens {
    /// K with the distortion D: the image is as the sensor saw it.
    #[default]
    Raw,
    /// P without distortion: the image is rectified.
    Rectified,
}

/// What a pixel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pixel {
    Millimetres,
    Metres,
}

impl Pixel {
    fn of(encoding: &str) -> Result<Self, FrameError> {
        match encoding {
            "16UC1" | "mono16" => Ok(Self::Millimetres),
            "32FC1" => Ok(Self::Metres),
            other => refused("image.encoding", format!("{other:?}"), "16UC1 (millimetres) or 32FC1 (metres)"),
        }
    }

    fn bytes(self) -> u64 {
        match self {
            Self::Millimetres => 2,
            Self::Metres => 4,
        }
    }
}

/// Says whether an image and its camera info can be read, without reading pixels.
///
/// # Errors
/// The first field that does not fit.
pub fn check(image: &Image, info: &CameraInfo, lens: Lens) -> Result<(), FrameError> {
    drop(layout(image, Pixel::of(&image.encoding)?.bytes())?);
    intrinsics(image, info, lens).map(drop)
}

/// The frame that an image and its camera info make. Its capture time is the image's stamp.
///
/// # Errors
/// The first field that does not fit.
pub fn frame(
    image: &Image,
    info: &CameraInfo,
    labels: Option<&Image>,
    lens: Lens,
) -> Result<DepthFrame, FrameError> {
    let pixel = Pixel::of(&image.encoding)?;
    let rows = layout(image, pixel.bytes())?;
    let intrinsics = intrinsics(image, info, lens)?;
    let labels = labels.map(|labels| label_image(labels, image)).transpose()?;
    let (width, height) = (image.width as i32, image.height as i32);
    let big = image.is_bigendian != 0;
    let frame = match pixel {
        Pixel::Millimetres => {
            let read = if big { u16::from_be_bytes } else { u16::from_le_bytes };
            let pixels: Vec<u16> = rows.flat_map(|row| row.as_chunks().0).map(|b| read(*b)).collect();
            depth_frame_u16(width, height, MILLIMETRE_M, &pixels, intrinsics)
        }
        Pixel::Metres => {
            let read = if big { f32::from_be_bytes } else { f32::from_le_bytes };
            // Too near or too far to tell is no return.
            let depth = |b: &[u8; 4]| Some(read(*b)).filter(|d| d.is_finite()).unwrap_or(f32::NAN);
            let pixels: Vec<f32> = rows.flat_map(|row| row.as_chunks().0).map(depth).collect();
            depth_frame_f32(width, height, &pixels, intrinsics)
        }
    };
    Ok(DepthFrame {
        camera_frame_id: image.header.frame_id.clone(),
        capture_time: Some(timestamp(image.header.stamp)),
        labels,
        ..frame
    })
}

fn timestamp(stamp: Stamp) -> prost_types::Timestamp {
    prost_types::Timestamp { seconds: stamp.sec.into(), nanos: stamp.nanosec.min(999_999_999) as i32 }
}

/// The used bytes of every row.
fn layout(image: &Image, pixel_bytes: u64) -> Result<impl Iterator<Item = &[u8]>, FrameError> {
    let (width, height, step) = (u64::from(image.width), u64::from(image.height), u64::from(image.step));
    if width == 0 || height == 0 {
        return refused("image.width, image.height", format!("{width} x {height}"), "more than 0");
    }
    if width * height > MAX_PIXELS {
        return refused("image.width, image.height", format!("{width} x {height}"), "at most 8388608 pixels");
    }
    if step < width * pixel_bytes {
        return refused("image.step", step, "at least the bytes of a row's pixels");
    }
    if image.data.len() as u64 != step * height {
        let found = format!("{} bytes for {height} rows of {step}", image.data.len());
        return refused("image.data", found, "step * height bytes");
    }
    let used = (width * pixel_bytes) as usize;
    Ok(image.data.chunks_exact(step as usize).map(move |row| &row[..used]))
}

/// One byte a pixel, of the depth image's size.
fn label_image(labels: &Image, depth: &Image) -> Result<LabelImage, FrameError> {
    if !matches!(labels.encoding.as_str(), "8UC1" | "mono8") {
        return refused("labels.encoding", format!("{:?}", labels.encoding), "8UC1 or mono8");
    }
    if (labels.width, labels.height) != (depth.width, depth.height) {
        let found = format!("{} x {}", labels.width, labels.height);
        return refused("labels.width, labels.height", found, "the size of the depth image");
    }
    let data: Vec<u8> = layout(labels, 1)?.flatten().copied().collect();
    Ok(LabelImage { encoding: LabelEncoding::RawU8.into(), data: data.into() })
}

/// The lens of this image: a region of the sensor and binned pixels are taken into account.
fn intrinsics(image: &Image, info: &CameraInfo, lens: Lens) -> Result<CameraIntrinsics, FrameError> {
    // Some drivers name only the image's.
    if !info.header.frame_id.is_empty() && info.header.frame_id != image.header.frame_id {
        let found = format!("{:?} for an image of {:?}", info.header.frame_id, image.header.frame_id);
        return refused("camera_info.header.frame_id", found, "the frame of the image");
    }
    let bins = [info.binning_x.max(1), info.binning_y.max(1)];
    let roi = &info.roi;
    // All 0 is the whole image.
    let shown =
        if roi.width == 0 && roi.height == 0 { [info.width, info.height] } else { [roi.width, roi.height] };
    let expected = [shown[0] / bins[0], shown[1] / bins[1]];
    if expected != [image.width, image.height] {
        let found = format!(
            "a lens of {} x {} for an image of {} x {}",
            expected[0], expected[1], image.width, image.height
        );
        return refused("camera_info.width, camera_info.height", found, "the size of the image");
    }
    let (fx, fy, cx, cy, distortion) = match lens {
        Lens::Raw => {
            let k = &info.k;
            (k[0], k[4], k[2], k[5], distortion(info)?)
        }
        Lens::Rectified => {
            let p = &info.p;
            (p[0], p[5], p[2], p[6], Vec::new())
        }
    };
    let field = match lens {
        Lens::Raw => "camera_info.k",
        Lens::Rectified => "camera_info.p",
    };
    if ![fx, fy, cx, cy].iter().all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return refused(field, format!("focal lengths {fx} and {fy}"), "a calibrated camera's");
    }
    // A pixel that is the mean of several has its centre in their middle.
    let moved = |c: f64, offset: u32, bin: u32| (c - f64::from(offset) + 0.5) / f64::from(bin) - 0.5;
    Ok(CameraIntrinsics {
        fx_px: fx / f64::from(bins[0]),
        fy_px: fy / f64::from(bins[1]),
        cx_px: moved(cx, roi.x_offset, bins[0]),
        cy_px: moved(cy, roi.y_offset, bins[1]),
        distortion,
    })
}

/// Coefficients as the protocol has them: k1, k2, p1, p2, k3 and so on, which is ROS's order too.
fn distortion(info: &CameraInfo) -> Result<Vec<f64>, FrameError> {
    if info.d.iter().all(|d| *d == 0.0) {
        return Ok(Vec::new());
    }
    let fits = match info.distortion_model.as_str() {
        "plumb_bob" => matches!(info.d.len(), 4 | 5),
        "rational_polynomial" => info.d.len() == 8,
        other => {
            let expected = "plumb_bob, rational_polynomial, or D of 0 (a rectified image: --rectified)";
            return refused("camera_info.distortion_model", format!("{other:?}"), expected);
        }
    };
    if !fits || !info.d.iter().all(|d| d.is_finite()) {
        let found = format!("{:?} for {}", info.d, info.distortion_model);
        return refused("camera_info.d", found, "four or five numbers, eight for rational_polynomial");
    }
    Ok(info.d.clone())
}

#[cfg(test)]
mod tests;
