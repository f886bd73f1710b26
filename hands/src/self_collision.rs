//! Which pairs of spheres self-collision has to watch.
//!
//! Most pairs can never meet, and of those that can, few suffice to notice that two parts collide: in
//! every sampled posture in which two bodies overlap, one pair that overlaps at least half as deeply as
//! the deepest.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3};

use crate::description::Collision;
use crate::error::Findings;
use crate::files::TOML;
use crate::{Actuation, CollisionSphere, Tree};

/// Postures that are sampled, besides open and closed.
const POSTURES: usize = 384;
/// Most pairs that are kept.
const MOST_PAIRS: usize = 256;
/// Overlaps of two bodies that are shallower than this everywhere need not be noticed, metres.
const NOTICED_M: f64 = 0.002;
/// Pairs of the open posture closer than this count as touching there: neighbours by construction.
const TOUCHING_M: f64 = 0.0005;

/// Two indices.
type Pair = (usize, usize);
/// The pairs of spheres any of which notices one overlap of two bodies.
type Event = Vec<Pair>;

/// Finds the pairs.
pub(crate) fn pairs(
    tree: &Tree,
    actuation: &Actuation,
    spheres: &[CollisionSphere],
    rules: &Collision,
    findings: &mut Findings,
) -> Vec<Pair> {
    let ignored = ignored(tree, rules, findings);
    let eligible = eligible(tree, spheres, &ignored);
    let open = centres(tree, actuation, &actuation.open(), spheres);
    let eligible: Vec<Pair> =
        eligible.into_iter().filter(|&(a, b)| overlap(spheres, &open, a, b) < -TOUCHING_M).collect();
    // Every posture in which two bodies overlap is an event that some kept pair must notice.
    let mut events: BTreeMap<Pair, Vec<Event>> = BTreeMap::new();
    for u in postures(actuation) {
        let centres = centres(tree, actuation, &u, spheres);
        let mut overlaps: BTreeMap<Pair, Vec<(f64, Pair)>> = BTreeMap::new();
        for &(a, b) in &eligible {
            let depth = overlap(spheres, &centres, a, b);
            if depth > 0.0 {
                overlaps.entry((spheres[a].body, spheres[b].body)).or_default().push((depth, (a, b)));
            }
        }
        for (bodies, found) in overlaps {
            let deepest = found.iter().map(|f| f.0).fold(0.0, f64::max);
            if deepest > NOTICED_M {
                let good = found.iter().filter(|f| f.0 >= 0.5 * deepest).map(|f| f.1).collect();
                events.entry(bodies).or_default().push(good);
            }
        }
    }
    let mut kept: Vec<(Pair, usize)> = events.into_values().flat_map(fewest).collect();
    if kept.len() > MOST_PAIRS {
        findings.warn(
            TOML,
            "self-collision",
            format!("{} pairs of spheres that can meet", kept.len()),
            format!("at most {MOST_PAIRS}; the rarest were dropped"),
        );
    }
    kept.sort_by_key(|&(pair, count)| (std::cmp::Reverse(count), pair));
    kept.truncate(MOST_PAIRS);
    let mut pairs: Vec<Pair> = kept.into_iter().map(|(pair, _)| pair).collect();
    pairs.sort_unstable();
    pairs
}

/// Greedily, few pairs such that each event contains one; with the number of events that each settled.
fn fewest(mut events: Vec<Event>) -> Vec<(Pair, usize)> {
    let mut out = Vec::new();
    while !events.is_empty() {
        let mut counts: BTreeMap<Pair, usize> = BTreeMap::new();
        for pair in events.iter().flatten() {
            *counts.entry(*pair).or_insert(0) += 1;
        }
        // The smallest pair among those that settle most: always the same choice.
        let best = counts.into_iter().max_by_key(|&(pair, count)| (count, std::cmp::Reverse(pair)));
        let Some((pair, count)) = best else { break };
        events.retain(|event| !event.contains(&pair));
        out.push((pair, count));
    }
    out
}

/// Pairs of spheres of bodies that are neither one nor neighbours, and that no rule excuses.
fn eligible(tree: &Tree, spheres: &[CollisionSphere], ignored: &BTreeSet<Pair>) -> Vec<Pair> {
    let mut out = Vec::new();
    for a in 0..spheres.len() {
        for b in a + 1..spheres.len() {
            let (x, y) = (&spheres[a], &spheres[b]);
            if !adjacent(tree, x.body, y.body) && !ignored.contains(&(x.link.min(y.link), x.link.max(y.link)))
            {
                out.push((a, b));
            }
        }
    }
    out
}

/// True for one body, or for a body and the one that carries it.
pub(crate) fn adjacent(tree: &Tree, a: usize, b: usize) -> bool {
    a == b || tree.bodies[a].parent == Some(b) || tree.bodies[b].parent == Some(a)
}

/// Pairs of links (smaller index first) that the description excuses.
fn ignored(tree: &Tree, rules: &Collision, findings: &mut Findings) -> BTreeSet<Pair> {
    let mut out = BTreeSet::new();
    let mut find = |name: &str, key: &str| {
        let link = tree.link(name);
        if link.is_none() {
            findings.error(TOML, format!("collision.{key}"), format!("{name:?}"), "the name of a link");
        }
        link
    };
    for name in &rules.ignore_links {
        if let Some(link) = find(name, "ignore_links") {
            out.extend((0..tree.links.len()).map(|other| (link.min(other), link.max(other))));
        }
    }
    for [a, b] in &rules.ignore_pairs {
        if let (Some(a), Some(b)) = (find(a, "ignore_pairs"), find(b, "ignore_pairs")) {
            out.insert((a.min(b), a.max(b)));
        }
    }
    out
}

/// Sphere centres in the hand frame.
fn centres(tree: &Tree, actuation: &Actuation, u: &[f64], spheres: &[CollisionSphere]) -> Vec<Point3<f64>> {
    let poses: Vec<Isometry3<f64>> = tree.body_poses(&actuation.joints(u));
    spheres.iter().map(|s| poses[s.body] * s.center).collect()
}

fn overlap(spheres: &[CollisionSphere], centres: &[Point3<f64>], a: usize, b: usize) -> f64 {
    spheres[a].radius + spheres[b].radius - (centres[a] - centres[b]).norm()
}

/// Postures that fill the range of the coordinates evenly, always the same ones.
pub(crate) fn postures(actuation: &Actuation) -> Vec<Vec<f64>> {
    let count = actuation.coordinates.len();
    let mut out = vec![actuation.open(), actuation.closed()];
    // Additive recurrence with the generalized golden ratio of as many dimensions as coordinates
    // (x^(d+1) = x + 1): low discrepancy without a random generator.
    let mut phi = 1.5_f64;
    for _ in 0..64 {
        phi = (1.0 + phi).powf(1.0 / (count as f64 + 1.0));
    }
    for n in 1..=POSTURES {
        let mut step = 1.0;
        let u = actuation.coordinates.iter().map(|c| {
            step /= phi;
            // The ends of the range matter most: stretch beyond them and clamp.
            let fraction = (0.5 + n as f64 * step).fract() * 1.2 - 0.1;
            // Every other posture stays about the closing motion, where the hand will be.
            let (low, high) = if n % 2 == 0 {
                let span = 0.3 * (c.upper - c.lower);
                (c.open.min(c.closed) - span, c.open.max(c.closed) + span)
            } else {
                (c.lower, c.upper)
            };
            (low + fraction * (high - low)).clamp(c.lower, c.upper)
        });
        out.push(u.collect());
    }
    out
}
