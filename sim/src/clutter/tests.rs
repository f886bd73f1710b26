//! Tests of arrangements: at rest, inside, the same again, energy only lost.

use super::*;
use crate::world::Tray;
use nalgebra::Isometry3;

fn in_tray() -> WorldSettings {
    WorldSettings { tray: Some(Tray::default()), ..WorldSettings::default() }
}

fn poses(world: &World) -> Vec<Isometry3<f64>> {
    world.ids().into_iter().filter_map(|id| world.pose(id)).collect()
}

#[test]
fn an_assortment_has_every_family_before_any_twice() {
    let names: std::collections::BTreeSet<_> =
        assortment(crate::object::Kind::ALL.len(), 5).iter().map(|o| o.name.clone()).collect();
    assert_eq!(names.len(), crate::object::Kind::ALL.len());
    let all: Vec<_> = assortment(45, 5).iter().map(|o| o.name.clone()).collect();
    let unique: std::collections::BTreeSet<_> = all.iter().collect();
    assert_eq!(unique.len(), 45, "{all:?}");
    assert_eq!(assortment(4, 9), assortment(4, 9));
    assert_ne!(assortment(4, 9), assortment(4, 10));
    use crate::object::Kind::{Mug, Nut};
    let few: Vec<_> = assortment_of(&[Mug, Nut], 4, 5).iter().map(|o| o.name.clone()).collect();
    for name in ["mug", "nut", "mug 2", "nut 2"] {
        assert!(few.iter().any(|n| n == name), "{few:?}");
    }
    assert!(assortment_of(&[], 4, 5).is_empty());
}

#[test]
fn settled_scenes_are_in_the_tray_and_stay() {
    for (how, count, seed) in [
        (Arrangement::Pile, 12, 1),
        (Arrangement::Pile, 5, 2),
        (Arrangement::Packed, 12, 3),
        (Arrangement::Spread, 6, 4),
        (Arrangement::Pile, 16, 28),
    ] {
        let mut world = arrange(&in_tray(), &assortment(count, seed), how, seed).unwrap();
        assert_eq!(world.ids().len(), count);
        assert!(is_at_rest(&world));
        let before = poses(&world);
        let energy = world.energy();
        for _ in 0..(1.0 / world.settings().dt_s) as usize {
            world.step();
            assert!(world.energy() < energy + 1e-4, "{energy} J, then {} J", world.energy());
        }
        for (id, (a, b)) in world.ids().into_iter().zip(before.iter().zip(poses(&world))) {
            let name = &world.object(id).unwrap().name;
            let moved = (a.translation.vector - b.translation.vector).norm();
            assert!(moved < 1e-3, "{how:?} {seed}: {name} moved {moved} m");
            assert!(a.rotation.angle_to(&b.rotation) < 0.05, "{how:?} {seed}: {name} turned");
            assert!(!is_outside(&world, id));
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_poses_bit_for_bit() {
    for how in [Arrangement::Pile, Arrangement::Packed, Arrangement::Spread] {
        let run = |seed| poses(&arrange(&in_tray(), &assortment(5, 2), how, seed).unwrap());
        let bits = |poses: Vec<Isometry3<f64>>| -> Vec<u64> {
            let numbers = poses.iter().flat_map(|p| {
                p.translation
                    .vector
                    .iter()
                    .chain(p.rotation.coords.iter())
                    .map(|x| x.to_bits())
                    .collect::<Vec<_>>()
            });
            numbers.collect()
        };
        assert_eq!(bits(run(3)), bits(run(3)));
        assert_ne!(bits(run(3)), bits(run(4)));
    }
}

#[test]
fn packed_objects_stand_apart_and_upright() {
    use crate::object::Kind;
    let kinds = [Kind::Can, Kind::Box, Kind::Cup, Kind::Cylinder, Kind::Plate, Kind::Block, Kind::Mug];
    let objects: Vec<_> =
        kinds.iter().enumerate().map(|(i, &k)| Arc::new(Object::sample(k, i as u64))).collect();
    let world = arrange(&WorldSettings::default(), &objects, Arrangement::Packed, 6).unwrap();
    assert!(is_at_rest(&world));
    for (id, object) in world.ids().into_iter().zip(&objects) {
        let pose = world.pose(id).unwrap();
        let tilt = (pose.rotation * nalgebra::Vector3::z()).z;
        assert!(tilt > 0.999, "{} leans: {tilt}", object.name);
        let low = object.mesh.bounds().unwrap().0.z;
        assert!((pose.translation.z + low).abs() < 1e-3, "{} does not stand on the table", object.name);
        assert!(!is_outside(&world, id));
    }
}

#[test]
fn spread_objects_use_the_whole_tray() {
    let tray = Tray { width_m: 0.52, length_m: 0.52, ..Tray::default() };
    let settings = WorldSettings { tray: Some(tray), ..WorldSettings::default() };
    // Between the nearest two, and how far out they lie, as means over scenes.
    let measure = |how| {
        let (mut nearest, mut out) = (0.0, 0.0);
        for seed in 1..=5 {
            let world = arrange(&settings, &assortment(6, seed), how, seed).unwrap();
            let at: Vec<_> = poses(&world).iter().map(|p| p.translation.vector.xy()).collect();
            let pairs = (0..6).flat_map(|i| (0..i).map(move |k| (i, k)));
            nearest += pairs.map(|(i, k)| (at[i] - at[k]).norm()).fold(f64::INFINITY, f64::min) / 5.0;
            out += at.iter().map(|p| p.amax()).fold(0.0, f64::max) / 5.0;
        }
        (nearest, out)
    };
    let (packed, spread) = (measure(Arrangement::Packed), measure(Arrangement::Spread));
    assert!(spread.0 > 0.12 && spread.0 > 1.5 * packed.0, "{packed:?} {spread:?}");
    assert!(spread.1 > 0.15 && packed.1 < 0.14, "{packed:?} {spread:?}");
}

#[test]
fn what_falls_gains_no_more_energy_than_contacts_give_back() {
    let mut world = World::new(in_tray());
    for (i, object) in assortment(6, 8).into_iter().enumerate() {
        let turn = nalgebra::Vector3::new(0.4 * i as f64, 0.9, 0.2);
        let at = nalgebra::Vector3::new(0.02 * i as f64 - 0.05, 0.01 * i as f64, 0.12 + 0.12 * i as f64);
        world.add(object, &Isometry3::new(at, turn));
    }
    let first = world.energy();
    let (mut lowest, mut before, mut gained) = (first, first, 0.0);
    for _ in 0..(2.0 / world.settings().dt_s) as usize {
        world.step();
        let energy = world.energy();
        gained += (energy - before).max(0.0);
        before = energy;
        lowest = lowest.min(energy);
    }
    // What falls fast enters a contact by some millimetres in one step, and is lifted out of it again: all of that
    // together is little.
    assert!(gained < 0.02 * first, "{gained} J from nothing, of {first} J");
    assert!(lowest < 0.5 * first);
}

#[test]
fn what_finds_no_place_is_named() {
    // Three bowls, each wider than the tray.
    let tray = Tray { width_m: 0.06, length_m: 0.06, ..Tray::default() };
    let settings = WorldSettings { tray: Some(tray), ..WorldSettings::default() };
    let objects: Vec<_> = (0..3).map(|i| Arc::new(Object::sample(crate::object::Kind::Bowl, i))).collect();
    let error = arrange(&settings, &objects, Arrangement::Pile, 1).unwrap_err();
    assert!(!error.names.is_empty() && error.names.iter().all(|n| n == "bowl"), "{error}");
    assert!(error.to_string().starts_with("objects: found "), "{error}");
}

#[test]
fn what_is_not_there_is_at_rest_and_nothing_is_arranged() {
    let mut world = arrange(&in_tray(), &[], Arrangement::Pile, 0).unwrap();
    assert!(world.ids().is_empty() && settle(&mut world, 1.0));
}
