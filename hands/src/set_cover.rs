//! Few spheres of many that cover all samples between them.

use nalgebra::Point3;

use crate::groups::{Bounds, GROUP};

/// A point that must be in, or this close to, a sphere.
pub(crate) struct Sample {
    pub(crate) point: Point3<f64>,
    pub(crate) reach: f64,
}

/// Some samples: their box, and their smallest and largest reach.
struct Extent {
    bounds: Bounds,
    reach: (f64, f64),
}

impl Extent {
    fn of(samples: &[Sample]) -> Self {
        let ends = (f64::INFINITY, 0.0_f64);
        let reach = samples.iter().fold(ends, |(low, high), s| (low.min(s.reach), high.max(s.reach)));
        Self { bounds: Bounds::of(samples.iter().map(|s| s.point)), reach }
    }

    /// Whether a sphere covers all of the samples, or none; `None` when that takes a closer look.
    fn covered(&self, center: &Point3<f64>, radius: f64) -> Option<bool> {
        let (least, most) = (radius + self.reach.0, radius + self.reach.1);
        if self.bounds.nearest_squared(center) > most * most {
            return Some(false);
        }
        (self.bounds.farthest_squared(center) <= least * least).then_some(true)
    }
}

/// For each candidate a set of bits, one for each sample that it covers.
fn sets(samples: &[Sample], candidates: &[(Point3<f64>, f64)]) -> Vec<Vec<u64>> {
    let extents = |size: usize| -> Vec<Extent> { samples.chunks(size).map(Extent::of).collect() };
    let (words, groups) = (extents(64), extents(GROUP));
    let bits = |count: usize| if count == 64 { u64::MAX } else { (1 << count) - 1 };
    let word = |(w, samples): (usize, &[Sample]), center: &Point3<f64>, radius: f64| {
        if let Some(all) = words[w].covered(center, radius) {
            return if all { bits(samples.len()) } else { 0 };
        }
        let mut word = 0_u64;
        for (g, group) in samples.chunks(GROUP).enumerate() {
            let inside = match groups[w * (64 / GROUP) + g].covered(center, radius) {
                Some(all) => {
                    if all {
                        bits(group.len())
                    } else {
                        0
                    }
                }
                None => group.iter().enumerate().fold(0, |set, (i, sample)| {
                    let limit = radius + sample.reach;
                    set | u64::from((sample.point - center).norm_squared() <= limit * limit) << i
                }),
            };
            word |= inside << (g * GROUP);
        }
        word
    };
    candidates
        .iter()
        .map(|(center, radius)| samples.chunks(64).enumerate().map(|s| word(s, center, *radius)).collect())
        .collect()
}

/// Greedy set cover: always the candidate that covers most of what is still uncovered.
pub(crate) fn greedy(samples: &[Sample], candidates: &[(Point3<f64>, f64)]) -> Vec<(Point3<f64>, f64)> {
    let words = samples.len().div_ceil(64);
    let sets = sets(samples, candidates);
    let mut open = vec![u64::MAX; words];
    if !samples.len().is_multiple_of(64)
        && let Some(last) = open.last_mut()
    {
        *last = (1 << (samples.len() % 64)) - 1;
    }
    let gain =
        |set: &[u64], open: &[u64]| -> u32 { set.iter().zip(open).map(|(a, b)| (a & b).count_ones()).sum() };
    // Gains only shrink, so a stale gain is an upper bound: re-evaluate lazily from the top.
    let mut queue: std::collections::BinaryHeap<(u32, std::cmp::Reverse<usize>)> =
        sets.iter().enumerate().map(|(i, set)| (gain(set, &open), std::cmp::Reverse(i))).collect();
    let mut chosen = Vec::new();
    while let Some((stale, std::cmp::Reverse(i))) = queue.pop() {
        let fresh = gain(&sets[i], &open);
        if fresh == 0 {
            if stale == 0 {
                break;
            }
            continue;
        }
        if queue.peek().is_none_or(|&(next, _)| fresh >= next) {
            open.iter_mut().zip(&sets[i]).for_each(|(o, s)| *o &= !s);
            chosen.push(candidates[i]);
        } else {
            queue.push((fresh, std::cmp::Reverse(i)));
        }
    }
    chosen
}

/// Drops spheres whose samples the others cover.
pub(crate) fn prune(samples: &[Sample], mut spheres: Vec<(Point3<f64>, f64)>) -> Vec<(Point3<f64>, f64)> {
    let covers = |s: &(Point3<f64>, f64), p: &Sample| (p.point - s.0).norm() <= s.1 + p.reach;
    let mut counts: Vec<u32> =
        samples.iter().map(|p| spheres.iter().filter(|s| covers(s, p)).count() as u32).collect();
    let mut i = 0;
    while i < spheres.len() {
        let needed = samples.iter().zip(&counts).any(|(p, &n)| n == 1 && covers(&spheres[i], p));
        if needed {
            i += 1;
        } else {
            let gone = spheres.remove(i);
            for (p, n) in samples.iter().zip(&mut counts) {
                *n -= u32::from(covers(&gone, p));
            }
        }
    }
    spheres
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::groups;

    #[test]
    fn sets_hold_what_distances_say() {
        let at = |i: usize| {
            let f = |k: f64| (i as f64 * k).fract() - 0.5;
            Point3::new(f(0.618), f(0.755), f(0.570))
        };
        let mut samples: Vec<Sample> =
            (0..301).map(|i| Sample { point: at(i), reach: 0.01 * (i % 7) as f64 }).collect();
        groups::sort(&mut samples, |s| s.point);
        let candidates: Vec<(Point3<f64>, f64)> = (0..90).map(|i| (at(3 * i), 0.01 * i as f64)).collect();
        for ((center, radius), set) in candidates.iter().zip(sets(&samples, &candidates)) {
            for (i, sample) in samples.iter().enumerate() {
                let covered = (sample.point - center).norm() <= radius + sample.reach;
                assert_eq!(set[i / 64] >> (i % 64) & 1 == 1, covered, "{i} {center} {radius}");
            }
            assert_eq!(set[samples.len() / 64] >> (samples.len() % 64), 0);
        }
    }
}
