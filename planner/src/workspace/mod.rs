//! Where the volume stands in the world: given by the caller, or placed on the table that the frame shows.

use nalgebra::Isometry3;

use crate::grid::Grid;

/// A placed volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workspace {
    /// Takes volume coordinates to world coordinates.
    pub world_from_volume: Isometry3<f64>,
    /// The voxel grid.
    pub grid: Grid,
    /// Height of the table top in the volume, metres along z; `None` when there is no table.
    pub table_m: Option<f64>,
}
