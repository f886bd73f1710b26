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
}
