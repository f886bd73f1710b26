//! Refinement: from a contact field to focal contacts, centred centroids and the fields that the optimizer reads.

mod cells;

pub use cells::{CHANNELS, Cell, FieldCells, Sample};

use nalgebra::Point3;

use crate::grid::Grid;

/// A centred centroid `s_ee`: where the middle of a grasp's contacts should come to lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CenteredCentroid {
    /// Mean of the cluster's voxel centres, volume frame, metres.
    pub position: Point3<f64>,
    /// Share of this cluster in all clustered voxels; the weights of all centroids sum to 1.
    pub weight: f64,
    /// Voxels in the cluster.
    pub voxel_count: usize,
    /// Label of the object that it lies in, where the frames had labels.
    pub label: Option<u8>,
}

/// What is left of a contact field after refinement, ready for any number of hands.
#[derive(Debug, Clone)]
pub struct Features {
    /// The grid, in the volume frame.
    pub grid: Grid,
    /// Focal contacts `S_fc`: memory indices of voxels whose certainty exceeds `T_fc` of the maximum.
    pub focal_contacts: Vec<u32>,
    /// Number of focal centroids, `N_fe`.
    pub focal_centroid_count: usize,
    /// Centred centroids `S_ee`, heaviest first.
    pub centroids: Vec<CenteredCentroid>,
    /// The fields that the objectives look up.
    pub cells: FieldCells,
    /// Signed distance to occupied space at voxel centres, metres, negative inside (own array: collision
    /// spheres read nothing else).
    pub scene_distance_m: Vec<f32>,
    /// Height of the table top in the volume, metres; solid below.
    pub table_m: Option<f64>,
}
