//! A scene in one JSON file: what the world is made of, which objects, where.

use crate::world::World;

/// Why a scene file cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// A field is not what it should be.
    #[error("{field}: found {found}, expected {expected}")]
    Field {
        /// Path of the field.
        field: String,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
}

/// The world's objects and poses as JSON.
pub fn to_json(world: &World) -> String {
    unimplemented!("{world:?}")
}

/// A world from JSON.
///
/// # Errors
/// [`SceneError`] with the field that is wrong.
pub fn from_json(text: &str) -> Result<World, SceneError> {
    unimplemented!("{text}")
}
