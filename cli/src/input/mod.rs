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
