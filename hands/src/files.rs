//! The contents of a hand's folder, as bytes that somebody else has read.

use std::collections::BTreeMap;

/// The files of a hand by their path relative to the hand's folder: `hand.urdf`, `hand.toml`, meshes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HandFiles {
    /// Path (with `/`) → contents.
    pub files: BTreeMap<String, Vec<u8>>,
}
