//! Where hands come from: the one place that asks the hand library.

use std::sync::Arc;

use graspd_hands::{Hand, HandError, HandFiles, library, propose};

const URDF: &str = "hand.urdf";
const TOML: &str = "hand.toml";

/// A hand that was read from files.
#[derive(Debug)]
pub(crate) struct Loaded {
    /// The hand.
    pub(crate) hand: Hand,
    /// The description that was written because the files had none.
    pub(crate) proposed_toml: Option<String>,
    /// Its files, that description among them.
    pub(crate) files: HandFiles,
}

/// Every hand that is compiled in.
pub(super) fn library() -> impl Iterator<Item = Arc<Hand>> {
    library::ids().iter().filter_map(|id| library::hand(id)).map(|hand| Arc::new(hand.clone()))
}

/// Reads a hand; a missing `hand.toml` is proposed. Takes milliseconds: not for a thread of the runtime.
pub(crate) fn load_files(id: &str, mut files: HandFiles) -> Result<Loaded, HandError> {
    let mut proposed_toml = None;
    if let (Some(urdf), false) = (files.files.get(URDF), files.files.contains_key(TOML)) {
        // Bytes that are not UTF-8 reach the reader as replacement characters, which it refuses by place.
        let toml = propose(&String::from_utf8_lossy(urdf), &files)?;
        files.files.insert(TOML.to_owned(), toml.clone().into_bytes());
        proposed_toml = Some(toml);
    }
    Ok(Loaded { hand: Hand::load(id, &files)?, proposed_toml, files })
}
