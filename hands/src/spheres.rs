//! Covering collision shapes with few spheres.
//!
//! The optimizer's cost is linear in the spheres, so this looks for few: candidate centres inside the
//! shapes, each with the largest radius that sticks out by at most the tolerance, then a greedy set
//! cover of samples of surface and inside (each must be in, or within the tolerance of, a sphere).
//! No sphere rises above a contact pad by more than [`PAD_CLEARANCE_M`]: a covering that did would keep
//! the pad from ever touching.

use nalgebra::{Isometry3, Point3};

use crate::error::Findings;
use crate::files::{TOML, URDF};
use crate::groups;
use crate::set_cover::{Sample, greedy, prune};
use crate::solid::Solid;
use crate::{CollisionShape, CollisionSphere, Pad, Tree};

/// How far a sphere may rise above a contact pad, metres.
pub(crate) const PAD_CLEARANCE_M: f64 = 0.0005;
/// Sharp edges count as rounded with this many tolerances as their radius: no real part has them, and
/// covering them would take most of the spheres.
const ROUNDING: f64 = 2.0;
/// Samples of one link's surface, about.
const SURFACE_SAMPLES: f64 = 3000.0;
/// Most samples of a link, however its shapes are cut up.
const MOST_SAMPLES: usize = 10_000;
/// Candidate centres inside one shape, at most.
const MOST_CENTRES: usize = 2000;
/// Hands of more shapes than this are sampled more coarsely: the work for a hand is bounded.
const USUAL_SHAPES: usize = 60;
/// Lengths that differ by less are equal, metres.
const HAIR_M: f64 = 1e-9;
/// Most spheres of a hand.
const MOST_SPHERES: usize = 1000;

/// Covers all shapes of a hand, link by link.
pub(crate) fn cover(
    tree: &Tree,
    shapes: &[CollisionShape],
    pads: &[Pad],
    tolerance: f64,
    findings: &mut Findings,
) -> Vec<CollisionSphere> {
    let mut out: Vec<CollisionSphere> = Vec::new();
    let most_centres = MOST_CENTRES * USUAL_SHAPES / shapes.len().max(USUAL_SHAPES);
    for (index, link) in tree.links.iter().enumerate() {
        let mut solids = Vec::new();
        for shape in shapes.iter().filter(|s| s.link == index) {
            match Solid::new(link.body_from_link * shape.link_from_shape, &shape.shape) {
                Some(solid) => solids.push(solid),
                None => findings.error(
                    URDF,
                    format!("link {:?} collision mesh", link.name),
                    "triangles that no solid can be made from",
                    "a triangle mesh",
                ),
            }
        }
        // Pads of the whole body: a fingertip's pad may belong to a link of its own.
        let walls: Vec<Wall> = pads
            .iter()
            .filter(|p| tree.links[p.link].body == link.body)
            .map(|p| Wall::new(p, &tree.links[p.link].body_from_link))
            .collect();
        for (center, radius) in cover_solids(&solids, &walls, tolerance, most_centres) {
            out.push(CollisionSphere { body: link.body, link: index, center, radius });
        }
        if out.len() > MOST_SPHERES {
            findings.error(
                TOML,
                "collision.tolerance_m",
                format!("{tolerance}, for which the hand needs more than {MOST_SPHERES} spheres"),
                "a larger tolerance, or fewer and simpler shapes",
            );
            break;
        }
    }
    out
}

/// A pad as an obstacle for spheres, in the body frame.
struct Wall {
    /// Takes body coordinates to the pad's: x and y along its edges, z outwards.
    pad_from_body: Isometry3<f64>,
    half: [f64; 2],
}

impl Wall {
    fn new(pad: &Pad, body_from_link: &Isometry3<f64>) -> Self {
        let body_from_pad = *body_from_link * pad.frame();
        Self { pad_from_body: body_from_pad.inverse(), half: [pad.half_u.norm(), pad.half_v.norm()] }
    }

    /// Largest radius of a sphere about `center` that does not rise above the pad by more than the clearance.
    fn largest_radius(&self, center: &Point3<f64>) -> f64 {
        let p = self.pad_from_body * center;
        let aside = (p.x.abs() - self.half[0]).max(0.0).hypot((p.y.abs() - self.half[1]).max(0.0));
        aside.hypot((PAD_CLEARANCE_M - p.z).max(0.0))
    }
}

/// Large parts are covered more coarsely: their tolerance grows with the square root of their thickness,
/// up to twice; parts up to [`FINE_M`] thick keep the tolerance as it is.
fn scale(solids: &[Solid<'_>]) -> f64 {
    let thickness = |s: &Solid<'_>| {
        let (low, high) = s.local_bounds();
        (high - low).min()
    };
    let thickest = solids.iter().map(thickness).fold(0.0, f64::max);
    (thickest / FINE_M).sqrt().clamp(1.0, 2.0)
}

/// Thickness of parts that are covered with the tolerance itself, metres: fingers.
const FINE_M: f64 = 0.03;

/// Spheres (centre, radius) that cover the union of solids.
fn cover_solids(
    solids: &[Solid<'_>],
    walls: &[Wall],
    tolerance: f64,
    most_centres: usize,
) -> Vec<(Point3<f64>, f64)> {
    if solids.is_empty() {
        return Vec::new();
    }
    let depth = |p: &Point3<f64>| solids.iter().map(|s| s.depth(p)).fold(f64::NEG_INFINITY, f64::max);
    let tolerance = tolerance * scale(solids);
    let area: f64 = solids.iter().map(Solid::area).sum();
    let spacing = (0.5 * tolerance).max((area / SURFACE_SAMPLES).sqrt());
    // Between samples the surface is up to about half a cell farther away than at them.
    let reach = (tolerance - 0.4 * spacing).max(0.5 * tolerance);

    let mut samples = Vec::new();
    let mut centres = Vec::new();
    for solid in solids {
        let mut surface = solid.surface(spacing);
        let stride = surface.len().div_ceil(MOST_SAMPLES / solids.len()).max(1);
        surface = surface.into_iter().step_by(stride).collect();
        // Samples inside another shape of the link are not surface of the union.
        samples.extend(surface.iter().filter(|p| depth(p) < 0.5 * spacing));
        let grid = solid.grid(0.75 * tolerance, (2 * most_centres / solids.len()).min(most_centres).max(20));
        samples.extend(&grid);
        centres.extend(grid);
        // A sphere about a surface sample always covers that sample: a cover always exists.
        let stride = surface.len() * solids.len() / 600 + 1;
        centres.extend(surface.into_iter().step_by(stride));
    }
    let mut candidates: Vec<(Point3<f64>, f64)> = Vec::with_capacity(centres.len());
    // The largest spheres inside the union about the same centres.
    let mut balls: Vec<(Point3<f64>, f64)> = Vec::with_capacity(centres.len());
    for c in centres {
        let inside = depth(&c);
        let radius = walls.iter().map(|w| w.largest_radius(&c)).fold(inside + tolerance, f64::min);
        if radius > 0.0 {
            candidates.push((c, radius));
            balls.push((c, inside));
        }
    }
    let samples = allow(&samples, balls, reach, ROUNDING * tolerance);
    prune(&samples, greedy(&samples, &candidates))
}

/// How close a sphere must come to each sample: `reach`, and what rounding takes off sharp edges. The
/// samples are sorted into groups.
fn allow(
    samples: &[Point3<f64>],
    mut balls: Vec<(Point3<f64>, f64)>,
    reach: f64,
    rounding: f64,
) -> Vec<Sample> {
    balls.sort_by(|a, b| b.1.total_cmp(&a.1));
    let least = rounding.min(0.8 * balls.first().map_or(0.0, |b| b.1));
    // Balls inside others say nothing: what remains is few, about the middle of the shapes.
    let mut kept: Vec<(Point3<f64>, f64)> = Vec::new();
    for (c, d) in balls.into_iter().take_while(|b| b.1 >= least) {
        let spare = |k: &(Point3<f64>, f64)| k.1 - d + HAIR_M;
        if kept.iter().all(|k| (k.0 - c).norm_squared() > spare(k) * spare(k)) {
            kept.push((c, d));
        }
    }
    let most = 0.75 * rounding;
    let mut out: Vec<Sample> = samples
        .iter()
        .map(|&point| {
            let mut off = most;
            for (center, depth) in &kept {
                let (square, limit) = ((point - center).norm_squared(), off + depth);
                if square < limit * limit {
                    off = square.sqrt() - depth;
                    if off <= 0.0 {
                        break;
                    }
                }
            }
            Sample { point, reach: reach + off.max(0.0) }
        })
        .collect();
    groups::sort(&mut out, |s| s.point);
    out
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::{Shape, library};

    fn shape() -> impl Strategy<Value = Shape> {
        let size = 0.004..0.05_f64;
        prop_oneof![
            [size.clone(), size.clone(), size.clone()]
                .prop_map(|h| Shape::Box { half_extents: Vector3::from(h) }),
            (size.clone(), size.clone())
                .prop_map(|(radius, half_length)| Shape::Cylinder { radius, half_length }),
            size.prop_map(|radius| Shape::Sphere { radius }),
        ]
    }

    fn pose() -> impl Strategy<Value = Isometry3<f64>> {
        ([-0.1..0.1, -0.1..0.1, -0.1..0.1], [-3.0..3.0, -3.0..3.0, -3.0..3.0_f64]).prop_map(
            |(t, r): ([f64; 3], [f64; 3])| {
                Isometry3::from_parts(Translation3::from(t), UnitQuaternion::from_scaled_axis(r.into()))
            },
        )
    }

    /// A box as twelve triangles.
    fn box_mesh(h: Vector3<f64>) -> Shape {
        let vertices = (0..8)
            .map(|i| {
                let side = |bit: i32| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
                Point3::new(side(0) * h.x, side(1) * h.y, side(2) * h.z)
            })
            .collect();
        let triangles = vec![
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ];
        Shape::Mesh { vertices, triangles }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// Points inside are covered to within the tolerance (and the rounding of edges), and no sphere
        /// sticks out by more than the tolerance.
        #[test]
        fn covers_from_within(shape in shape(), pose in pose(), at in prop::collection::vec([-1.0..1.0, -1.0..1.0, -1.0..1.0_f64], 60)) {
            let tolerance = 0.004;
            let solid = Solid::new(pose, &shape).unwrap();
            let (low, high) = solid.local_bounds();
            let solids = [solid];
            let spheres = cover_solids(&solids, &[], tolerance, MOST_CENTRES);
            let scaled = tolerance * scale(&solids);
            prop_assert!(!spheres.is_empty());
            for (center, radius) in &spheres {
                prop_assert!(*radius <= solids[0].depth(center) + scaled + 1e-9);
            }
            for f in at {
                let local = Point3::from((low.coords + high.coords) / 2.0 + (high - low).component_mul(&Vector3::from(f)) / 2.0);
                let p = pose * local;
                if solids[0].depth(&p) < 0.0 {
                    continue;
                }
                let gap = spheres.iter().map(|(c, r)| (p - c).norm() - r).fold(f64::INFINITY, f64::min);
                prop_assert!(gap <= scaled * (1.0 + 0.75 * ROUNDING), "{gap} m uncovered of {shape:?}");
            }
        }

        #[test]
        fn meshes_know_their_inside(h in [0.01..0.05, 0.01..0.05, 0.01..0.05_f64], at in [-0.06..0.06, -0.06..0.06, -0.06..0.06_f64]) {
            let half_extents = Vector3::from(h);
            let mesh = box_mesh(half_extents);
            let (mesh, exact) = (Solid::new(Isometry3::identity(), &mesh).unwrap(), Shape::Box { half_extents });
            let exact = Solid::new(Isometry3::identity(), &exact).unwrap();
            let p = Point3::from(at);
            prop_assert!((mesh.depth(&p) - exact.depth(&p)).abs() < 1e-6);
        }
    }

    #[test]
    fn a_mesh_is_covered_like_the_shape_it_draws() {
        let half_extents = Vector3::new(0.02, 0.012, 0.03);
        let (mesh, exact) = (box_mesh(half_extents), Shape::Box { half_extents });
        let count = |shape: &Shape| {
            cover_solids(&[Solid::new(Isometry3::identity(), shape).unwrap()], &[], 0.004, MOST_CENTRES).len()
        };
        assert!(count(&mesh).abs_diff(count(&exact)) <= 4, "{} and {}", count(&mesh), count(&exact));
    }

    #[test]
    fn no_sphere_rises_above_a_pad_of_its_body() {
        for id in library::ids() {
            let hand = library::hand(id).unwrap();
            for pad in &hand.pads {
                let link = &hand.tree.links[pad.link];
                let normal = link.body_from_link.rotation * pad.normal;
                for candidate in hand.candidates.iter().filter(|c| hand.pads[c.pad].name == pad.name) {
                    // A point a millimetre above the pad is outside every sphere of the body.
                    let above = candidate.point + *normal * 0.001;
                    for sphere in hand.spheres.iter().filter(|s| s.body == link.body) {
                        let out = (sphere.center - above).norm() - sphere.radius;
                        assert!(out > 0.0, "{id}: {} is {out} m inside a sphere", pad.name);
                    }
                }
            }
        }
    }
}
