//! The labels themselves as an estimator: what a network that had learnt all of them would give.
//!
//! It knows the exact scene, so it is a yardstick and nothing to plan with: how good grasps become with these labels bounds
//! what learning them can reach.

use graspd_planner::budget::{Budget, Stop};
use graspd_planner::contact_field::ContactField;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::options::VolumeKind;
use graspd_planner::volume::Volume;
use nalgebra::Isometry3;

use super::contacts::SceneContacts;
use super::voxels::voxelize;

/// Knows a scene's contacts, and where the volume stands.
#[derive(Debug, Clone, Copy)]
pub struct Oracle<'a> {
    /// The scene's contacts, world frame.
    pub contacts: &'a SceneContacts,
    /// Pose of the volumes that it is shown.
    pub world_from_volume: Isometry3<f64>,
}

impl ContactEstimator for Oracle<'_> {
    fn name(&self) -> &str {
        "labels"
    }

    fn estimate(&self, volume: &Volume, _budget: &dyn Budget) -> Result<ContactField, Stop> {
        let seen = volume.network_input(volume.kind);
        let is_occupied = |i: usize| match volume.kind {
            VolumeKind::Tsdf => seen[i] > 0.001 && seen[i] <= 0.5,
            VolumeKind::Occupancy => seen[i] > 0.5,
        };
        let labels = voxelize(self.contacts, &volume.grid, &self.world_from_volume, is_occupied);
        let mut field = ContactField::empty(volume.grid);
        for contact in &labels.contacts {
            let index = contact.index as usize;
            field.certainty[index] = contact.score();
            field.inward[index] = contact.inward().cast::<f32>().into();
        }
        for centroid in &labels.centroids {
            field.centroid[centroid.index as usize] = centroid.score();
        }
        Ok(field)
    }
}
