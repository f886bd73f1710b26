//! Label images: an 8-bit PNG, 0 for background, one number per object.

use std::io::Cursor;
use std::path::Path;

use super::InputError;

/// Reads the labels of an image of the given size.
///
/// # Errors
/// If the file is no 8-bit grey or palette PNG of that size.
pub(crate) fn open(path: &Path, width: usize, height: usize) -> Result<Vec<u8>, InputError> {
    parse(&path.display().to_string(), &super::read(path)?, width, height)
}

fn parse(file: &str, bytes: &[u8], width: usize, height: usize) -> Result<Vec<u8>, InputError> {
    let broken = |e: png::DecodingError| InputError::wrong(file, "PNG data", e, "a whole PNG file");
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(broken)?;
    let found = (reader.info().width as usize, reader.info().height as usize);
    if found != (width, height) {
        let expected = format!("{width} x {height}, the size of the depth image");
        return Err(InputError::wrong(file, "size", format!("{} x {}", found.0, found.1), expected));
    }
    let (color, bits) = reader.output_color_type();
    if !matches!(color, png::ColorType::Grayscale | png::ColorType::Indexed) || bits != png::BitDepth::Eight {
        let found = format!("{color:?} with {} bits", bits as u8);
        return Err(InputError::wrong(file, "pixel type", found, "Grayscale or Indexed with 8 bits"));
    }
    let mut labels = vec![0; width * height];
    reader.next_frame(&mut labels).map_err(broken)?;
    Ok(labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_has_to_be_that_of_the_depth_image() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().unwrap().write_image_data(&[0, 7]).unwrap();
        assert_eq!(parse("l.png", &bytes, 2, 1).unwrap(), vec![0, 7]);
        let message = parse("l.png", &bytes, 3, 1).unwrap_err().to_string();
        assert_eq!(message, "l.png: size: found 2 x 1, expected 3 x 1, the size of the depth image");
    }
}
