//! Scenes as the paper sets them up: single objects, packed upright, poured into a tray.
//!
//! Task 1 of the paper is five objects in a tray, Task 2 is 12 to 16 objects (Supplementary Note 7).

mod assortment;
mod fitting;
mod footprint;
mod packed;
mod pile;
mod settle;

pub use assortment::{assortment, assortment_of};
pub use fitting::Sizes;
pub use settle::{is_at_rest, settle};

use std::sync::Arc;

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

use packed::Spacing;

use crate::object::Object;
use crate::world::{ObjectId, World, WorldSettings};

/// How objects are put into the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrangement {
    /// Upright, side by side, without touching.
    Packed,
    /// Upright, each by itself, over the whole tray, or the table's middle where there is none.
    Spread,
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
/// How long a settled world is watched, simulated seconds.
const WATCHED_S: f64 = 0.5;
/// How far an object may move meanwhile, metres.
const STEADY_M: f64 = 0.0003;
/// How often what fell out, or found no rest, is put back.
const ROUNDS: usize = 12;

/// Objects found no place, or no rest, however often they were put back.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("objects: found {count} without a place to rest ({}), expected fewer, smaller ones or a larger tray", names.join(", "), count = names.len())]
pub struct ArrangeError {
    /// Their names.
    pub names: Vec<String>,
}

/// Puts objects into a new world and lets them come to rest. Objects that end outside the tray (or off the table's
/// middle) are put back in from above, and so are the few that find no rest where they are, 12 times at most.
/// Deterministic by seed. Ids follow the order of the objects, from 1.
///
/// Packed and spread objects for which there is no free place are put on top of the others.
///
/// # Errors
/// [`ArrangeError`] with the objects that still lie outside, or still move.
pub fn arrange(
    settings: &WorldSettings,
    objects: &[Arc<Object>],
    how: Arrangement,
    seed: u64,
) -> Result<World, ArrangeError> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut falling = World::new(WorldSettings { dt_s: settings.dt_s.max(FALLING_DT_S), ..*settings });
    let mut ids: Vec<Option<ObjectId>> = vec![None; objects.len()];
    let spacing = match how {
        Arrangement::Packed => Some(Spacing::PACKED),
        Arrangement::Spread => Some(Spacing::spread(settings)),
        Arrangement::Pile => None,
    };
    if let Some(spacing) = spacing {
        let places = packed::places(objects, settings, spacing, &mut rng);
        for (id, (object, place)) in ids.iter_mut().zip(objects.iter().zip(places)) {
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
    let mut round = 0;
    loop {
        settle(&mut falling, SETTLING_S);
        let mut again: Vec<_> = ids
            .iter()
            .copied()
            .filter(|&id| is_outside(&falling, id) || !settle::is_calm(&falling, id))
            .collect();
        if again.is_empty() || round == ROUNDS {
            let (world, unsteady) = hand_out(&falling, settings, &ids);
            if unsteady.is_empty() {
                return Ok(world);
            }
            again = unsteady;
            if round == ROUNDS {
                let name = |&id: &ObjectId| falling.object(id).map(|o| o.name.clone());
                return Err(ArrangeError { names: again.iter().filter_map(name).collect() });
            }
        }
        for id in again {
            pile::put_back(&mut falling, id, round, &mut rng);
        }
        round += 1;
    }
}

/// The world as its owner asked for it, with shorter steps than those of falling, at rest; and which objects
/// did not stay where they were.
fn hand_out(falling: &World, settings: &WorldSettings, ids: &[ObjectId]) -> (World, Vec<ObjectId>) {
    let mut world = World::new(*settings);
    for &id in ids {
        if let (Some(object), Some(pose)) = (falling.object(id), falling.pose(id)) {
            world.add(object.clone(), &pose);
        }
    }
    settle(&mut world, SETTLING_S);
    let places = |world: &World| -> Vec<_> {
        world.ids().into_iter().map(|id| world.pose(id).map(|p| p.translation.vector)).collect()
    };
    let before = places(&world);
    for _ in 0..(WATCHED_S / settings.dt_s).ceil() as usize {
        world.step();
    }
    let moved = before.iter().zip(places(&world)).map(|(a, b)| match (a, b) {
        (Some(a), Some(b)) => (a - b).norm() > STEADY_M,
        _ => true,
    });
    let unsteady = ids.iter().zip(world.ids()).zip(moved);
    let unsteady = unsteady
        .filter(|&((_, new), moved)| moved || is_outside(&world, new) || !settle::is_calm(&world, new))
        .map(|((old, _), _)| *old)
        .collect();
    (world, unsteady)
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
