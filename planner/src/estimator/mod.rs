//! Contact estimation: from an observed volume to a contact field, behind one trait.

mod centroids;
mod chords;
mod geometric;
mod learned;
mod smoothing;

pub use geometric::Geometric;
pub use learned::Learned;

use crate::budget::{Budget, Stop};
use crate::contact_field::ContactField;
use crate::volume::Volume;

/// Makes a contact field of a volume: the geometric rule, or a network.
pub trait ContactEstimator: Send + Sync {
    /// Short name for requests and tables, for example `geometric`.
    fn name(&self) -> &str;

    /// The contact field of `volume`, on the same grid.
    ///
    /// # Errors
    /// [`Stop`] when the budget ended first.
    fn estimate(&self, volume: &Volume, budget: &dyn Budget) -> Result<ContactField, Stop>;

    /// The same where somebody knows already what is solid in the volume ([`Volume::solid`]) and which object each voxel
    /// belongs to ([`Volume::object_groups`]). For those who want neither, as this default.
    ///
    /// # Errors
    /// [`Stop`] when the budget ended first.
    fn estimate_known(
        &self,
        volume: &Volume,
        solid: &[bool],
        groups: &[u16],
        budget: &dyn Budget,
    ) -> Result<ContactField, Stop> {
        let _ = (solid, groups);
        self.estimate(volume, budget)
    }
}
