//! Points in groups of near ones, so that distances to many can be decided by the bounds of few.

use nalgebra::Point3;

/// Points of one group; divides the 64 bits of a word.
pub(crate) const GROUP: usize = 16;

/// The box about some points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    low: Point3<f64>,
    high: Point3<f64>,
}

impl Bounds {
    pub(crate) fn of(points: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let none = Self { low: Point3::from([f64::INFINITY; 3]), high: Point3::from([f64::NEG_INFINITY; 3]) };
        points.into_iter().fold(none, |b, p| Self { low: b.low.inf(&p), high: b.high.sup(&p) })
    }

    /// Square of the smallest distance from a point to anything in the box.
    pub(crate) fn nearest_squared(&self, p: &Point3<f64>) -> f64 {
        let off = |axis: usize| (self.low[axis] - p[axis]).max(p[axis] - self.high[axis]).max(0.0);
        off(0) * off(0) + off(1) * off(1) + off(2) * off(2)
    }

    /// Square of the largest distance from a point to anything in the box.
    pub(crate) fn farthest_squared(&self, p: &Point3<f64>) -> f64 {
        let off = |axis: usize| (p[axis] - self.low[axis]).max(self.high[axis] - p[axis]);
        off(0) * off(0) + off(1) * off(1) + off(2) * off(2)
    }
}

/// Sorts items such that each run of [`GROUP`], and each run of four groups, lies close together.
///
/// Halves along the longest edge of the box, at multiples of the group size. The same items in the same
/// order are always sorted in the same way.
pub(crate) fn sort<T>(items: &mut [T], at: impl Fn(&T) -> Point3<f64> + Copy) {
    if items.len() <= GROUP {
        return;
    }
    let bounds = Bounds::of(items.iter().map(at));
    let axis = (bounds.high - bounds.low).imax();
    let unit = if items.len() > 4 * GROUP { 4 * GROUP } else { GROUP };
    let middle = (items.len() / 2).next_multiple_of(unit);
    let middle = if middle < items.len() { middle } else { middle - unit };
    items.select_nth_unstable_by(middle, |a, b| at(a)[axis].total_cmp(&at(b)[axis]));
    let (low, high) = items.split_at_mut(middle);
    sort(low, at);
    sort(high, at);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn points() -> impl Strategy<Value = Vec<Point3<f64>>> {
        let point = [-1.0..1.0, -1.0..1.0, -1.0..1.0_f64].prop_map(Point3::from);
        prop::collection::vec(point, 0..400)
    }

    proptest! {
        #[test]
        fn sorting_keeps_every_point(points in points()) {
            let mut sorted = points.clone();
            sort(&mut sorted, |p| *p);
            let key = |list: &[Point3<f64>]| {
                let mut list: Vec<[u64; 3]> = list.iter().map(|p| [p.x, p.y, p.z].map(f64::to_bits)).collect();
                list.sort_unstable();
                list
            };
            prop_assert_eq!(key(&points), key(&sorted));
        }

        #[test]
        fn bounds_bound_the_distances(points in points(), from in [-2.0..2.0, -2.0..2.0, -2.0..2.0_f64]) {
            let from = Point3::from(from);
            for group in points.chunks(GROUP) {
                let bounds = Bounds::of(group.iter().copied());
                for p in group {
                    let d = (p - from).norm_squared();
                    prop_assert!(bounds.nearest_squared(&from) <= d + 1e-12);
                    prop_assert!(bounds.farthest_squared(&from) >= d - 1e-12);
                }
            }
        }
    }

    #[test]
    fn groups_are_smaller_than_the_whole() {
        let mut grid: Vec<Point3<f64>> = (0..4096)
            .map(|i| Point3::new(f64::from(i % 16), f64::from(i / 16 % 16), f64::from(i / 256)))
            .collect();
        sort(&mut grid, |p| *p);
        for group in grid.chunks(GROUP) {
            let b = Bounds::of(group.iter().copied());
            assert!((b.high - b.low).max() <= 4.0, "{b:?}");
        }
    }
}
