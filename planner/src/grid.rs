//! The cube of voxels that volumes and fields share: its size, its indexing, its frame.

use nalgebra::Point3;

/// A cubic voxel grid in the volume frame. Voxel (i, j, k) covers `[i, i+1) × [j, j+1) × [k, k+1)`
/// voxel edges from the corner at the origin; values belong to voxel centres. Memory order is x, y, z with
/// z fastest, as in the paper's arrays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Voxels along each edge (the paper: 80).
    pub resolution: usize,
    /// Edge length of the cube, metres (the paper: 0.4).
    pub size_m: f64,
}

impl Default for Grid {
    fn default() -> Self {
        Self { resolution: 80, size_m: 0.4 }
    }
}

impl Grid {
    /// Edge length of a voxel, metres.
    pub fn voxel_m(&self) -> f64 {
        self.size_m / self.resolution as f64
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.resolution.pow(3)
    }

    /// True for a grid without voxels.
    pub fn is_empty(&self) -> bool {
        self.resolution == 0
    }

    /// Position of voxel (x, y, z) in memory.
    pub fn index(&self, x: usize, y: usize, z: usize) -> usize {
        (x * self.resolution + y) * self.resolution + z
    }

    /// The voxel at a memory position.
    pub fn voxel(&self, index: usize) -> [usize; 3] {
        let n = self.resolution;
        [index / (n * n), index / n % n, index % n]
    }

    /// Centre of a voxel in the volume frame, metres.
    pub fn center(&self, voxel: [usize; 3]) -> Point3<f64> {
        let v = self.voxel_m();
        Point3::new((voxel[0] as f64 + 0.5) * v, (voxel[1] as f64 + 0.5) * v, (voxel[2] as f64 + 0.5) * v)
    }
}

/// What is wrong with a grid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridError {
    /// Too few or too many voxels.
    #[error(
        "grid.resolution: found {found}, expected {MIN_RESOLUTION} to {MAX_RESOLUTION} voxels along each edge"
    )]
    Resolution {
        /// Found voxels along an edge.
        found: usize,
    },
    /// No size for a workspace.
    #[error("grid.size_m: found {found}, expected {MIN_SIZE_M} to {MAX_SIZE_M} metres")]
    Size {
        /// Found edge length, metres.
        found: f64,
    },
}

/// Smallest accepted resolution.
pub const MIN_RESOLUTION: usize = 8;
/// Largest accepted resolution: four million voxels, a fifth of a gigabyte of fields.
pub const MAX_RESOLUTION: usize = 160;
/// Smallest accepted edge length, metres.
pub const MIN_SIZE_M: f64 = 0.01;
/// Largest accepted edge length, metres.
pub const MAX_SIZE_M: f64 = 10.0;

impl Grid {
    /// Checks resolution and size.
    ///
    /// # Errors
    /// [`GridError`] with the field, what was found and what was expected.
    pub fn validate(&self) -> Result<(), GridError> {
        if !(MIN_RESOLUTION..=MAX_RESOLUTION).contains(&self.resolution) {
            return Err(GridError::Resolution { found: self.resolution });
        }
        if !(MIN_SIZE_M..=MAX_SIZE_M).contains(&self.size_m) {
            return Err(GridError::Size { found: self.size_m });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_and_voxel_are_inverse_and_limits_hold() {
        let grid = Grid { resolution: 9, size_m: 0.09 };
        for i in 0..grid.len() {
            let [x, y, z] = grid.voxel(i);
            assert_eq!(grid.index(x, y, z), i);
        }
        assert_eq!(Grid::default().validate(), Ok(()));
        assert_eq!(Grid { resolution: 0, size_m: 0.4 }.validate(), Err(GridError::Resolution { found: 0 }));
        assert_eq!(Grid { resolution: 80, size_m: -1.0 }.validate(), Err(GridError::Size { found: -1.0 }));
        assert!(Grid { resolution: 80, size_m: f64::NAN }.validate().is_err());
    }
}
