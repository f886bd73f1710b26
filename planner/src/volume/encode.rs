//! The two encodings that contact estimation networks take (Supplementary Note 2).

use super::{TRUNCATION_VOXELS, Volume, VoxelState};
use crate::options::VolumeKind;

/// Distances closer than this to the truncation count as beyond it, as a share of the truncation.
const CUT: f32 = 0.98;

/// A voxel must lie this far in front of a surface, voxels along the ray, to be carved from the occupancy grid:
/// about what it takes for all its corners to be in front.
const CARVE_VOXELS: f32 = 0.7;

impl Volume {
    /// The volume as a network reads it, one value per voxel in memory order.
    ///
    /// [`VolumeKind::Tsdf`]: the truncated signed distance mapped from -1..1 to 0..1 (0.5 on the surface, below
    /// inside), and 0 where nothing was seen or the surface is further than the truncation.
    /// [`VolumeKind::Occupancy`] (the paper's Voxel): 1 unless seen to be free, so the unseen is occupied.
    pub fn network_input(&self, kind: VolumeKind) -> Vec<f32> {
        let values = self.tsdf.iter().zip(&self.weight);
        match kind {
            VolumeKind::Tsdf => values
                .map(|(&d, &w)| if w > 0 && (-CUT..CUT).contains(&d) { (d + 1.0) * 0.5 } else { 0.0 })
                .collect(),
            VolumeKind::Occupancy => {
                let free = CARVE_VOXELS / TRUNCATION_VOXELS as f32;
                values.map(|(&d, &w)| if w > 0 && d > free { 0.0 } else { 1.0 }).collect()
            }
        }
    }

    /// Voxels of which nothing is known, memory order.
    pub fn unknown(&self) -> Vec<bool> {
        self.state.iter().map(|&s| s == VoxelState::Unseen).collect()
    }
}
