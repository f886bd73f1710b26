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
