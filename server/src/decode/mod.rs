//! Decoding depth and label images from bytes: raw pixels and PNG, with limits on what they may become.
//!
//! Used for frames from the wire and for files alike. Nothing here panics on any input.

mod png;
mod raw;

use graspd_planner::frame::DepthImage;

/// No image, and no images of one scene together, may decode to more pixels than this, whatever their headers
/// say: a depth image of 4K fits.
pub const MAX_PIXELS: usize = 8 << 20;

/// How the pixels of a depth image are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthEncoding {
    /// 16-bit unsigned little-endian; 0 is no return.
    RawU16 {
        /// Metres for one unit.
        scale_m: f64,
    },
    /// 32-bit float little-endian metres; NaN and 0 are no return.
    RawF32,
    /// A PNG file, 16-bit grayscale; 0 is no return.
    PngU16 {
        /// Metres for one unit.
        scale_m: f64,
    },
}

/// How the pixels of a label image are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LabelEncoding {
    /// One byte a pixel.
    RawU8,
    /// A PNG file, 8-bit grayscale or palette (the index is the label).
    PngU8,
}

/// A decoded depth image.
#[derive(Debug, Clone, PartialEq)]
pub struct DecodedDepth {
    /// The image; a pixel without a return is NaN.
    pub image: DepthImage,
    /// Pixels that were infinite or negative; read as no return.
    pub invalid_pixels: usize,
}

/// Why bytes are not the image that they should be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("found {found}, expected {expected}")]
pub struct DecodeError {
    /// Which of the inputs is at fault.
    pub part: Part,
    /// What was there.
    pub found: String,
    /// What should have been.
    pub expected: String,
}

/// An input of the decoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The pixels or the file.
    Data,
    /// The width.
    Width,
    /// The height.
    Height,
    /// The scale.
    Scale,
}

impl DecodeError {
    fn data(found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { part: Part::Data, found: found.into(), expected: expected.into() }
    }
}

/// Decodes a depth image.
///
/// `size` is (width, height); `None` takes the PNG's own and is an error for raw pixels.
///
/// # Errors
/// [`DecodeError`] when the bytes, the size and the encoding do not fit each other, when the scale is not a
/// positive finite number, or when the image has more than [`MAX_PIXELS`] pixels.
pub fn depth(
    encoding: DepthEncoding,
    size: Option<(usize, usize)>,
    data: &[u8],
) -> Result<DecodedDepth, DecodeError> {
    match encoding {
        DepthEncoding::RawU16 { scale_m } => {
            let (width, height) = raw::checked_size(size, 2, data.len())?;
            let scale = checked_scale(scale_m)?;
            let pixels = data.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
            Ok(raw::scaled(width, height, scale, pixels))
        }
        DepthEncoding::RawF32 => {
            let (width, height) = raw::checked_size(size, 4, data.len())?;
            Ok(raw::metres(width, height, data))
        }
        DepthEncoding::PngU16 { scale_m } => {
            let scale = checked_scale(scale_m)?;
            let (width, height, bytes) = png::decode(data, size, png::Want::Gray16)?;
            let pixels = bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]]));
            Ok(raw::scaled(width, height, scale, pixels))
        }
    }
}

/// Width and height that a depth image will have, from its header alone: nothing is decoded.
///
/// # Errors
/// As [`depth`], as far as the size and the header tell.
pub fn announced_size(
    encoding: DepthEncoding,
    size: Option<(usize, usize)>,
    data: &[u8],
) -> Result<(usize, usize), DecodeError> {
    match encoding {
        DepthEncoding::RawU16 { .. } => raw::checked_size(size, 2, data.len()),
        DepthEncoding::RawF32 => raw::checked_size(size, 4, data.len()),
        DepthEncoding::PngU16 { .. } => png::announced_size(data, size, png::Want::Gray16),
    }
}

/// Checks from its header alone that a label image has the size of its depth image.
///
/// # Errors
/// As [`labels`], as far as the size and the header tell.
pub fn check_label_size(
    encoding: LabelEncoding,
    width: usize,
    height: usize,
    data: &[u8],
) -> Result<(), DecodeError> {
    let size = Some((width, height));
    match encoding {
        LabelEncoding::RawU8 => raw::checked_size(size, 1, data.len()).map(drop),
        LabelEncoding::PngU8 => png::announced_size(data, size, png::Want::Labels8).map(drop),
    }
}

/// Decodes a label image that belongs to a depth image of `width` × `height` pixels.
///
/// # Errors
/// [`DecodeError`] when the bytes do not make an image of that size.
pub fn labels(
    encoding: LabelEncoding,
    width: usize,
    height: usize,
    data: &[u8],
) -> Result<Vec<u8>, DecodeError> {
    match encoding {
        LabelEncoding::RawU8 => {
            raw::checked_size(Some((width, height)), 1, data.len())?;
            Ok(data.to_vec())
        }
        LabelEncoding::PngU8 => Ok(png::decode(data, Some((width, height)), png::Want::Labels8)?.2),
    }
}

/// The scale as it is used, if it is a scale.
pub(crate) fn checked_scale(scale_m: f64) -> Result<f32, DecodeError> {
    if scale_m.is_finite() && scale_m > 0.0 && (scale_m as f32) > 0.0 && (scale_m as f32).is_finite() {
        return Ok(scale_m as f32);
    }
    Err(DecodeError {
        part: Part::Scale,
        found: format!("{scale_m}"),
        expected: "a finite number above 0, metres for one unit of a pixel (0.001 for millimetres)"
            .to_owned(),
    })
}

#[cfg(test)]
mod tests;
