//! Piles: objects dropped from above, one after the other.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::object::Object;
use crate::world::{ObjectId, World};

/// From how high above what lies there an object is dropped, metres.
const DROP_M: (f64, f64) = (0.10, 0.15);
/// The same for an object that fell out and is put back: ever lower, so that it stays.
const LAID_M: f64 = 0.03;
/// How far from the middle objects are dropped, metres.
const SPREAD_M: f64 = 0.05;
/// How long one falls before the next is dropped, seconds.
const PAUSE_S: f64 = 0.25;

/// Drops an object into the world, and lets it fall for a moment.
pub(super) fn pour(world: &mut World, object: &Arc<Object>, rng: &mut Xoshiro256PlusPlus) -> ObjectId {
    let pose = above(world, object, DROP_M, SPREAD_M, rng);
    let id = world.add(object.clone(), &pose);
    wait(world);
    id
}

/// Takes an object that fell out and drops it again.
pub(super) fn put_back(world: &mut World, id: ObjectId, round: usize, rng: &mut Xoshiro256PlusPlus) {
    let Some(object) = world.object(id).cloned() else { return };
    let height = if round == 0 { DROP_M } else { (LAID_M / (round + 1) as f64, LAID_M / round as f64) };
    // Where there is a heap in the middle, its side may be the better place.
    let pose = above(world, &object, height, SPREAD_M + 0.01 * round.min(5) as f64, rng);
    world.place(id, &pose);
    wait(world);
}

fn wait(world: &mut World) {
    for _ in 0..(PAUSE_S / world.settings().dt_s).ceil() as usize {
        world.step();
    }
}

/// A random pose over the middle whose lowest point is a random height above everything near it.
fn above(
    world: &World,
    object: &Object,
    height: (f64, f64),
    spread: f64,
    rng: &mut Xoshiro256PlusPlus,
) -> Isometry3<f64> {
    let [x, y] = [0, 1].map(|_| rng.random_range(-spread..spread));
    let rotation = any_rotation(rng);
    let radius = object.parts.iter().flatten().map(|p| p.coords.norm()).fold(0.0, f64::max);
    let near = |p: &Point3<f64>| (p.x - x).hypot(p.y - y) < radius + 0.01;
    let mut top: f64 = 0.0;
    for id in world.ids() {
        if let (Some(other), Some(pose)) = (world.object(id), world.pose(id)) {
            let points = other.parts.iter().flatten().map(|p| pose * p).filter(near);
            top = points.map(|p| p.z).fold(top, f64::max);
        }
    }
    let low = object.parts.iter().flatten().map(|p| (rotation * p).z).fold(0.0, f64::min);
    let z = top - low + rng.random_range(height.0..height.1);
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// Evenly distributed over all rotations (Shoemake's subgroup algorithm).
fn any_rotation(rng: &mut Xoshiro256PlusPlus) -> UnitQuaternion<f64> {
    let [u, v, w]: [f64; 3] = [0, 1, 2].map(|_| rng.random_range(0.0..1.0));
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    let (v, w) = (v * TAU, w * TAU);
    UnitQuaternion::new_normalize(Quaternion::new(b * w.cos(), a * v.sin(), a * v.cos(), b * w.sin()))
}
