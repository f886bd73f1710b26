//! Files that people hand over: depth images, intrinsics, label images, contact fields.
//!
//! Every error names the file, the key or array in it, what was found and what was expected.

pub(crate) mod depth;
pub(crate) mod intrinsics;
pub(crate) mod labels;
pub(crate) mod npz;

use std::path::Path;

/// What is wrong with an input file.
#[derive(Debug, thiserror::Error)]
pub(crate) enum InputError {
    /// The file cannot be read at all.
    #[error("{file}: cannot be read")]
    Unreadable {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// Something in the file is not what it has to be.
    #[error("{file}: {key}: found {found}, expected {expected}")]
    Wrong {
        /// The file.
        file: String,
        /// Key, array or property.
        key: String,
        /// What is there.
        found: String,
        /// What has to be there.
        expected: String,
    },
}

impl InputError {
    /// A [`InputError::Wrong`].
    pub(crate) fn wrong(file: &str, key: &str, found: impl ToString, expected: impl ToString) -> Self {
        Self::Wrong {
            file: file.into(),
            key: key.into(),
            found: found.to_string(),
            expected: expected.to_string(),
        }
    }
}

/// Largest input file, bytes: larger ones are refused before they fill the memory.
const MAX_FILE_BYTES: u64 = 256 * 1024 * 1024;

/// The contents of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, InputError> {
    let file = path.display().to_string();
    let unreadable = |source| InputError::Unreadable { file: file.clone(), source };
    let length = std::fs::metadata(path).map_err(unreadable)?.len();
    if length > MAX_FILE_BYTES {
        return Err(InputError::wrong(
            &file,
            "size",
            format!("{length} bytes"),
            format!("at most {MAX_FILE_BYTES}"),
        ));
    }
    std::fs::read(path).map_err(unreadable)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Valid files with some bytes changed and cut off somewhere: nearly right is where parsers break.
    fn damaged(valid: Vec<u8>) -> impl Strategy<Value = Vec<u8>> {
        let length = valid.len();
        (prop::collection::vec((0..length, any::<u8>()), 0..12), 0..=length).prop_map(
            move |(changes, end)| {
                let mut bytes = valid.clone();
                for (at, value) in changes {
                    bytes[at] = value;
                }
                bytes.truncate(end.max(length / 2));
                bytes
            },
        )
    }

    fn small_png() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 4, 3);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.write_header().unwrap().write_image_data(&[7; 24]).unwrap();
        bytes
    }

    fn small_npy() -> Vec<u8> {
        use npyz::WriterBuilder as _;
        let mut bytes = Vec::new();
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(&[3, 4]).writer(&mut bytes).begin_nd().unwrap();
        writer.extend((0..12u16).collect::<Vec<u16>>()).unwrap();
        writer.finish().unwrap();
        bytes
    }

    proptest! {
        #[test]
        fn damaged_images_are_errors_or_images(png in damaged(small_png()), npy in damaged(small_npy())) {
            let read = [depth::RawDepth::from_png("d", &png), depth::RawDepth::from_npy("d", &npy)];
            for raw in read.into_iter().flatten() {
                prop_assert_eq!(raw.in_metres(0.001).depth_m.len(), raw.width * raw.height);
            }
        }

        #[test]
        fn damaged_intrinsics_are_errors_or_intrinsics(bytes in damaged(crate::demo_scene::FRAME_JSON.to_vec())) {
            if let Ok(file) = intrinsics::FrameFile::parse("f", &bytes) {
                prop_assert!(file.intrinsics.fx_px > 0.0 && file.depth_scale > 0.0);
            }
        }

        #[test]
        fn damaged_contact_fields_do_not_panic(bytes in damaged(npz::tests::small_archive())) {
            if let Ok(loaded) = npz::parse("f", &bytes) {
                prop_assert!(loaded.field.certainty.iter().all(|c| (0.0..=1.0).contains(c)));
                prop_assert_eq!(loaded.solid.len(), loaded.field.grid.len());
            }
        }
    }
}
