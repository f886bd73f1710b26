//! PNG files: the kind that is wanted, the size that was announced, and no more memory than that.

use std::io::Cursor;

use png::{BitDepth, ColorType, Decoder, Limits, Transformations};

use super::raw::checked_pixel_count;
use super::{DecodeError, Part};

/// What the decoder itself may allocate besides the image (one row, text chunks, palette).
const DECODER_BYTES: usize = 1 << 20;

/// No deflate stream inflates to more than 1032 times its size.
const DEFLATE_RATIO: usize = 1032;

/// Which PNG is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Want {
    /// 16-bit grayscale: depth.
    Gray16,
    /// 8-bit grayscale or palette: labels.
    Labels8,
}

impl Want {
    fn accepts(self, color: ColorType, depth: BitDepth) -> bool {
        match self {
            Self::Gray16 => color == ColorType::Grayscale && depth == BitDepth::Sixteen,
            Self::Labels8 => {
                matches!(color, ColorType::Grayscale | ColorType::Indexed) && depth == BitDepth::Eight
            }
        }
    }

    fn describe(self) -> &'static str {
        match self {
            Self::Gray16 => "a PNG file of 16-bit grayscale",
            Self::Labels8 => "a PNG file of 8-bit grayscale or palette",
        }
    }

    fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Gray16 => 2,
            Self::Labels8 => 1,
        }
    }
}

type Source<'a> = Decoder<Cursor<&'a [u8]>>;

/// Width and height, from the header alone.
pub(super) fn announced_size(
    data: &[u8],
    size: Option<(usize, usize)>,
    want: Want,
) -> Result<(usize, usize), DecodeError> {
    open(data, size, want).map(|(_, size)| size)
}

/// Width, height and the samples as they are in the file (16-bit samples big-endian).
pub(super) fn decode(
    data: &[u8],
    size: Option<(usize, usize)>,
    want: Want,
) -> Result<(usize, usize, Vec<u8>), DecodeError> {
    let fault = |error| does_not_decode(data, want, &error);
    let (mut decoder, (width, height)) = open(data, size, want)?;
    let byte_count = width * height * want.bytes_per_pixel();
    // Rows are inflated one at a time, so the decoder's own share is a few rows.
    decoder.set_limits(Limits { bytes: DECODER_BYTES + 8 * width * want.bytes_per_pixel() });
    let mut reader = decoder.read_info().map_err(fault)?;
    let mut pixels = vec![0; byte_count];
    match reader.output_buffer_size() {
        Some(needed) if needed == pixels.len() => {}
        _ => return Err(DecodeError::data("a PNG file whose rows do not fit its header", want.describe())),
    }
    reader.next_frame(&mut pixels).map_err(fault)?;
    Ok((width, height, pixels))
}

/// Reads and checks the header before any pixel is inflated, so a small file cannot become a large allocation.
fn open(
    data: &[u8],
    size: Option<(usize, usize)>,
    want: Want,
) -> Result<(Source<'_>, (usize, usize)), DecodeError> {
    let mut decoder = Decoder::new_with_limits(Cursor::new(data), Limits { bytes: DECODER_BYTES });
    decoder.set_transformations(Transformations::IDENTITY);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let header = decoder.read_header_info().map_err(|error| does_not_decode(data, want, &error))?;
    let (width, height) = (header.width as usize, header.height as usize);
    let (color, depth) = (header.color_type, header.bit_depth);
    if !want.accepts(color, depth) {
        return Err(DecodeError::data(
            format!("a PNG file of {}-bit {color:?}", depth as u8),
            want.describe(),
        ));
    }
    let pixel_count =
        checked_pixel_count(width, height).map_err(|e| DecodeError { part: Part::Data, ..e })?;
    check_announced_size(size, (width, height))?;
    if pixel_count * want.bytes_per_pixel() / DEFLATE_RATIO > data.len() {
        return Err(DecodeError::data(
            format!("{} bytes of PNG that announce {width} × {height} pixels", data.len()),
            "a complete PNG file; so few bytes cannot hold so many pixels",
        ));
    }
    Ok((decoder, (width, height)))
}

fn does_not_decode(data: &[u8], want: Want, error: &png::DecodingError) -> DecodeError {
    DecodeError::data(format!("{} bytes that do not decode: {error}", data.len()), want.describe())
}

/// The frame may leave its size to the PNG, but may not contradict it.
fn check_announced_size(announced: Option<(usize, usize)>, found: (usize, usize)) -> Result<(), DecodeError> {
    let Some(announced) = announced else { return Ok(()) };
    for (part, said, is) in [(Part::Width, announced.0, found.0), (Part::Height, announced.1, found.1)] {
        if said != is {
            return Err(DecodeError {
                part,
                found: said.to_string(),
                expected: format!("{is}, as the PNG file itself says"),
            });
        }
    }
    Ok(())
}
