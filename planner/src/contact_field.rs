//! The contact field: for every voxel, how certain a contact there is, its direction, and whether the
//! voxel is a contact centroid. The paper's `{P_c, Φ_c, P_e}`; made by an estimator, or loaded.

use crate::grid::Grid;

/// A contact field on a grid; every array has one entry per voxel in the grid's memory order.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactField {
    /// The grid, in the volume frame.
    pub grid: Grid,
    /// `P_c`: certainty of a contact, 0 to 1.
    pub certainty: Vec<f32>,
    /// `z(Φ_c)`: unit vector from the finger into the object, volume frame; zeros where there is none.
    ///
    /// The paper's `Φ_c` is a full orientation; its objectives use only the image of +z, so that is what is
    /// kept. A quaternion field is reduced when it is loaded.
    pub inward: Vec<[f32; 3]>,
    /// `P_e`: likelihood of a contact centroid, 0 to 1.
    pub centroid: Vec<f32>,
}
