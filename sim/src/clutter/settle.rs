//! Coming to rest.

use crate::world::{ObjectId, World};

/// Slower than this, an object is at rest, metres per second.
const SPEED_M_S: f64 = 0.005;
/// Turning slower than this, an object is at rest, radians per second.
const TURN_RAD_S: f64 = 0.1;
/// How long everything must be at rest, seconds.
const CALM_S: f64 = 0.1;

/// True when an object moves slower than 5 mm/s and turns slower than 0.1 rad/s now.
pub(super) fn is_calm(world: &World, id: ObjectId) -> bool {
    world.velocity(id).is_some_and(|(v, w)| v.norm() < SPEED_M_S && w.norm() < TURN_RAD_S)
}

/// True when every object moves slower than 5 mm/s and turns slower than 0.1 rad/s now.
pub fn is_at_rest(world: &World) -> bool {
    world.ids().into_iter().all(|id| is_calm(world, id))
}

/// Steps until everything has been at rest for 0.1 s (see [`is_at_rest`]), at most `limit_s` simulated
/// seconds; `true` when it is.
pub fn settle(world: &mut World, limit_s: f64) -> bool {
    let dt = world.settings().dt_s;
    let needed = (CALM_S / dt).ceil() as usize;
    let mut calm = 0;
    for _ in 0..(limit_s / dt).ceil() as usize {
        world.step();
        calm = if is_at_rest(world) { calm + 1 } else { 0 };
        if calm >= needed {
            return true;
        }
    }
    false
}
