//! Objects that a hand can take from above, by the size of their bounding box.

use std::sync::Arc;

use super::assortment;
use crate::object::Object;

/// Objects lower than this have nothing that fingers could take from above, metres.
const THINNEST_M: f64 = 0.02;
/// An object must leave this much of the widest opening, metres. Pads that come nearer than this to each other meet.
const ROOM_M: f64 = 0.01;
/// Where pads do not meet, an object must be this much thicker than the way between them: at the end of their way
/// fingertips curl past facing each other, metres.
const CURL_M: f64 = 0.02;
/// Objects are drawn this many at a time.
const DRAWN: usize = 32;
/// Draws before giving up: an assortment of which nothing fits.
const MOST_DRAWS: u64 = 100;

/// Sizes of objects, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sizes {
    /// The shortest edge of the bounding box is at least so long.
    pub thinnest_m: f64,
    /// The middle edge of the bounding box is at most so long: the longest may lie along the hand.
    pub widest_m: f64,
}

impl Sizes {
    /// What a hand can take whose opposed pads are between `least_m` and `most_m` apart: at least 2 cm thick, so
    /// that fingers reach under its middle on a table, with 1 cm of room in the widest opening, and not so thin that fingertips curl past it.
    pub fn between_pads(least_m: f64, most_m: f64) -> Self {
        // Pads that meet, or nearly, hold whatever is thick enough to be reached.
        let thinnest_m = if least_m > ROOM_M { least_m + CURL_M } else { 0.0 };
        Self { thinnest_m: thinnest_m.max(THINNEST_M), widest_m: most_m - ROOM_M }
    }

    /// What every hand can take that opens to `opening_m` and closes completely.
    pub fn up_to(opening_m: f64) -> Self {
        Self::between_pads(0.0, opening_m)
    }

    /// True when the hand can take the object from above in each of its steady poses.
    ///
    /// That is more than grasping needs: a mug could be taken by its handle, a bowl by its wall, a plate by its rim
    /// where it stands out.
    pub fn allow(&self, object: &Object) -> bool {
        let Some((low, high)) = object.mesh.bounds() else { return false };
        let mut extents: [f64; 3] = (high - low).into();
        extents.sort_by(f64::total_cmp);
        extents[0] >= self.thinnest_m && extents[1] <= self.widest_m
    }

    /// `count` objects of these sizes from the assortments with the seeds `seed_of(0)`, `seed_of(1)`, and so on;
    /// fewer where nearly nothing fits.
    pub fn draw(&self, count: usize, seed_of: impl Fn(u64) -> u64) -> Vec<Arc<Object>> {
        let drawn = (0..MOST_DRAWS).flat_map(|round| assortment(DRAWN, seed_of(round)));
        drawn.filter(|object| self.allow(object)).take(count).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_whose_pads_do_not_meet_get_thicker_things() {
        let (closing, wide) = (Sizes::up_to(0.08), Sizes::between_pads(0.03, 0.2));
        assert_eq!((closing.thinnest_m, wide.thinnest_m), (0.02, 0.05));
        let thickness = |sizes: Sizes| {
            let objects = sizes.draw(12, |round| round);
            assert_eq!(objects.len(), 12);
            let extents =
                objects.iter().filter_map(|o| o.mesh.bounds()).map(|(low, high)| (high - low).min());
            extents.fold(f64::INFINITY, f64::min)
        };
        assert!(thickness(closing) >= 0.02 && thickness(wide) >= 0.05);
        assert!(Sizes::up_to(0.02).draw(3, |round| round).is_empty());
    }
}
