//! Scenes as the paper sets them up: single objects, packed upright, poured into a tray.
//!
//! Task 1 of the paper is five objects in a tray, Task 2 is 12 to 16 objects (Supplementary Note 7).

mod assortment;
mod footprint;
mod packed;
mod pile;
mod settle;

pub use assortment::assortment;
pub use settle::{is_at_rest, settle};

use std::sync::Arc;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::object::Object;
use crate::world::{ObjectId, World, WorldSettings};

/// How objects are put into the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrangement {
    /// Upright, side by side, without touching.
    Packed,
    /// Poured: dropped from above one after the other, and settled.
    Pile,
}

/// Half the side of the square in which objects are to lie where there is no tray, metres: within the
/// planner's 0.4 m workspace.
const MIDDLE_M: f64 = 0.17;
/// Length of a step while things fall, seconds. Falling from 15 cm, a thing moves 9 mm in it; continuous
/// collision detection keeps it above the table.
const FALLING_DT_S: f64 = 1.0 / 200.0;
/// Longest time allowed for coming to rest, simulated seconds.
const SETTLING_S: f64 = 4.0;
/// How often what fell out is put back.
const ROUNDS: usize = 12;

/// Puts objects into a new world and lets them come to rest. Objects that end outside the tray (or off the
/// table's middle) are put back in from above. Deterministic by seed. Ids follow the order of the objects,
/// from 1.
///
/// Packed objects for which there is no free place are put on top of the others.
pub fn arrange(settings: &WorldSettings, objects: &[Arc<Object>], how: Arrangement, seed: u64) -> World {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut falling = World::new(WorldSettings { dt_s: settings.dt_s.max(FALLING_DT_S), ..*settings });
    let mut ids: Vec<Option<ObjectId>> = vec![None; objects.len()];
    if how == Arrangement::Packed {
        for (id, (object, place)) in
            ids.iter_mut().zip(objects.iter().zip(packed::places(objects, settings, &mut rng)))
        {
            *id = place.map(|pose| falling.add(object.clone(), &pose));
        }
        // What does not stand by itself lies down before anything comes from above.
        settle(&mut falling, SETTLING_S);
    }
    let ids: Vec<ObjectId> = ids
        .iter()
        .zip(objects)
        .map(|(id, object)| id.unwrap_or_else(|| pile::pour(&mut falling, object, &mut rng)))
        .collect();
    settle(&mut falling, SETTLING_S);
    for round in 0..ROUNDS {
        let out: Vec<_> = ids.iter().copied().filter(|&id| is_outside(&falling, id)).collect();
        if out.is_empty() {
            break;
        }
        for id in out {
            pile::put_back(&mut falling, id, round, &mut rng);
        }
        settle(&mut falling, SETTLING_S);
    }
    // The world that is handed out begins at rest, with the steps its owner asked for.
    let mut world = World::new(*settings);
    for (object, id) in objects.iter().zip(ids) {
        if let Some(pose) = falling.pose(id) {
            world.add(object.clone(), &pose);
        }
    }
    settle(&mut world, SETTLING_S);
    world
}

/// True when an object's origin is not within the tray, or not in the table's middle, or below the table.
pub fn is_outside(world: &World, id: ObjectId) -> bool {
    let half = world.settings().tray.map_or([MIDDLE_M; 2], |t| [t.width_m / 2.0, t.length_m / 2.0]);
    world.pose(id).is_some_and(|pose| {
        let p = pose.translation.vector;
        // A NaN is not within.
        !(p.x.abs() <= half[0] && p.y.abs() <= half[1] && p.z > 0.0)
    })
}

#[cfg(test)]
mod tests;
