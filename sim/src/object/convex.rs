//! Convex families: boxes, cylinders, spheres, capsules, cones, superquadrics.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::family::{Check, Solid, between, size};
use super::skin::{Geometry, Grid};
use crate::mesh::Mesh;

/// Rings between the poles of round things.
const RINGS: usize = 11;

/// A box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Edge lengths along x, y and z.
    pub size_m: [f64; 3],
}

impl Solid for Cuboid {
    fn checks(&self) -> Vec<Check> {
        self.size_m.iter().map(|&s| size("size_m", s)).collect()
    }

    fn geometry(&self) -> Geometry {
        Geometry::convex(Mesh::cuboid(Vector3::from(self.size_m) / 2.0))
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        // One side fits between the fingers of a gripper; the others are free.
        let narrow = between(rng, 0.03, 0.065);
        let [second, third] = [between(rng, 0.03, 0.10), between(rng, 0.04, 0.16)];
        let mut size_m = [narrow, second, third];
        // Standing on a small face is rare.
        if rng.random_bool(0.6) {
            size_m = [third, narrow, second];
        }
        Self { size_m }
    }

    fn density() -> (f64, f64) {
        (150.0, 1000.0)
    }
}

/// A cylinder around z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cylinder {
    /// Radius.
    pub radius_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Cylinder {
    fn checks(&self) -> Vec<Check> {
        vec![size("radius_m", self.radius_m), size("height_m", self.height_m)]
    }

    fn geometry(&self) -> Geometry {
        frustum(self.radius_m, self.radius_m, self.height_m)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.016, 0.036), height_m: between(rng, 0.05, 0.14) }
    }

    fn density() -> (f64, f64) {
        (300.0, 1100.0)
    }
}

/// A cone without its tip around z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frustum {
    /// Radius of the lower face.
    pub bottom_radius_m: f64,
    /// Radius of the upper face.
    pub top_radius_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Frustum {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("bottom_radius_m", self.bottom_radius_m),
            size("top_radius_m", self.top_radius_m),
            size("height_m", self.height_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        frustum(self.bottom_radius_m, self.top_radius_m, self.height_m)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let bottom_radius_m = between(rng, 0.025, 0.042);
        Self {
            bottom_radius_m,
            top_radius_m: bottom_radius_m * between(rng, 0.15, 0.8),
            height_m: between(rng, 0.05, 0.12),
        }
    }

    fn density() -> (f64, f64) {
        (200.0, 1000.0)
    }
}

fn frustum(bottom: f64, top: f64, height: f64) -> Geometry {
    let h = height / 2.0;
    let grid = Grid::revolve(&[[bottom, -h], [top, h]]);
    let mesh = grid.capped(Point3::new(0.0, 0.0, -h), Point3::new(0.0, 0.0, h));
    Geometry { mesh, parts: vec![grid.slice(0..=1)] }
}

/// A sphere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ball {
    /// Radius.
    pub radius_m: f64,
}

impl Solid for Ball {
    fn checks(&self) -> Vec<Check> {
        vec![size("radius_m", self.radius_m)]
    }

    fn geometry(&self) -> Geometry {
        superquadric([self.radius_m; 3], 1.0, 1.0)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.018, 0.038) }
    }

    fn density() -> (f64, f64) {
        (150.0, 1000.0)
    }
}

/// A capsule along x.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Capsule {
    /// Radius.
    pub radius_m: f64,
    /// Length of the cylinder between the half spheres.
    pub length_m: f64,
}

impl Solid for Capsule {
    fn checks(&self) -> Vec<Check> {
        vec![size("radius_m", self.radius_m), size("length_m", self.length_m)]
    }

    fn geometry(&self) -> Geometry {
        let (r, l) = (self.radius_m, self.length_m / 2.0);
        let mut profile = Vec::new();
        for end in [-1.0, 1.0] {
            for i in 0..=5 {
                // From the pole's neighbour to the equator, and from the equator to the other's.
                let latitude = FRAC_PI_2 * f64::from(if end < 0.0 { i - 5 } else { i }) / 6.0;
                profile.push([r * latitude.cos(), end * l + r * latitude.sin()]);
            }
        }
        let mesh =
            Grid::revolve(&profile).capped(Point3::new(0.0, 0.0, -l - r), Point3::new(0.0, 0.0, l + r));
        // Lay it down: x takes the axis' place.
        Geometry::convex(mesh).map(|p| Point3::new(p.z, p.y, -p.x))
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.015, 0.03), length_m: between(rng, 0.03, 0.11) }
    }

    fn density() -> (f64, f64) {
        (200.0, 1000.0)
    }
}

/// A superquadric: |x/a|^(2/e) + |y/b|^(2/e) to the power e/n, plus |z/c|^(2/n), is 1.
/// Exponents near 0 give boxes, 1 ellipsoids, 2 double pyramids.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Superquadric {
    /// Half sizes along x, y and z.
    pub half_m: [f64; 3],
    /// Exponent n of the vertical section.
    pub vertical: f64,
    /// Exponent e of the horizontal section.
    pub horizontal: f64,
}

impl Solid for Superquadric {
    fn checks(&self) -> Vec<Check> {
        let mut checks: Vec<_> = self.half_m.iter().map(|&s| size("half_m", s)).collect();
        // Beyond 2 it is not convex; near 0 neighbouring points fall together.
        checks.extend([("vertical", self.vertical, 0.1, 2.0), ("horizontal", self.horizontal, 0.1, 2.0)]);
        checks
    }

    fn geometry(&self) -> Geometry {
        superquadric(self.half_m, self.vertical, self.horizontal)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self {
            half_m: [between(rng, 0.025, 0.06), between(rng, 0.018, 0.034), between(rng, 0.016, 0.034)],
            vertical: between(rng, 0.25, 1.3),
            horizontal: between(rng, 0.25, 1.3),
        }
    }

    fn density() -> (f64, f64) {
        (200.0, 1000.0)
    }
}

fn superquadric([a, b, c]: [f64; 3], vertical: f64, horizontal: f64) -> Geometry {
    let power = |x: f64, e: f64| x.signum() * x.abs().powf(e);
    // cos(π/2) is not quite zero, and a small power of nearly zero is far from it.
    let exact = |x: f64| if x.abs() < 1e-12 { 0.0 } else { x };
    let grid = Grid::around(RINGS, |ring, angle| {
        let latitude = PI * (ring + 1) as f64 / (RINGS + 1) as f64 - FRAC_PI_2;
        let (cos, sin) = (power(exact(latitude.cos()), vertical), power(exact(latitude.sin()), vertical));
        Point3::new(
            a * cos * power(exact(angle.cos()), horizontal),
            b * cos * power(exact(angle.sin()), horizontal),
            c * sin,
        )
    });
    Geometry::convex(grid.capped(Point3::new(0.0, 0.0, -c), Point3::new(0.0, 0.0, c)))
}
