//! What of the table an object covers: a convex polygon, and the gap between two of them.

use nalgebra::{Point2, Vector2};

/// A convex polygon, counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Footprint {
    corners: Vec<Point2<f64>>,
}

impl Footprint {
    /// The convex hull of points (Andrew's monotone chain).
    pub(super) fn around(points: impl Iterator<Item = Point2<f64>>) -> Self {
        let mut points: Vec<_> = points.collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        points.dedup();
        let mut corners: Vec<Point2<f64>> = Vec::new();
        // Along the lower side, then back along the upper.
        for pass in 0..2 {
            let start = corners.len();
            for p in &points {
                while corners.len() >= start + 2 {
                    let (a, b) = (corners[corners.len() - 2], corners[corners.len() - 1]);
                    if (b - a).perp(&(p - b)) > 0.0 {
                        break;
                    }
                    corners.pop();
                }
                corners.push(*p);
            }
            // Its last corner is the first of the other side.
            corners.pop();
            if pass == 0 {
                points.reverse();
            }
        }
        Self { corners }
    }

    /// Turned and moved.
    pub(super) fn moved(&self, yaw: f64, by: Vector2<f64>) -> Self {
        let turn = nalgebra::Rotation2::new(yaw);
        Self { corners: self.corners.iter().map(|c| turn * c + by).collect() }
    }

    /// Largest distance of a corner from an origin.
    pub(super) fn reach(&self) -> f64 {
        self.corners.iter().map(|c| c.coords.norm()).fold(0.0, f64::max)
    }

    /// True when it lies within a rectangle around the origin.
    pub(super) fn is_within(&self, half: [f64; 2]) -> bool {
        self.corners.iter().all(|c| c.x.abs() <= half[0] && c.y.abs() <= half[1])
    }

    /// True when a straight line separates both with at least this gap between.
    pub(super) fn is_apart(&self, other: &Self, gap: f64) -> bool {
        self.has_separating_edge(other, gap) || other.has_separating_edge(self, gap)
    }

    fn has_separating_edge(&self, other: &Self, gap: f64) -> bool {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().zip(next).any(|(a, b)| {
            let Some(along) = (b - a).try_normalize(1e-12) else { return false };
            let outwards = Vector2::new(along.y, -along.x);
            other.corners.iter().all(|c| (c - a).dot(&outwards) >= gap)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f64) -> Footprint {
        let points = [[1.0, 1.0], [-1.0, 1.0], [0.2, 0.3], [-1.0, -1.0], [1.0, -1.0], [0.0, -1.0]];
        Footprint::around(points.into_iter().map(|p| Point2::from(p) * half))
    }

    #[test]
    fn a_hull_has_only_corners() {
        assert_eq!(square(1.0).corners.len(), 4);
        assert!((square(1.0).reach() - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!(square(1.0).is_within([1.0, 1.0]) && !square(1.0).is_within([1.0, 0.9]));
    }

    #[test]
    fn a_gap_is_seen_from_both_sides() {
        let (a, b) = (square(1.0), square(1.0));
        for (x, gap, apart) in [(2.5, 0.4, true), (2.5, 0.6, false), (1.9, 0.0, false)] {
            let b = b.moved(0.0, Vector2::new(x, 0.3));
            assert_eq!((a.is_apart(&b, gap), b.is_apart(&a, gap)), (apart, apart));
        }
        // A corner that points at a side.
        let turned = b.moved(std::f64::consts::FRAC_PI_4, Vector2::new(2.45, 0.0));
        assert!(a.is_apart(&turned, 0.03) && !a.is_apart(&turned, 0.05));
    }
}
