//! The observed volume: what depth frames say about each voxel.

use crate::grid::Grid;

/// What is known of a voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum VoxelState {
    /// No frame has looked there.
    Unseen,
    /// Seen to be free.
    Free,
    /// At or just behind a seen surface.
    Surface,
}

/// One or several depth frames fused on a grid.
#[derive(Debug, Clone)]
pub struct Volume {
    /// The grid, in the volume frame.
    pub grid: Grid,
    /// What is known of each voxel, memory order.
    pub state: Vec<VoxelState>,
    /// Height of the table top, metres along z.
    pub table_m: Option<f64>,
}
