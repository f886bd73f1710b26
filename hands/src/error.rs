//! What can be wrong with a hand's files.

/// Why a hand's files do not make a hand.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum HandError {
    /// A file that must be there is not.
    #[error("{file}: missing; a hand needs hand.urdf and hand.toml")]
    MissingFile {
        /// Path in the hand's folder.
        file: String,
    },
}
