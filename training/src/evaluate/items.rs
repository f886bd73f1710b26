//! The objects that are grasped: the same for every hand, of all families, none wider than the narrowest hand
//! opens.

use std::sync::Arc;

use graspd_sim::clutter::assortment;
use graspd_sim::object::Object;

use super::seeds::derive;

/// Objects lower than this have nothing that fingers could take from above, metres.
const LEAST_M: f64 = 0.02;
/// Objects are drawn this many at a time.
const DRAWN: usize = 32;
/// Draws before giving up: an assortment of which nothing fits.
const MOST_DRAWS: u64 = 100;

/// True when a hand that opens to `opening_m` can take the object from above in each of its steady poses: its
/// bounding box is at least 2 cm thick, and its middle extent is at least 1 cm less than the opening.
pub fn fits(object: &Object, opening_m: f64) -> bool {
    let Some((low, high)) = object.mesh.bounds() else { return false };
    let mut extents: [f64; 3] = (high - low).into();
    extents.sort_by(f64::total_cmp);
    extents[0] >= LEAST_M && extents[1] <= opening_m - 0.01
}

/// `count` objects of all families that [`fits`] allows, drawn by seed; fewer where the opening is too small
/// for any.
pub fn draw(count: usize, opening_m: f64, seed: u64) -> Vec<Arc<Object>> {
    let mut items: Vec<Arc<Object>> = Vec::with_capacity(count);
    for round in 0..MOST_DRAWS {
        if items.len() >= count {
            break;
        }
        let drawn = assortment(DRAWN, derive(seed, &[round]));
        items.extend(drawn.into_iter().filter(|o| fits(o, opening_m)));
    }
    items.truncate(count);
    items
}
