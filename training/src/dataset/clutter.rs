//! A scene by its number: which objects lie how on what, and which camera looks at them.

use graspd_sim::clutter::{Arrangement, arrange};
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{Tray, World, WorldSettings};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::DatasetError;
use super::families::Stock;
use super::recipe::Recipe;
use crate::evaluate::seeds::derive;

/// How often a scene is drawn anew where its objects find no rest; each time with fewer objects.
const ROUNDS: u64 = 8;

/// A settled scene.
#[derive(Debug)]
pub struct Clutter {
    /// The objects at rest.
    pub world: World,
    /// The camera: one of its kind, with errors of its own.
    pub sensor: Sensor,
    /// Seed of everything else about this scene.
    pub seed: u64,
}

/// Scene number `scene` of a dataset with this seed: no other scene has a say in it.
///
/// # Errors
/// [`DatasetError::Arrange`] when even few objects find no rest.
pub fn clutter(
    recipe: &Recipe,
    stock: &Stock,
    sensor: &Sensor,
    seed: u64,
    scene: u32,
) -> Result<Clutter, DatasetError> {
    let seed = derive(seed, &[u64::from(scene)]);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(derive(seed, &[0]));
    let tray = rng.random_bool(recipe.tray_share);
    let how = if rng.random_bool(recipe.packed_share) { Arrangement::Packed } else { Arrangement::Pile };
    let count = rng.random_range(recipe.objects[0]..=recipe.objects[1]);
    let mut settings = WorldSettings { tray: tray.then(Tray::default), ..WorldSettings::default() };
    settings.table_surface.albedo = rng.random_range(recipe.table_albedo[0]..=recipe.table_albedo[1]);
    let mut sensor = sensor.clone();
    sensor.systematic.device = derive(seed, &[1]);
    let mut round = 0;
    loop {
        let count = (count >> round.min(5)).max(1);
        let objects = stock.draw(count, derive(seed, &[2, round]));
        match arrange(&settings, &objects, how, derive(seed, &[3, round])) {
            Ok(world) => return Ok(Clutter { world, sensor, seed }),
            Err(source) if round + 1 == ROUNDS => return Err(DatasetError::Arrange { scene, source }),
            Err(_) => round += 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::families::Split;
    use super::*;

    #[test]
    fn scenes_repeat_themselves_and_differ_from_each_other() {
        let (recipe, stock) =
            (Recipe { objects: [2, 4], ..Recipe::default() }, Stock::families(Split::Train));
        let scene = |number| {
            let scene = clutter(&recipe, &stock, &Sensor::azure_kinect(), 7, number).unwrap();
            let poses: Vec<_> = scene.world.ids().into_iter().map(|id| scene.world.pose(id)).collect();
            assert!((2..=4).contains(&poses.len()));
            (poses, scene.sensor.systematic.device, scene.seed)
        };
        assert_eq!(scene(3), scene(3));
        assert_ne!(scene(3).0, scene(4).0);
        assert_ne!(scene(3).1, scene(4).1);
    }
}
