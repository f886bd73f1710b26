//! Contacts of a scene on the voxels of one view: counted, averaged and scored.
//!
//! Per voxel, as in the reference implementation: the number n of contacts, their mean score, the mean orientation of the
//! grasps, and the mean side, −1 or +1 for the finger that touches. A contact's score is mean score × tanh(n) × |mean
//! side|: a voxel that is touched from both sides counts for nothing. Its orientation is the mean, turned by half a turn
//! about the approach where the mean side is negative.
//!
//! A parallel jaw has no left finger: turned by half a turn it is the same. So sides are told apart in each voxel by
//! the main axis of the inward directions in it; the result does not depend on which finger was called left.

use graspd_planner::grid::Grid;
use nalgebra::{Isometry3, UnitQuaternion, Vector3, convert};

use super::average::{mean_axis, mean_orientation};
use super::contacts::SceneContacts;
use super::sample::{CentroidLabel, ContactLabel};

/// Labels of one view, both by ascending memory index.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Contacts.
    pub contacts: Vec<ContactLabel>,
    /// Centroids.
    pub centroids: Vec<CentroidLabel>,
}

/// What several contacts make of a voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Averaged {
    /// mean × tanh(n) × |mean side|.
    pub score: f64,
    /// z into the object, x along the mean approach.
    pub orientation: UnitQuaternion<f64>,
}

/// Labels of a volume at this pose. No contact is left where `is_occupied` says so of a memory index.
pub fn voxelize(
    scene: &SceneContacts,
    grid: &Grid,
    world_from_volume: &Isometry3<f64>,
    is_occupied: impl Fn(usize) -> bool,
) -> Labels {
    let volume_from_world = world_from_volume.inverse();
    let here: Isometry3<f32> = convert(volume_from_world);
    let per_metre = (1.0 / grid.voxel_m()) as f32;
    let n = grid.resolution;
    let index = |p: &nalgebra::Point3<f32>| {
        let p = (here * p).coords * per_metre;
        let inside = p.iter().all(|&c| c >= 0.0 && c < n as f32);
        inside.then(|| grid.index(p.x as usize, p.y as usize, p.z as usize) as u32)
    };

    let mut touched = sorted(scene.contacts.iter().map(|c| index(&c.point)));
    touched.retain(|&(voxel, _)| !is_occupied(voxel as usize));
    let mut contacts = Vec::new();
    let mut group: Vec<(UnitQuaternion<f64>, f64)> = Vec::new();
    for same in touched.chunk_by(|a, b| a.0 == b.0) {
        group.clear();
        group.extend(same.iter().map(|&(_, i)| {
            let c = &scene.contacts[i as usize];
            (convert(c.orientation), f64::from(c.score))
        }));
        if let Some(mean) = average(&group) {
            let orientation = volume_from_world.rotation * mean.orientation;
            contacts.extend(ContactLabel::new(same[0].0, mean.score, &orientation));
        }
    }

    let middles = sorted(scene.centroids.iter().map(|c| index(&c.point)));
    let mut centroids = Vec::new();
    for same in middles.chunk_by(|a, b| a.0 == b.0) {
        let count = same.len() as f64;
        let sum: f64 = same.iter().map(|&(_, i)| f64::from(scene.centroids[i as usize].score)).sum();
        centroids.extend(CentroidLabel::new(same[0].0, sum / count * count.tanh()));
    }
    Labels { contacts, centroids }
}

/// Voxel and number of everything that lies in one, by voxel.
fn sorted(voxels: impl Iterator<Item = Option<u32>>) -> Vec<(u32, u32)> {
    let mut all: Vec<(u32, u32)> =
        voxels.enumerate().filter_map(|(i, voxel)| Some((voxel?, i as u32))).collect();
    all.sort_unstable();
    all
}

/// Contacts in one voxel, orientation and score each; `None` where they cancel out.
pub fn average(group: &[(UnitQuaternion<f64>, f64)]) -> Option<Averaged> {
    let inward: Vec<Vector3<f64>> = group.iter().map(|(q, _)| q * Vector3::z()).collect();
    let axis = mean_axis(&inward)?;
    let count = group.len() as f64;
    let sides: Vec<f64> = inward.iter().map(|z| if z.dot(&axis) < 0.0 { -1.0 } else { 1.0 }).collect();
    let side = sides.iter().sum::<f64>() / count;
    // Orientations as the one side has them.
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turned: Vec<_> =
        group.iter().zip(&sides).map(|((q, _), &s)| if s < 0.0 { q * half_turn } else { *q }).collect();
    let mean = mean_orientation(turned.iter().zip(group.iter().map(|(_, score)| *score)))?;
    let score = group.iter().map(|(_, score)| score).sum::<f64>() / count * count.tanh() * side.abs();
    let orientation = if side < 0.0 { mean * half_turn } else { mean };
    (score > 0.0).then_some(Averaged { score, orientation })
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::super::contacts::{Centroid, Contact};
    use super::*;

    fn towards(direction: Vector3<f64>) -> UnitQuaternion<f64> {
        UnitQuaternion::rotation_between(&Vector3::z(), &direction).unwrap_or_default()
    }

    #[test]
    fn one_side_keeps_its_direction_and_more_contacts_count_more() {
        let q = towards(Vector3::y());
        let one = average(&[(q, 0.9)]).unwrap();
        assert!((one.score - 0.9 * 1f64.tanh()).abs() < 1e-12);
        let three = average(&[(q, 0.9), (q, 0.8), (q, 1.0)]).unwrap();
        assert!((three.score - 0.9 * 3f64.tanh()).abs() < 1e-12);
        assert!((three.orientation * Vector3::z() - Vector3::y()).norm() < 1e-9);
    }

    #[test]
    fn both_sides_cancel_and_the_majority_wins() {
        let (left, right) = (towards(Vector3::y()), towards(-Vector3::y()));
        assert_eq!(average(&[(left, 0.9), (right, 0.9)]), None);
        for (major, minor) in [(left, right), (right, left)] {
            let mean = average(&[(major, 0.9), (minor, 0.9), (major, 0.9)]).unwrap();
            assert!((mean.score - 0.9 * 3f64.tanh() / 3.0).abs() < 1e-9);
            assert!((mean.orientation * Vector3::z() - major * Vector3::z()).norm() < 1e-9);
        }
        assert_eq!(average(&[]), None);
    }

    #[test]
    fn labels_turn_with_the_volume_and_leave_occupied_voxels_out() {
        let grid = Grid::default();
        let at = |x: f32| Point3::new(x, 0.0, 0.02);
        let contact = |x| Contact { point: at(x), orientation: convert(towards(Vector3::y())), score: 0.9 };
        let scene = SceneContacts {
            contacts: vec![contact(0.0012), contact(0.05), contact(9.0), contact(0.0013)],
            centroids: vec![Centroid { point: at(0.0012), score: 0.8 }],
            ..SceneContacts::default()
        };
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let corner = nalgebra::Translation3::new(0.2, -0.2, -0.1);
        let pose = Isometry3::from_parts(corner, yaw);
        let labels = voxelize(&scene, &grid, &pose, |_| false);
        assert_eq!(labels.contacts.len(), 2);
        assert_eq!(labels.centroids.len(), 1);
        for label in &labels.contacts {
            // The world's y is the volume's x.
            assert!((label.inward() - Vector3::x()).norm() < 1e-3, "{label:?}");
        }
        let centroid = labels.centroids[0].index as usize;
        let middle = pose * grid.center(grid.voxel(centroid));
        assert!((middle - convert::<_, Point3<f64>>(at(0.0012))).norm() < 0.005);
        assert!((f64::from(labels.centroids[0].score()) - 0.8 * 1f64.tanh()).abs() < 0.003);
        let free = voxelize(&scene, &grid, &pose, |i| i == centroid);
        assert_eq!(free.contacts.len(), 1);
        assert_eq!(free.centroids, labels.centroids);
    }
}
