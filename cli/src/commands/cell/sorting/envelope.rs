//! The space that a hand takes however its fingers stand, as a few capsules: what is reserved for it.

use graspd_assign::Capsule;
use graspd_hands::Hand;
use nalgebra::{Matrix3, Point3, SymmetricEigen, Unit, Vector3};

/// Postures that are looked at. Each finger moves by itself; a chain of a hand has at most four coordinates.
const POSTURES: u32 = 2000;
/// Added to everything: for postures between those, and for how far spheres are within the surface, metres.
const MARGIN_M: f64 = 0.004;
/// Capsules for a hand.
const CAPSULES: usize = 8;
/// Rounds in which spheres find the group whose middle is nearest.
const ROUNDS: usize = 20;

/// A sphere of the hand in one posture, hand frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Ball {
    at: Point3<f64>,
    radius_m: f64,
}

/// Capsules that hold all of a hand in every posture that its coordinates allow from open to closed, hand frame.
pub(super) fn envelope(hand: &Hand) -> Vec<Capsule> {
    let balls = balls(hand);
    groups(&balls).iter().filter(|group| !group.is_empty()).map(|group| around(group)).collect()
}

/// The hand's coordinates in the posture of this number. A coordinate that closes goes from open to its end in that direction; a
/// spread, or what only contact moves, over its whole range.
fn posture(hand: &Hand, number: u32) -> Vec<f64> {
    const PRIMES: [u32; 16] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];
    let range = hand.actuation.coordinates.iter().enumerate().map(|(i, c)| {
        // A little beyond both ends: ends are where hands are largest.
        let share = (1.1 * halton(number + 1, PRIMES[i % PRIMES.len()]) - 0.05).clamp(0.0, 1.0);
        let (from, to) = match c.closed.total_cmp(&c.open) {
            std::cmp::Ordering::Equal => (c.lower, c.upper),
            std::cmp::Ordering::Greater => (c.open.min(c.upper), c.upper),
            std::cmp::Ordering::Less => (c.open.max(c.lower), c.lower),
        };
        from + share * (to - from)
    });
    range.collect()
}

/// The digits of a number behind the point, backwards: evenly spread over 0 to 1.
fn halton(mut number: u32, base: u32) -> f64 {
    let (mut sum, mut digit) = (0.0, 1.0 / f64::from(base));
    while number > 0 {
        sum += f64::from(number % base) * digit;
        number /= base;
        digit /= f64::from(base);
    }
    sum
}

/// Every sphere of the hand in every posture, of equal ones (to a millimetre) one.
fn balls(hand: &Hand) -> Vec<Ball> {
    let mut seen = std::collections::HashSet::new();
    let mut out = Vec::new();
    for number in 0..POSTURES {
        let poses = hand.tree.body_poses(&hand.actuation.joints(&posture(hand, number)));
        for (i, sphere) in hand.spheres.iter().enumerate() {
            let at = poses[sphere.body] * sphere.center;
            let key = [at.x, at.y, at.z].map(|v| (v / 1e-3).round() as i32);
            if seen.insert((key, i)) {
                out.push(Ball { at, radius_m: sphere.radius });
            }
        }
    }
    out
}

/// The balls in groups that lie together: each with the group whose middle is nearest, begun with those farthest apart.
fn groups(balls: &[Ball]) -> Vec<Vec<Ball>> {
    let Some(first) = balls.first() else { return Vec::new() };
    let mut middles = vec![first.at];
    let nearest = |middles: &[Point3<f64>], ball: &Ball| {
        let far = middles.iter().enumerate().map(|(i, m)| (i, (m - ball.at).norm()));
        far.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    while middles.len() < CAPSULES {
        let far = balls.iter().max_by(|a, b| nearest(&middles, a).1.total_cmp(&nearest(&middles, b).1));
        middles.extend(far.map(|ball| ball.at));
    }
    let mut groups = Vec::new();
    for _ in 0..ROUNDS {
        groups = vec![Vec::new(); middles.len()];
        for ball in balls {
            groups[nearest(&middles, ball).0].push(*ball);
        }
        for (middle, group) in middles.iter_mut().zip(&groups) {
            if !group.is_empty() {
                let sum: Vector3<f64> = group.iter().map(|b| b.at.coords).sum();
                *middle = Point3::from(sum / group.len() as f64);
            }
        }
    }
    groups
}

/// A capsule along the longest axis of a group that holds all of it.
fn around(group: &[Ball]) -> Capsule {
    let mean = group.iter().map(|b| b.at.coords).sum::<Vector3<f64>>() / group.len() as f64;
    let spread: Matrix3<f64> =
        group.iter().map(|b| (b.at.coords - mean) * (b.at.coords - mean).transpose()).sum();
    let eigen = SymmetricEigen::new(spread);
    let axis = Unit::try_new(eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned(), 1e-9)
        .unwrap_or_else(Vector3::z_axis);
    let along = |ball: &Ball| axis.dot(&(ball.at.coords - mean));
    // Not through the mean of all, but through the middle of what lies across the axis.
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for ball in group {
        let across = ball.at.coords - mean - axis.into_inner() * along(ball);
        (low, high) =
            (low.inf(&across.add_scalar(-ball.radius_m)), high.sup(&across.add_scalar(ball.radius_m)));
    }
    let shift = (low + high) / 2.0;
    let middle = mean + shift - axis.into_inner() * axis.dot(&shift);
    let off = |ball: &Ball| {
        let from = ball.at.coords - middle;
        (from - axis.into_inner() * axis.dot(&from)).norm()
    };
    let radius_m = group.iter().map(|b| off(b) + b.radius_m).fold(0.0, f64::max);
    let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
    for ball in group {
        // The ends are round: where a ball is near the axis, they reach beyond it.
        let round = ((radius_m - ball.radius_m).powi(2) - off(ball).powi(2)).max(0.0).sqrt();
        let at = axis.dot(&(ball.at.coords - middle));
        (from, to) = (from.min(at + round), to.max(at - round));
    }
    if from > to {
        // One ball holds them all.
        (from, to) = ((from + to) / 2.0, (from + to) / 2.0);
    }
    let end = |t: f64| Point3::from(middle + axis.into_inner() * t);
    Capsule { a: end(from), b: end(to), radius_m: radius_m + MARGIN_M }
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_hands::library;
    use proptest::prelude::*;

    #[test]
    fn hands_stay_slender() {
        // A hand with two fingers is wide one way alone.
        let capsules = envelope(library::hand("robotiq-2f85").unwrap());
        assert!(capsules.iter().all(|c| c.radius_m < 0.06), "{capsules:?}");
        assert!(capsules.len() <= CAPSULES);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6))]

        /// Whatever posture a hand has on its way, all of it is in the space that is reserved for it.
        #[test]
        fn no_posture_sticks_out(which in any::<prop::sample::Index>(), shares in prop::collection::vec(prop::collection::vec(0.0..=1.0f64, 32), 200)) {
            let ids = ["robotiq-2f85", "model-o", "robotiq-3f"];
            let hand = library::hand(ids[which.index(ids.len())]).unwrap();
            let capsules = envelope(hand);
            for shares in shares {
                let u: Vec<f64> = hand.actuation.coordinates.iter().zip(&shares).map(|(c, share)| {
                    if c.open == c.closed {
                        c.lower + share * (c.upper - c.lower)
                    } else {
                        let end = if c.closed > c.open { c.upper } else { c.lower };
                        c.open + share * (end - c.open)
                    }
                }).collect();
                let poses = hand.tree.body_poses(&hand.actuation.joints(&u));
                for s in &hand.spheres {
                    let at = poses[s.body] * s.center;
                    let ball = Capsule { a: at, b: at, radius_m: 0.0 };
                    let out = capsules.iter().map(|c| c.distance(&ball) + s.radius).fold(f64::INFINITY, f64::min);
                    prop_assert!(out <= 1e-9, "{}: {:.1} mm out", hand.id, 1e3 * out);
                }
            }
        }
    }
}
