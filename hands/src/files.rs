//! The contents of a hand's folder, as bytes that somebody else has read.

use std::collections::BTreeMap;

/// The files of a hand by their path relative to the hand's folder: `hand.urdf`, `hand.toml`, meshes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HandFiles {
    /// Path (with `/`) → contents.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl HandFiles {
    /// The two files that every hand has.
    pub fn new(urdf: impl Into<Vec<u8>>, toml: impl Into<Vec<u8>>) -> Self {
        let mut files = BTreeMap::new();
        files.insert(URDF.to_owned(), urdf.into());
        files.insert(TOML.to_owned(), toml.into());
        Self { files }
    }

    /// A hash of all paths and contents (FNV-1a, 64 bits, hexadecimal): equal files, equal revision.
    pub fn revision(&self) -> String {
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        let mut eat = |bytes: &[u8]| {
            // The length first: moving bytes from one field to the next must change the hash.
            for byte in (bytes.len() as u64).to_le_bytes().iter().chain(bytes) {
                hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        };
        for (path, contents) in &self.files {
            eat(path.as_bytes());
            eat(contents);
        }
        format!("{hash:016x}")
    }
}

/// Kinematics and shapes.
pub(crate) const URDF: &str = "hand.urdf";
/// What a URDF does not say: pads, actuators, approach.
pub(crate) const TOML: &str = "hand.toml";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn revision_changes_with_contents_and_paths_only() {
        let a = HandFiles::new("urdf", "toml");
        assert_eq!(a.revision(), a.clone().revision());
        assert_eq!(a.revision().len(), 16);
        assert_ne!(a.revision(), HandFiles::new("urd", "ftoml").revision());
        let mut b = a.clone();
        b.files.insert("meshes/tip.stl".into(), Vec::new());
        assert_ne!(a.revision(), b.revision());
    }
}
