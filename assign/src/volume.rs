//! The space that arms take: capsules, boxes, and the corridor of an approach.

use nalgebra::{Isometry3, Point3, Vector3};

/// A segment with everything within a radius of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    /// One end, world frame.
    pub a: Point3<f64>,
    /// The other end; the same for a ball.
    pub b: Point3<f64>,
    /// Radius, metres.
    pub radius_m: f64,
}

impl Capsule {
    /// Room between two capsules, metres; negative where they overlap.
    pub fn distance(&self, other: &Self) -> f64 {
        segments(&self.a, &self.b, &other.a, &other.b) - self.radius_m - other.radius_m
    }

    /// Room between the capsule and a box, metres; at most `-radius_m` where its axis is inside.
    pub fn distance_to_box(&self, volume: &OrientedBox) -> f64 {
        let local = |p: &Point3<f64>| volume.pose.inverse_transform_point(p);
        let (a, b) = (local(&self.a), local(&self.b));
        let outside = |t: f64| {
            let p = a.coords.lerp(&b.coords, t);
            let over = |i: usize| (p[i].abs() - volume.half_extents_m[i]).max(0.0);
            Vector3::new(over(0), over(1), over(2)).norm()
        };
        // The distance to a convex body is convex along a line.
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..48 {
            let (first, second) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if outside(first) <= outside(second) { high = second } else { low = first }
        }
        outside(0.5 * (low + high)).min(outside(0.0)).min(outside(1.0)) - self.radius_m
    }

    /// A ball around the capsule: its middle and radius.
    fn ball(&self) -> (Point3<f64>, f64) {
        (nalgebra::center(&self.a, &self.b), 0.5 * (self.b - self.a).norm() + self.radius_m)
    }

    /// True when all its numbers are finite and its radius is not negative.
    pub fn is_valid(&self) -> bool {
        let finite = self.a.iter().chain(self.b.iter()).all(|v| v.is_finite());
        finite && self.radius_m.is_finite() && self.radius_m >= 0.0
    }
}

/// A box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientedBox {
    /// Pose of its middle, world frame.
    pub pose: Isometry3<f64>,
    /// Half of its edges, metres.
    pub half_extents_m: Vector3<f64>,
}

impl OrientedBox {
    /// True for a point in it or on it.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        let local = self.pose.inverse_transform_point(point);
        (0..3).all(|i| local[i].abs() <= self.half_extents_m[i])
    }

    /// Room between the box and capsules; true when less than `clearance_m` is left to any.
    pub(crate) fn is_near(&self, capsules: &[Capsule], clearance_m: f64) -> bool {
        let (middle, reach) = (Point3::from(self.pose.translation.vector), self.half_extents_m.norm());
        capsules.iter().any(|capsule| {
            let (at, radius) = capsule.ball();
            (at - middle).norm() < reach + radius + clearance_m && capsule.distance_to_box(self) < clearance_m
        })
    }
}

/// Poses along the straight approach at which the forearm is looked at.
const FOREARM_POSES: usize = 3;

/// The space that an approach sweeps, for an arm of which no more is known than its shoulder: a capsule that the hand
/// sweeps from `lift_m` above its pre-grasp to the grasp, `tool_m` ahead of its root link, and capsules from the shoulder to the
/// root link on the way, thick enough to hold what lies between them.
///
/// `tool` is the point between the fingers in the hand frame.
pub fn corridor(
    world_from_pregrasp: &Isometry3<f64>,
    world_from_hand: &Isometry3<f64>,
    body: &super::Body,
) -> Vec<Capsule> {
    let tool = |pose: &Isometry3<f64>| pose * body.tool_point;
    let root = |pose: &Isometry3<f64>| Point3::from(pose.translation.vector);
    let (from, to) = (root(world_from_pregrasp), root(world_from_hand));
    let above = from + Vector3::z() * body.lift_m;
    let hand = |a, b| Capsule { a, b, radius_m: body.hand_radius_m };
    let mut out =
        vec![hand(from, to), hand(to, tool(world_from_hand)), hand(from, tool(world_from_pregrasp))];
    if body.lift_m > 0.0 {
        out.push(hand(from, above));
    }
    if body.arm_radius_m > 0.0 {
        let apart = (to - from).norm() / (FOREARM_POSES - 1) as f64;
        let radius_m = body.arm_radius_m + 0.5 * apart;
        out.extend((0..FOREARM_POSES).map(|i| {
            let wrist = from + (to - from) * (i as f64 / (FOREARM_POSES - 1) as f64);
            Capsule { a: body.shoulder, b: wrist, radius_m }
        }));
    }
    out
}

/// Distance between two segments, metres.
fn segments(p1: &Point3<f64>, q1: &Point3<f64>, p2: &Point3<f64>, q2: &Point3<f64>) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    const POINT: f64 = 1e-18;
    let (s, t) = if a <= POINT && e <= POINT {
        (0.0, 0.0)
    } else if a <= POINT {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else {
        let c = d1.dot(&r);
        if e <= POINT {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else {
            let b = d1.dot(&d2);
            let square = a * e - b * b;
            let s = if square > 1e-12 * a * e { ((b * f - c * e) / square).clamp(0.0, 1.0) } else { 0.0 };
            let t = (b * s + f) / e;
            if t < 0.0 {
                ((-c / a).clamp(0.0, 1.0), 0.0)
            } else if t > 1.0 {
                (((b - c) / a).clamp(0.0, 1.0), 1.0)
            } else {
                (s, t)
            }
        }
    };
    ((p1 + d1 * s) - (p2 + d2 * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point3<f64>> {
        prop::array::uniform3(-1.0..1.0f64).prop_map(Point3::from)
    }

    proptest! {
        #[test]
        fn no_sampled_pair_of_points_is_nearer(a in point(), b in point(), c in point(), d in point()) {
            let found = segments(&a, &b, &c, &d);
            let mut nearest = f64::INFINITY;
            for i in 0..=40 {
                for k in 0..=40 {
                    let (s, t) = (f64::from(i) / 40.0, f64::from(k) / 40.0);
                    nearest = nearest.min(((a + (b - a) * s) - (c + (d - c) * t)).norm());
                }
            }
            prop_assert!(found <= nearest + 1e-9);
            prop_assert!(found >= nearest - 0.1);
            prop_assert!((found - segments(&d, &c, &a, &b)).abs() < 1e-9);
        }

        #[test]
        fn no_sampled_point_of_a_capsule_is_nearer_to_a_box(
            a in point(), b in point(), half in prop::array::uniform3(0.05..0.5f64), turn in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let volume = OrientedBox { pose: Isometry3::new(Vector3::new(0.1, 0.0, -0.1), turn.into()), half_extents_m: half.into() };
            let found = Capsule { a, b, radius_m: 0.0 }.distance_to_box(&volume);
            let nearest = (0..=200).map(|i| {
                let p = a + (b - a) * (f64::from(i) / 200.0);
                let local = volume.pose.inverse_transform_point(&p);
                let over = |i: usize| (local[i].abs() - half[i]).max(0.0);
                Vector3::new(over(0), over(1), over(2)).norm()
            }).fold(f64::INFINITY, f64::min);
            prop_assert!(found <= nearest + 1e-6 && found >= nearest - 0.02, "{found} {nearest}");
        }
    }

    #[test]
    fn parallel_and_pointlike_segments_have_their_distance() {
        let p = |x: f64, y: f64| Point3::new(x, y, 0.0);
        for (a, b, c, d, expected) in [
            (p(0.0, 0.0), p(1.0, 0.0), p(2.0, 1.0), p(3.0, 1.0), 2f64.sqrt()),
            (p(0.0, 0.0), p(1.0, 0.0), p(0.2, 1.0), p(3.0, 1.0), 1.0),
            (p(0.0, 0.0), p(0.0, 0.0), p(0.2, 1.0), p(0.2, 1.0), (0.04f64 + 1.0).sqrt()),
            (p(0.0, 0.0), p(1.0, 0.0), p(0.5, -1.0), p(0.5, 1.0), 0.0),
        ] {
            assert!((segments(&a, &b, &c, &d) - expected).abs() < 1e-12);
        }
    }
}
