//! Contacts from exactly known objects instead of a picture: the baseline "simulated geometry" of Supplementary Note 6.
//!
//! Contacts lie around all surfaces within a distance, point along their normals and are the surer the nearer they are;
//! centroids are all that lies inside. No grasp properties, no scene: a gap too narrow for any finger has contacts too.

use std::sync::Arc;

use graspd_planner::budget::{Budget, Stop};
use graspd_planner::contact_field::ContactField;
use graspd_planner::estimator::ContactEstimator;
use graspd_planner::volume::Volume;
use graspd_sim::solid::{Nearest, Solid};
use graspd_sim::world::World;
use nalgebra::{Isometry3, Point3};

use super::run::GEOMETRY;

/// Contacts lie within this distance of a surface, in voxels.
const WITHIN_VOXELS: f64 = 1.5;

/// An object that really lies there.
#[derive(Debug)]
struct Lying {
    solid: Solid,
    object_from_world: Isometry3<f64>,
    /// Centre in the world and radius of a ball around it.
    ball: (Point3<f64>, f64),
}

/// The exact scene.
#[derive(Debug)]
pub(super) struct ExactScene {
    objects: Vec<Lying>,
}

impl ExactScene {
    pub(super) fn of(world: &World) -> Self {
        let objects = world.ids().into_iter().filter_map(|id| {
            let (object, world_from_object) = (Arc::clone(world.object(id)?), world.pose(id)?);
            let (low, high) = object.mesh.bounds()?;
            let ball = (world_from_object * nalgebra::center(&low, &high), 0.5 * (high - low).norm());
            let solid = Solid::new(&object.mesh)?;
            Some(Lying { solid, object_from_world: world_from_object.inverse(), ball })
        });
        Self { objects: objects.collect() }
    }

    /// The nearest surface no farther than `within_m`, normal in the world frame; negative distances are inside.
    pub(super) fn nearest(&self, point: &Point3<f64>, within_m: f64) -> Option<Nearest> {
        let near = self.objects.iter().filter(|o| (point - o.ball.0).norm() <= o.ball.1 + within_m);
        let seen = near.map(|o| {
            let seen = o.solid.nearest(&(o.object_from_world * point));
            Nearest { normal: o.object_from_world.rotation.inverse() * seen.normal, ..seen }
        });
        seen.filter(|s| s.distance_m <= within_m).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }
}

/// The estimator that knows the exact scene.
#[derive(Debug)]
pub struct SimulatedGeometry {
    scene: ExactScene,
    world_from_volume: Isometry3<f64>,
}

impl SimulatedGeometry {
    /// Knows what lies in a world now, for volumes that stand at `world_from_volume`.
    pub fn new(world: &World, world_from_volume: Isometry3<f64>) -> Self {
        Self { scene: ExactScene::of(world), world_from_volume }
    }

    /// The scene that it knows.
    pub(super) fn scene(&self) -> &ExactScene {
        &self.scene
    }
}

impl ContactEstimator for SimulatedGeometry {
    fn name(&self) -> &str {
        GEOMETRY
    }

    fn estimate(&self, volume: &Volume, _budget: &dyn Budget) -> Result<ContactField, Stop> {
        let grid = volume.grid;
        let within_m = WITHIN_VOXELS * grid.voxel_m();
        let volume_from_world = self.world_from_volume.rotation.inverse();
        let mut field = ContactField::empty(grid);
        for index in 0..grid.len() {
            let point = self.world_from_volume * grid.center(grid.voxel(index));
            let Some(seen) = self.scene.nearest(&point, within_m) else { continue };
            if seen.distance_m <= 0.0 {
                field.centroid[index] = 1.0;
            }
            let certainty = 1.0 - seen.distance_m.abs() / within_m;
            if certainty > 0.0 {
                field.certainty[index] = certainty as f32;
                let inward = volume_from_world * -seen.normal.into_inner();
                field.inward[index] = inward.cast::<f32>().into();
            }
        }
        Ok(field)
    }
}

#[cfg(test)]
mod tests {
    use graspd_planner::options::VolumeKind;
    use graspd_planner::scene;
    use graspd_sim::object::Object;
    use graspd_sim::world::WorldSettings;
    use nalgebra::Vector3;

    use super::*;
    use crate::evaluate::station::Station;

    #[test]
    fn contacts_lie_on_faces_and_centroids_inside() {
        let half = Vector3::new(0.02, 0.03, 0.025);
        let mut world = World::new(WorldSettings::default());
        let at = Isometry3::new(Vector3::new(0.03, -0.02, 0.0251), Vector3::z() * 0.4);
        world.add(Arc::new(Object::cuboid("box", half).unwrap()), &at);
        let station = Station::table(&Point3::new(0.0, -0.2, 0.75));
        let options = station.scene_options(VolumeKind::Tsdf);
        let graspd_planner::options::WorkspaceRequest::Placed { world_from_volume, .. } = options.workspace
        else {
            panic!("the station places its volumes");
        };
        let known = SimulatedGeometry::new(&world, world_from_volume);
        // Asked as the planner asks.
        let frame = station.frame(&world, 1);
        struct Spy<'a>(&'a SimulatedGeometry, std::sync::Mutex<Option<ContactField>>);
        impl ContactEstimator for Spy<'_> {
            fn name(&self) -> &str {
                self.0.name()
            }
            fn estimate(&self, volume: &Volume, budget: &dyn Budget) -> Result<ContactField, Stop> {
                let field = self.0.estimate(volume, budget)?;
                *self.1.lock().unwrap() = Some(field.clone());
                Ok(field)
            }
        }
        let spy = Spy(&known, std::sync::Mutex::default());
        let watch = crate::evaluate::clock::Stopwatch::start();
        scene::prepare(std::slice::from_ref(&frame), &options, &spy, &watch).unwrap();
        let field = spy.1.into_inner().unwrap().unwrap();
        let (mut inside, mut sure) = (0, 0);
        for index in 0..field.grid.len() {
            let point = world_from_volume * field.grid.center(field.grid.voxel(index));
            let local = at.inverse() * point;
            let beyond = local.coords.abs() - half;
            let distance = beyond.sup(&Vector3::zeros()).norm() + beyond.max().min(0.0);
            let (certainty, centroid) = (f64::from(field.certainty[index]), field.centroid[index]);
            assert!(
                (certainty - (1.0 - distance.abs() / 0.0075).max(0.0)).abs() < 1e-5,
                "{point} {certainty}"
            );
            assert_eq!(centroid > 0.5, distance <= 0.0, "{point}");
            inside += usize::from(centroid > 0.5);
            // In the middle of a face there is no doubt about its normal.
            if certainty > 0.8 && beyond.map(|b| b > -0.01).iter().filter(|b| **b).count() == 1 {
                let axis = beyond.imax();
                let outward = at.rotation * Vector3::ith(axis, local[axis].signum());
                let inward = Vector3::from(field.inward[index]).cast::<f64>();
                assert!((world_from_volume.rotation * inward + outward).norm() < 1e-5);
                sure += 1;
            }
        }
        // 0.04 × 0.06 × 0.05 m³ in voxels of 5 mm.
        assert!((inside as f64 - 960.0).abs() < 100.0 && sure > 40, "{inside} {sure}");
    }
}
