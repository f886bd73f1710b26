//! What is in a tray while it is cleared: which objects are left, and what has left the tray is put back.

use std::sync::Arc;

use graspd_sim::clutter::settle;
use graspd_sim::object::Object;
use graspd_sim::world::{ObjectId, World};
use nalgebra::{Isometry3, Point3, Translation3};

use super::clear::Item;
use super::seeds::derive;
use super::station::Station;

/// Simulated seconds that objects get to come to rest after an attempt.
pub(super) const SETTLE_S: f64 = 3.0;
/// How far outside the tray's walls an object's origin may be before it is put back, metres.
const OUTSIDE_M: f64 = 0.01;
/// How often everything that lies outside is put back: what bounces out again, or drives others out, comes again.
const ROUNDS: u64 = 10;
/// From how high above the table an object is dropped back, metres.
const DROP_M: f64 = 0.2;

/// The objects of a tray; `present[i]` is the item behind the world's i-th object.
#[derive(Clone)]
pub(super) struct Contents {
    pub(super) items: Vec<Item>,
    pub(super) present: Vec<usize>,
    pub(super) failures: Vec<usize>,
}

impl Contents {
    pub(super) fn new(objects: &[Arc<Object>]) -> Self {
        let item = |o: &Arc<Object>| Item { name: o.name.clone(), cleared: false, attempts: 0 };
        Self {
            items: objects.iter().map(item).collect(),
            present: (0..objects.len()).collect(),
            failures: vec![0; objects.len()],
        }
    }

    /// Takes the world's i-th object out of the world.
    pub(super) fn take(&mut self, world: &mut World, at: usize) {
        if let Some(&id) = world.ids().get(at) {
            world.remove(id);
            self.present.remove(at);
        }
    }
}

/// Drops objects that have left the tray back into its middle, one by one, until none lies outside; how many drops
/// it took.
pub(super) fn put_back(world: &mut World, station: &Station, seed: u64) -> usize {
    let mut count = 0;
    for round in 0..ROUNDS {
        let outside = outside(world, station);
        if outside.is_empty() {
            break;
        }
        for (i, id) in outside {
            let Some(pose) = world.pose(id) else { continue };
            // Anywhere in the middle 12 cm.
            let jitter = |axis: u64| {
                let drawn = derive(seed, &[i as u64, axis + 2 * round]);
                (drawn % 1000) as f64 / 1000.0 * 0.12 - 0.06
            };
            let above = Translation3::new(jitter(0), jitter(1), DROP_M);
            world.place(id, &Isometry3::from_parts(above, pose.rotation));
            settle(world, SETTLE_S);
            count += 1;
        }
    }
    count
}

/// The objects that lie outside the tray, with their places among all.
fn outside(world: &World, station: &Station) -> Vec<(usize, ObjectId)> {
    let is_outside = |&(_, id): &(usize, ObjectId)| {
        let pose = world.pose(id);
        pose.is_some_and(|p| !station.holds(&Point3::from(p.translation.vector), OUTSIDE_M))
    };
    world.ids().into_iter().enumerate().filter(is_outside).collect()
}

#[cfg(test)]
mod tests {
    use graspd_sim::world::{Tray, WorldSettings};

    use super::*;
    use crate::evaluate::items::draw;

    #[test]
    fn whatever_lies_outside_is_put_back_until_nothing_does() {
        // A tray so small that what is dropped into it comes out again.
        let tray = Tray { width_m: 0.16, length_m: 0.16, ..Tray::default() };
        let world = WorldSettings { tray: Some(tray), ..WorldSettings::default() };
        let station = Station { world, ..Station::tray() };
        let (mut dropped, mut objects) = (0, 0);
        for seed in 0..4 {
            let mut world = World::new(station.world);
            for (i, object) in draw(4, 0.078, seed).into_iter().enumerate() {
                world.add(object, &Isometry3::translation(0.3, -0.3 + 0.2 * i as f64, 0.1));
            }
            // One has fallen off the table.
            world.place(world.ids()[3], &Isometry3::translation(0.0, 0.0, -20.0));
            objects += world.ids().len();
            dropped += put_back(&mut world, &station, seed);
            assert!(outside(&world, &station).is_empty(), "seed {seed}");
            // And then there is nothing to do.
            assert_eq!(put_back(&mut world, &station, seed), 0);
        }
        assert!(dropped > objects, "{dropped} drops of {objects} objects: nothing came out again");
    }
}
