//! The learned estimator: a network reads the volume and answers for every voxel (Supplementary Note 1).

use graspd_inference::{Network, Output, RunError, VolumeInput};
use rayon::prelude::*;

use super::ContactEstimator;
use super::centroids::{Peaks, extents, normalized};
use crate::budget::{Budget, Stop};
use crate::contact_field::ContactField;
use crate::grid::Grid;
use crate::options::VolumeKind;
use crate::volume::Volume;

/// The estimator: one network, or one for each kind of volume.
#[derive(Debug)]
pub struct Learned {
    first: Network,
    others: Vec<Network>,
}

impl Learned {
    /// The estimator of these networks. A volume is read by the first one that was trained on its kind; where there is
    /// none, `first` reads it in the encoding that it knows, which any volume has.
    pub fn new(first: Network, others: Vec<Network>) -> Self {
        Self { first, others }
    }

    /// The network that reads volumes of that kind.
    fn network(&self, kind: VolumeKind) -> &Network {
        let all = std::iter::once(&self.first).chain(&self.others);
        all.into_iter().find(|n| kind_of(n) == kind).unwrap_or(&self.first)
    }
}

/// The kind of volume that a network reads.
fn kind_of(network: &Network) -> VolumeKind {
    match network.info().volume {
        VolumeInput::Tsdf => VolumeKind::Tsdf,
        VolumeInput::Occupancy => VolumeKind::Occupancy,
    }
}

impl ContactEstimator for Learned {
    fn name(&self) -> &str {
        "learned"
    }

    /// On a grid of another resolution than the network's, the network sees, and answers for, the nearest voxels.
    fn estimate(&self, volume: &Volume, budget: &dyn Budget) -> Result<ContactField, Stop> {
        let network = self.network(volume.kind);
        let side = network.info().side;
        let input = resampled(&volume.network_input(kind_of(network)), volume.grid.resolution, side);
        let stop = || budget.stop();
        match network.run_while(&input, &|| stop().is_none()) {
            Ok(output) => {
                let mut field = field(volume.grid, &output, side);
                field.centroid = centroids(volume, &field.centroid);
                Ok(field)
            }
            Err(RunError::Stopped) => Err(stop().unwrap_or(Stop::Cancelled)),
            // The input was made for this network; were it not, nothing would be known of any contact.
            Err(_) => Ok(ContactField::empty(volume.grid)),
        }
    }
}

/// Centroid scores from the network's probabilities: the middle of an object of which it is less sure counts as much
/// as that of another.
fn centroids(volume: &Volume, probability: &[f32]) -> Vec<f32> {
    let groups = volume.object_groups(&volume.solid());
    normalized(&volume.grid, probability, &extents(&volume.grid, &groups), Peaks::PROBABILITIES)
}

/// Values of a grid of `from` voxels along an edge at the centres of one of `to` voxels, nearest voxel.
fn resampled(values: &[f32], from: usize, to: usize) -> Vec<f32> {
    if from == to {
        return values.to_vec();
    }
    let (source, target) = (cube(from), cube(to));
    (0..target.len()).map(|i| values[nearest(&target, &source, i)]).collect()
}

fn cube(resolution: usize) -> Grid {
    Grid { resolution, size_m: 1.0 }
}

/// The voxel of `to` in which the centre of voxel `index` of `from` lies, both covering the same cube.
fn nearest(from: &Grid, to: &Grid, index: usize) -> usize {
    let [x, y, z] = from.voxel(index).map(|v| (2 * v + 1) * to.resolution / (2 * from.resolution));
    to.index(x, y, z)
}

/// A network's answer as a contact field on a grid.
fn field(grid: Grid, output: &Output, side: usize) -> ContactField {
    let (ours, theirs) = (cube(grid.resolution), cube(side));
    let at = |i: usize| if grid.resolution == side { i } else { nearest(&ours, &theirs, i) };
    let each = |values: &[f32]| (0..grid.len()).map(|i| values[at(i)]).collect();
    ContactField {
        grid,
        certainty: each(&output.certainty),
        inward: (0..grid.len()).into_par_iter().map(|i| output.orientation.inward(at(i))).collect(),
        centroid: each(&output.centroid),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Unlimited;
    use std::time::Duration;

    /// A small network with random weights, 16 voxels along an edge.
    fn network(file: &[u8]) -> Network {
        Network::from_bytes(file).unwrap()
    }

    fn tsdf() -> Network {
        network(include_bytes!("../../../inference/tests/models/ours-tsdf-quaternion.onnx"))
    }

    fn occupancy() -> Network {
        network(include_bytes!("../../../inference/tests/models/ours-occupancy-r6d.onnx"))
    }

    /// A volume in which a lower half was seen to be solid.
    fn half_full(resolution: usize, kind: VolumeKind) -> Volume {
        let mut volume = Volume::empty(Grid { resolution, size_m: 0.4 }, None);
        volume.kind = kind;
        for i in 0..volume.grid.len() {
            let [.., z] = volume.grid.voxel(i);
            volume.weight[i] = 1;
            volume.tsdf[i] = ((z as f32 + 0.5) / resolution as f32 - 0.5).clamp(-1.0, 1.0);
        }
        volume
    }

    #[test]
    fn the_field_is_the_networks_answer_to_the_encoded_volume() {
        let estimator = Learned::new(tsdf(), vec![occupancy()]);
        for (kind, network) in [(VolumeKind::Tsdf, tsdf()), (VolumeKind::Occupancy, occupancy())] {
            let volume = half_full(16, kind);
            let field = estimator.estimate(&volume, &Unlimited).unwrap();
            let answer = network.run(&volume.network_input(kind)).unwrap();
            assert_eq!(field.certainty, answer.certainty);
            assert_eq!(field.centroid, centroids(&volume, &answer.centroid));
            for i in [0, 100, 4095] {
                assert_eq!(field.inward[i], answer.orientation.inward(i));
                let length = field.inward[i].iter().map(|c| c * c).sum::<f32>();
                assert!((length - 1.0).abs() < 1e-5);
            }
        }
        // With one network alone, every kind of volume is read in its encoding.
        let lone = Learned::new(occupancy(), Vec::new());
        let of = |kind| lone.estimate(&half_full(16, kind), &Unlimited).unwrap().certainty;
        assert_eq!(of(VolumeKind::Tsdf), of(VolumeKind::Occupancy));
    }

    #[test]
    fn other_resolutions_read_and_answer_nearest_voxels() {
        let estimator = Learned::new(tsdf(), Vec::new());
        let fine = half_full(32, VolumeKind::Tsdf);
        let field = estimator.estimate(&fine, &Unlimited).unwrap();
        assert_eq!(field.validate(), Ok(()));
        let at = |x, y, z| field.certainty[fine.grid.index(x, y, z)];
        assert_eq!(at(6, 8, 20), at(7, 9, 21));
        let (coarse, fine) = (cube(16), cube(32));
        assert_eq!(nearest(&fine, &coarse, fine.index(31, 1, 16)), coarse.index(15, 0, 8));
        assert_eq!(nearest(&coarse, &fine, coarse.index(15, 0, 8)), fine.index(31, 1, 17));
    }

    /// Over before it began.
    struct Over;

    impl Budget for Over {
        fn elapsed(&self) -> Duration {
            Duration::ZERO
        }

        fn stop(&self) -> Option<Stop> {
            Some(Stop::Cancelled)
        }
    }

    #[test]
    fn a_cancelled_estimate_stops() {
        let estimator = Learned::new(tsdf(), Vec::new());
        assert_eq!(estimator.estimate(&half_full(16, VolumeKind::Tsdf), &Over), Err(Stop::Cancelled));
    }
}
