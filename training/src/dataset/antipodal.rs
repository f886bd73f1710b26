//! Pairs of contacts on an object between which a parallel jaw is in force closure.

use graspd_sim::mesh::Mesh;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::lines::{Lines, Span};
use super::recipe::Recipe;
use crate::evaluate::ap::{Contact, MAX_WIDTH_M, worst_angle};

/// Steps between friction coefficients, as in the grasp benchmark's labels.
const FRICTION_STEP: f64 = 0.1;
/// Score of a grasp that would need no friction; the reference implementation's 1.1 − μ.
const BEST_SCORE: f64 = 1.1;
/// How near a solid part must begin to the place on the surface, metres.
const AT_PLACE_M: f64 = 1e-6;
/// Thinner than this nothing is held, metres.
const LEAST_WIDTH_M: f64 = 0.001;

/// Two contacts that face each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Left and right: the jaw closes from each to the other. With outward normals.
    pub contacts: [Contact; 2],
    /// From left to right.
    pub closing: Unit<Vector3<f64>>,
    /// Distance between both, metres.
    pub width_m: f64,
    /// 1.1 less the least friction coefficient, in steps of 0.1, with which both are in force closure.
    pub score: f64,
}

impl Pair {
    /// The pair where its object stands.
    pub fn at(&self, pose: &Isometry3<f64>) -> Self {
        let contacts = self.contacts.map(|(point, normal)| (pose * point, pose.rotation * normal));
        Self { contacts, closing: pose.rotation * self.closing, ..*self }
    }

    /// Half-way between both contacts.
    pub fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.contacts[0].0, &self.contacts[1].0)
    }
}

/// Pairs on a mesh, in its frame. From places evenly spread over the surface a jaw closes along the normal, and along the
/// middle between both contacts' normals, whichever needs less friction; across walls (of a cup) and across the whole.
pub(crate) fn pairs(mesh: &Mesh, lines: &Lines, recipe: &Recipe, rng: &mut Xoshiro256PlusPlus) -> Vec<Pair> {
    let mut total = 0.0;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            total += 0.5 * (b - a).cross(&(c - a)).norm();
            total
        })
        .collect();
    let places = (total * 1e4 * recipe.places_per_cm2) as usize;
    let places = places.clamp(recipe.places[0], recipe.places[1]);
    let mut found = Vec::new();
    for _ in 0..places {
        let at = rng.random::<f64>() * total;
        let triangle = areas.partition_point(|&sum| sum <= at);
        if triangle >= areas.len() {
            continue;
        }
        let [a, b, c] = mesh.corners(triangle);
        let (u, v) = (rng.random::<f64>(), rng.random::<f64>());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let place = a + (b - a) * u + (c - a) * v;
        if let Some(normal) = Unit::try_new((b - a).cross(&(c - a)), 1e-18) {
            try_place(&place, &normal, lines, recipe, rng, &mut found);
        }
    }
    found
}

/// Pairs with one contact at a place of the surface.
fn try_place(
    place: &Point3<f64>,
    normal: &Unit<Vector3<f64>>,
    lines: &Lines,
    recipe: &Recipe,
    rng: &mut Xoshiro256PlusPlus,
    found: &mut Vec<Pair>,
) {
    let straight = near(&-normal.into_inner(), recipe.closing_deg, rng);
    let along_normal = spans_from(lines, place, &straight, recipe);
    let all = along_normal.len();
    // Across the wall at hand, and across all that fits.
    let ends = [0, all.saturating_sub(1)];
    for &end in &ends[..all.min(2)] {
        let first = pair(place, &straight, &along_normal, end);
        let middle = Unit::try_new(along_normal[end].to.normal.into_inner() - normal.into_inner(), 1e-6);
        let second = middle.and_then(|middle| {
            let closing = near(&middle, recipe.closing_deg, rng);
            pair(place, &closing, &spans_from(lines, place, &closing, recipe), end)
        });
        let best = [first, second].into_iter().flatten().max_by(|a, b| a.score.total_cmp(&b.score));
        found.extend(best.filter(|p| p.score > BEST_SCORE - recipe.max_friction - 1e-9));
    }
}

/// A direction near another: off by a normal distribution of this deviation about both axes across.
fn near(direction: &Vector3<f64>, deviation_deg: f64, rng: &mut Xoshiro256PlusPlus) -> Unit<Vector3<f64>> {
    let across = across(direction);
    let deviation = deviation_deg.to_radians().tan();
    let [x, y]: [f64; 2] = [0, 1].map(|_| StandardNormal.sample(rng));
    Unit::new_normalize(direction + (across[0] * x + across[1] * y) * deviation)
}

/// Two unit vectors across a unit vector and across each other: with it they are right-handed.
pub(crate) fn across(z: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let other = if z.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let x = other.cross(z).normalize();
    [x, z.cross(&x)]
}

/// The solid part that begins at `place`, and those behind it that a jaw can still reach around.
fn spans_from(
    lines: &Lines,
    place: &Point3<f64>,
    closing: &Unit<Vector3<f64>>,
    recipe: &Recipe,
) -> Vec<Span> {
    let widest_m = MAX_WIDTH_M - 2.0 * recipe.clearance_m[1];
    let mut spans = lines.spans(place, closing);
    let Some(start) = spans.iter().position(|s| s.from.at_m.abs() < AT_PLACE_M) else { return Vec::new() };
    spans.drain(..start);
    spans.retain(|s| s.to.at_m <= widest_m);
    spans
}

/// The pair from a place to the end of a solid part; `None` for one that is too thin or holds at no friction.
fn pair(place: &Point3<f64>, closing: &Unit<Vector3<f64>>, spans: &[Span], end: usize) -> Option<Pair> {
    let (from, to) = (spans.first()?.from, spans.get(end)?.to);
    if to.at_m < LEAST_WIDTH_M {
        return None;
    }
    let contacts = [(*place, from.normal), (place + closing.into_inner() * to.at_m, to.normal)];
    let friction = worst_angle(&contacts)?.tan();
    let level = (friction / FRICTION_STEP - 1e-6).ceil().max(1.0) * FRICTION_STEP;
    Some(Pair { contacts, closing: *closing, width_m: to.at_m, score: BEST_SCORE - level })
}

#[cfg(test)]
mod tests {
    use graspd_sim::object::{Kind, Object};
    use rand::SeedableRng;

    use super::*;

    fn pairs_on(mesh: &Mesh, recipe: &Recipe) -> Vec<Pair> {
        pairs(mesh, &Lines::new(mesh), recipe, &mut Xoshiro256PlusPlus::seed_from_u64(1))
    }

    #[test]
    fn pairs_on_a_box_are_on_opposite_faces_and_need_little_friction() {
        let half = Vector3::new(0.02, 0.03, 0.1);
        let found = pairs_on(&Mesh::cuboid(half), &Recipe::default());
        assert!(found.len() > 100, "{}", found.len());
        for pair in &found {
            let [(a, n), (b, m)] = pair.contacts;
            assert!((n.into_inner() + m.into_inner()).norm() < 1e-9, "{pair:?}");
            let axis = n.iamax();
            // Twenty centimetres are too wide for the jaw.
            assert_ne!(axis, 2);
            assert!((a[axis].abs() - half[axis]).abs() < 1e-9 && (b[axis].abs() - half[axis]).abs() < 1e-9);
            assert!((pair.width_m - (b - a).norm()).abs() < 1e-9);
            assert!(pair.closing.dot(&n) < 0.0 && pair.closing.dot(&m) > 0.0);
            // 3° of deviation: most within tan⁻¹ 0.1.
            assert!(pair.score > 0.69);
        }
        let best = found.iter().filter(|p| p.score > 0.99).count();
        assert!(2 * best > found.len(), "{best} of {}", found.len());
    }

    #[test]
    fn scores_are_what_the_geometry_asks_for() {
        // A wedge: sides 12° off the vertical, so that a level line meets both at 12°: friction 0.21, score 0.8.
        let slope = 12f64.to_radians().tan();
        let at = |x: f64, y: f64, z: f64| Point3::new(x * (0.03 - z * slope), y, z);
        let mut mesh = Mesh::cuboid(Vector3::repeat(1.0));
        for v in &mut mesh.vertices {
            *v = at(v.x, v.y * 0.02, v.z * 0.03);
        }
        let recipe = Recipe { closing_deg: 0.0, ..Recipe::default() };
        let found = pairs_on(&mesh, &recipe);
        let across: Vec<_> = found.iter().filter(|p| p.closing.x.abs() > 0.9).collect();
        assert!(across.len() > 20);
        assert!(across.iter().all(|p| (p.score - 0.8).abs() < 1e-9), "{across:?}");
    }

    #[test]
    fn a_cup_is_held_by_its_wall_and_around_the_whole() {
        let cup = (0..20).map(|seed| Object::sample(Kind::Cup, seed)).find(|o| {
            let (low, high) = o.mesh.bounds().unwrap();
            (high - low).xy().amax() < 0.1
        });
        let found = pairs_on(&cup.unwrap().mesh, &Recipe::default());
        let level = |p: &&Pair| p.closing.z.abs() < 0.3;
        assert!(found.iter().filter(level).any(|p| p.width_m < 0.015));
        assert!(found.iter().filter(level).any(|p| p.width_m > 0.03));
    }
}
