//! Scenes as the paper sets them up: single objects, packed upright, poured into a tray.

use std::sync::Arc;

use crate::object::Object;
use crate::world::{World, WorldSettings};

/// How objects are put into the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrangement {
    /// Upright, side by side, without touching.
    Packed,
    /// Poured: dropped from above one after the other, and settled.
    Pile,
}

/// Puts objects into a new world and lets them come to rest. Objects that end outside the tray (or off the
/// table's middle) are put back in from above. Deterministic by seed.
pub fn arrange(settings: &WorldSettings, objects: &[Arc<Object>], how: Arrangement, seed: u64) -> World {
    unimplemented!("{settings:?} {objects:?} {how:?} {seed}")
}

/// `count` objects of all families, drawn by seed.
pub fn assortment(count: usize, seed: u64) -> Vec<Arc<Object>> {
    unimplemented!("{count} {seed}")
}

/// Steps until everything is at rest, at most `limit_s` simulated seconds; `true` when it is.
pub fn settle(world: &mut World, limit_s: f64) -> bool {
    unimplemented!("{world:?} {limit_s}")
}
