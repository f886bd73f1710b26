//! Raw pixels: sizes that must fit, and the meaning of special values.

use graspd_planner::frame::DepthImage;

use super::{DecodeError, DecodedDepth, MAX_PIXELS, Part};

/// Width and height, if `byte_count` bytes are exactly that many pixels.
pub(super) fn checked_size(
    size: Option<(usize, usize)>,
    bytes_per_pixel: usize,
    byte_count: usize,
) -> Result<(usize, usize), DecodeError> {
    let (width, height) = size.unwrap_or((0, 0));
    checked_pixel_count(width, height)?;
    let expected = width * height * bytes_per_pixel;
    if byte_count != expected {
        return Err(DecodeError::data(
            format!("{byte_count} bytes"),
            format!("{expected} bytes ({width} × {height} pixels of {bytes_per_pixel} bytes)"),
        ));
    }
    Ok((width, height))
}

/// Number of pixels, if an image of that size is taken at all.
pub(super) fn checked_pixel_count(width: usize, height: usize) -> Result<usize, DecodeError> {
    for (part, value, name) in [(Part::Width, width, "width"), (Part::Height, height, "height")] {
        if value == 0 {
            return Err(DecodeError {
                part,
                found: "0".to_owned(),
                expected: format!("a {name} of at least 1 pixel"),
            });
        }
    }
    match width.checked_mul(height) {
        Some(count) if count <= MAX_PIXELS => Ok(count),
        _ => Err(DecodeError {
            part: Part::Width,
            found: format!("{width} × {height} pixels"),
            expected: format!("at most {MAX_PIXELS} pixels"),
        }),
    }
}

/// 16-bit pixels as metres.
pub(super) fn scaled(
    width: usize,
    height: usize,
    scale_m: f32,
    pixels: impl Iterator<Item = u16>,
) -> DecodedDepth {
    let depth_m = pixels.map(|p| if p == 0 { f32::NAN } else { f32::from(p) * scale_m }).collect();
    DecodedDepth { image: DepthImage { width, height, depth_m }, invalid_pixels: 0 }
}

/// Float pixels; what cannot be a distance becomes NaN and is counted, NaN and 0 are what they are: no return.
pub(super) fn metres(width: usize, height: usize, data: &[u8]) -> DecodedDepth {
    let mut invalid_pixels = 0;
    let depth_m = data
        .chunks_exact(4)
        .map(|b| {
            let value = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            if value.is_infinite() || value < 0.0 {
                invalid_pixels += 1;
            }
            if value.is_finite() && value > 0.0 { value } else { f32::NAN }
        })
        .collect();
    DecodedDepth { image: DepthImage { width, height, depth_m }, invalid_pixels }
}
