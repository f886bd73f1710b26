//! The observed volume: what depth frames say about each voxel.
//!
//! One structure keeps what both encodings of the paper (Supplementary Note 2: TSDF and Voxel) and the collision
//! geometry need: [`integrate`](Volume::integrate) fuses frames, [`network_input`](Volume::network_input) encodes,
//! [`solid`](Volume::solid) says what a hand must not enter, [`surface`](Volume::surface) where exactly that ends.

mod encode;
mod integrate;
mod moving;
mod solid;
mod surface;

pub use solid::{MIN_OBJECT_VOXELS, PIT_VOXELS};
pub use surface::{SurfaceVoxel, View};

use crate::grid::Grid;
use crate::options::{Region, VolumeKind};

/// Truncation of the signed distance, voxels (the reference implementation's dataset uses 8).
pub const TRUNCATION_VOXELS: f64 = 8.0;

/// How far behind a seen surface a voxel still counts as that surface, voxels along the ray.
pub const SURFACE_BAND_VOXELS: f64 = 2.0;

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
///
/// A voxel's state follows from its fused signed distance at the centre: in front of the surface it is free, up
/// to [`SURFACE_BAND_VOXELS`] behind it is surface, further behind nothing is known.
#[derive(Debug, Clone)]
pub struct Volume {
    /// The grid, in the volume frame.
    pub grid: Grid,
    /// Which of the paper's two kinds of volume this is read as; decides what is [`solid`](Volume::solid).
    pub kind: VolumeKind,
    /// What is known of each voxel, memory order.
    pub state: Vec<VoxelState>,
    /// Height of the table top, metres along z.
    pub table_m: Option<f64>,
    /// Mean signed distance along the viewing rays over [`TRUNCATION_VOXELS`]: 1 far in front of the surface, 0
    /// on it, -1 at the truncation behind it. Only where `weight` is not zero.
    pub tsdf: Vec<f32>,
    /// Number of frames that told something about each voxel.
    pub weight: Vec<u16>,
    /// Where things may be grasped, volume frame: what stands outside is no object. `None`: everywhere.
    pub region: Option<Region>,
    /// Object label of each surface voxel (0 none) by majority over the frames; `None` while no frame had labels.
    pub labels: Option<Labels>,
}

/// Object labels of voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    /// Label of each voxel, memory order; 0 none.
    pub label: Vec<u8>,
    /// Votes by which the label leads.
    votes: Vec<u8>,
}

impl Volume {
    /// A volume in which nothing was seen yet.
    pub fn empty(grid: Grid, table_m: Option<f64>) -> Self {
        let n = grid.len();
        Self {
            grid,
            kind: VolumeKind::default(),
            state: vec![VoxelState::Unseen; n],
            table_m,
            tsdf: vec![0.0; n],
            weight: vec![0; n],
            region: None,
            labels: None,
        }
    }

    /// A volume of which only the solid voxels are known, all others taken as seen to be free. Missing entries
    /// of `solid` count as not solid.
    pub fn from_solid(grid: Grid, table_m: Option<f64>, solid: &[bool]) -> Self {
        let mut volume = Self::empty(grid, table_m);
        for (i, state) in volume.state.iter_mut().enumerate() {
            let is_solid = solid.get(i).copied().unwrap_or(false);
            *state = if is_solid { VoxelState::Surface } else { VoxelState::Free };
            volume.tsdf[i] = if is_solid { 0.0 } else { 1.0 };
            volume.weight[i] = 1;
        }
        volume
    }

    /// Labels of voxels, memory order, where frames had labels.
    pub fn voxel_labels(&self) -> Option<&[u8]> {
        self.labels.as_ref().map(|l| l.label.as_slice())
    }

    /// Number of voxels in a state.
    pub fn count(&self, state: VoxelState) -> usize {
        self.state.iter().filter(|&&s| s == state).count()
    }
}

#[cfg(test)]
mod tests;
