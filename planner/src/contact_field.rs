//! The contact field: for every voxel, how certain a contact there is, its direction, and whether the
//! voxel is a contact centroid. The paper's `{P_c, Φ_c, P_e}`; made by an estimator, or loaded.

use crate::grid::Grid;
use crate::options::Region;

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

/// What is wrong with a contact field that was made elsewhere.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContactFieldError {
    /// An array has not one entry per voxel.
    #[error("contact_field.{field}: found {found} entries, expected one per voxel = {expected}")]
    Size {
        /// Name of the array.
        field: &'static str,
        /// Found entries.
        found: usize,
        /// Expected entries.
        expected: usize,
    },
}

impl ContactField {
    /// A field without contacts and centroids.
    pub fn empty(grid: Grid) -> Self {
        let n = grid.len();
        Self { grid, certainty: vec![0.0; n], inward: vec![[0.0; 3]; n], centroid: vec![0.0; n] }
    }

    /// Forgets every contact and centroid outside a region, which stands in the volume frame.
    pub fn keep_only(&mut self, region: &Region) {
        for i in 0..self.grid.len() {
            let told = |values: &[f32]| values.get(i).is_some_and(|v| *v != 0.0);
            if (told(&self.certainty) || told(&self.centroid))
                && !region.contains(&self.grid.center(self.grid.voxel(i)))
            {
                for values in [&mut self.certainty, &mut self.centroid] {
                    if let Some(value) = values.get_mut(i) {
                        *value = 0.0;
                    }
                }
            }
        }
    }

    /// Checks the sizes of the arrays. Values are not checked: what is not finite counts as 0 in refinement.
    ///
    /// # Errors
    /// [`ContactFieldError`] with the array, what was found and what was expected.
    pub fn validate(&self) -> Result<(), ContactFieldError> {
        let expected = self.grid.len();
        let sizes = [
            ("certainty", self.certainty.len()),
            ("inward", self.inward.len()),
            ("centroid", self.centroid.len()),
        ];
        match sizes.into_iter().find(|&(_, found)| found != expected) {
            Some((field, found)) => Err(ContactFieldError::Size { field, found, expected }),
            None => Ok(()),
        }
    }
}
