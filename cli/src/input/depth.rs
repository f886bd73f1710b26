//! Depth images: 16-bit PNG, or a NumPy array of integers or floating-point metres.

use std::path::Path;

use graspd_planner::frame::DepthImage;
use graspd_server::decode::{self, DepthEncoding};

use super::InputError;

/// Largest image edge, pixels.
const MAX_EDGE: usize = 8192;

/// Pixel values as they stand in the file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum DepthValues {
    /// Integers, to be multiplied by the intrinsics file's `depth_scale`; 0 is no return.
    U16(Vec<u16>),
    /// Metres; NaN, zero or less is no return.
    Metres(Vec<f32>),
}

/// A depth image as it stands in its file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RawDepth {
    /// The file's name, for messages.
    pub(crate) file: String,
    /// Width, pixels.
    pub(crate) width: usize,
    /// Height, pixels.
    pub(crate) height: usize,
    /// `width * height` values, row major.
    pub(crate) values: DepthValues,
}

impl RawDepth {
    /// Reads a `.png` or `.npy` file.
    ///
    /// # Errors
    /// If the file is unreadable, or neither of these, or of another pixel type.
    pub(crate) fn open(path: &Path) -> Result<Self, InputError> {
        let file = path.display().to_string();
        let bytes = super::read(path)?;
        if bytes.starts_with(b"\x89PNG") {
            Self::from_png(&file, &bytes)
        } else if bytes.starts_with(b"\x93NUMPY") {
            Self::from_npy(&file, &bytes)
        } else {
            let head: String = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect();
            let found =
                if head.is_empty() { "an empty file".to_owned() } else { format!("first bytes {head}") };
            Err(InputError::wrong(&file, "format", found, "a 16-bit grey PNG or a NumPy .npy array"))
        }
    }

    /// Decodes a 16-bit grey PNG.
    ///
    /// # Errors
    /// If it is no PNG or has another pixel type.
    pub(crate) fn from_png(file: &str, bytes: &[u8]) -> Result<Self, InputError> {
        // Units of one: the pixels as they stand in the file, which single precision holds exactly.
        let decoded = decode::depth(DepthEncoding::PngU16 { scale_m: 1.0 }, None, bytes)
            .map_err(|e| InputError::wrong(file, "PNG data", e.found, e.expected))?;
        let DepthImage { width, height, depth_m } = decoded.image;
        check_size(file, width, height)?;
        let no_return = |d: f32| if d.is_nan() { 0 } else { d as u16 };
        let values = depth_m.into_iter().map(no_return).collect();
        Ok(Self { file: file.into(), width, height, values: DepthValues::U16(values) })
    }

    /// Decodes a two-dimensional NumPy array of u16 (scaled) or f32, f64 (metres).
    ///
    /// # Errors
    /// If the array has another shape or type.
    pub(crate) fn from_npy(file: &str, bytes: &[u8]) -> Result<Self, InputError> {
        let broken = |e: std::io::Error| InputError::wrong(file, "NumPy data", e, "a whole .npy file");
        let npy = npyz::NpyFile::new(bytes).map_err(broken)?;
        let shape = npy.shape().to_vec();
        let &[height, width] = shape.as_slice() else {
            return Err(InputError::wrong(file, "shape", format!("{shape:?}"), "(height, width)"));
        };
        let (width, height) = (width as usize, height as usize);
        check_size(file, width, height)?;
        if npy.order() != npyz::Order::C {
            return Err(InputError::wrong(file, "order", "Fortran order", "C order (np.ascontiguousarray)"));
        }
        let kind = npy.dtype().descr();
        let values = match kind.trim_matches('\'').trim_start_matches(['<', '>', '|', '=']) {
            "u2" => DepthValues::U16(npy.into_vec().map_err(broken)?),
            "f4" => DepthValues::Metres(npy.into_vec().map_err(broken)?),
            "f8" => DepthValues::Metres(
                npy.into_vec::<f64>().map_err(broken)?.into_iter().map(|d| d as f32).collect(),
            ),
            _ => return Err(InputError::wrong(file, "dtype", kind, "uint16, float32 or float64")),
        };
        Ok(Self { file: file.into(), width, height, values })
    }

    /// The image in metres; integers are multiplied by `depth_scale`.
    pub(crate) fn in_metres(&self, depth_scale: f64) -> DepthImage {
        let depth_m = match &self.values {
            DepthValues::U16(values) => values.iter().map(|&d| f32::from(d) * depth_scale as f32).collect(),
            DepthValues::Metres(values) => values.clone(),
        };
        DepthImage { width: self.width, height: self.height, depth_m }
    }

    /// The integers, where the file had integers.
    #[cfg(test)]
    pub(crate) fn as_u16(&self) -> Option<&[u16]> {
        match &self.values {
            DepthValues::U16(values) => Some(values),
            DepthValues::Metres(_) => None,
        }
    }
}

fn check_size(file: &str, width: usize, height: usize) -> Result<(), InputError> {
    if width == 0 || height == 0 || width > MAX_EDGE || height > MAX_EDGE {
        let expected = format!("1 to {MAX_EDGE} pixels along each edge");
        return Err(InputError::wrong(file, "size", format!("{width} x {height}"), expected));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use npyz::WriterBuilder;

    fn npy<T: npyz::Serialize + npyz::AutoSerialize>(shape: &[u64], values: Vec<T>) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
        writer.extend(values).unwrap();
        writer.finish().unwrap();
        bytes
    }

    #[test]
    fn npy_of_integers_and_of_metres() {
        let raw = RawDepth::from_npy("d.npy", &npy(&[2, 3], vec![0u16, 1, 2, 3, 4, 500])).unwrap();
        assert_eq!((raw.width, raw.height), (3, 2));
        assert!((raw.in_metres(0.001).depth_m[5] - 0.5).abs() < 1e-6);
        let raw = RawDepth::from_npy("d.npy", &npy(&[1, 2], vec![0.25f64, 1.5])).unwrap();
        assert_eq!(raw.in_metres(0.001).depth_m, vec![0.25, 1.5]);
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        let message = |bytes: &[u8]| RawDepth::from_npy("d.npy", bytes).unwrap_err().to_string();
        assert_eq!(
            message(&npy(&[4], vec![1u16, 2, 3, 4])),
            "d.npy: shape: found [4], expected (height, width)"
        );
        assert!(message(&npy(&[1, 2], vec![1i32, 2])).contains("expected uint16, float32 or float64"));
        let png = RawDepth::from_png("c.png", b"\x89PNG").unwrap_err().to_string();
        assert!(png.starts_with("c.png: PNG data: found"), "{png}");
    }

    #[test]
    fn every_value_of_a_png_is_kept() {
        let values: Vec<u16> = (0..=u16::MAX).collect();
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 256, 256);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let data: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
        assert_eq!(RawDepth::from_png("d.png", &bytes).unwrap().as_u16(), Some(values.as_slice()));
    }

    #[test]
    fn a_colour_png_is_refused_with_its_type() {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 1, 1);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(&[1, 2, 3]).unwrap();
        let message = RawDepth::from_png("c.png", &bytes).unwrap_err().to_string();
        assert_eq!(
            message,
            "c.png: PNG data: found a PNG file of 8-bit Rgb, expected a PNG file of 16-bit grayscale"
        );
    }
}
