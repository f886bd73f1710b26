//! Label images: an 8-bit PNG, 0 for background, one number per object.

use std::path::Path;

use graspd_server::decode::{self, LabelEncoding, Part};

use super::InputError;

/// Reads the labels of an image of the given size.
///
/// # Errors
/// If the file is no 8-bit grey or palette PNG of that size.
pub(crate) fn open(path: &Path, width: usize, height: usize) -> Result<Vec<u8>, InputError> {
    parse(&path.display().to_string(), &super::read(path)?, width, height)
}

fn parse(file: &str, bytes: &[u8], width: usize, height: usize) -> Result<Vec<u8>, InputError> {
    decode::labels(LabelEncoding::PngU8, width, height, bytes).map_err(|e| match e.part {
        Part::Width | Part::Height => {
            let expected = format!("{width} x {height}, the size of the depth image");
            InputError::wrong(file, "size", format!("another {}", side(e.part)), expected)
        }
        _ => InputError::wrong(file, "PNG data", e.found, e.expected),
    })
}

fn side(part: Part) -> &'static str {
    if part == Part::Width { "width" } else { "height" }
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
        assert_eq!(message, "l.png: size: found another width, expected 3 x 1, the size of the depth image");
    }
}
