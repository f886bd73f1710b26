//! Thin plates and small parts: plates, discs, nuts, pegs, blocks.

use std::f64::consts::FRAC_PI_3;

use nalgebra::Point3;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::convex::{Cuboid, Cylinder};
use super::family::{Check, Solid, between, size};
use super::skin::{Geometry, Grid, TURN};

/// A thin rectangular plate that lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// Edge lengths along x and y.
    pub size_m: [f64; 2],
    /// Thickness.
    pub thickness_m: f64,
}

impl Solid for Plate {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("size_m", self.size_m[0]),
            size("size_m", self.size_m[1]),
            size("thickness_m", self.thickness_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        Cuboid { size_m: [self.size_m[0], self.size_m[1], self.thickness_m] }.geometry()
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self {
            size_m: [between(rng, 0.07, 0.15), between(rng, 0.035, 0.065)],
            thickness_m: between(rng, 0.006, 0.015),
        }
    }

    fn density() -> (f64, f64) {
        (500.0, 1800.0)
    }
}

/// A thin round plate that lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disc {
    /// Radius.
    pub radius_m: f64,
    /// Thickness.
    pub thickness_m: f64,
}

impl Solid for Disc {
    fn checks(&self) -> Vec<Check> {
        vec![size("radius_m", self.radius_m), size("thickness_m", self.thickness_m)]
    }

    fn geometry(&self) -> Geometry {
        Cylinder { radius_m: self.radius_m, height_m: self.thickness_m }.geometry()
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.022, 0.038), thickness_m: between(rng, 0.008, 0.016) }
    }

    fn density() -> (f64, f64) {
        (800.0, 2500.0)
    }
}

/// A hexagonal nut around z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Nut {
    /// Distance of opposite faces.
    pub across_flats_m: f64,
    /// Radius of the hole.
    pub hole_radius_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Nut {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("across_flats_m", self.across_flats_m),
            ("hole_radius_m", self.hole_radius_m, 0.0002, self.across_flats_m * 0.45),
            size("height_m", self.height_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        const SIDES: usize = 6;
        let h = self.height_m / 2.0;
        // Outside below, outside above, hole above, hole below.
        let grid = Grid::around(4, |ring, angle| {
            let from_flat = (angle % FRAC_PI_3) - FRAC_PI_3 / 2.0;
            let flat = self.across_flats_m / 2.0 / from_flat.cos();
            let r = if ring < 2 { flat } else { self.hole_radius_m };
            let z = if ring == 0 || ring == 3 { -h } else { h };
            Point3::new(r * angle.cos(), r * angle.sin(), z)
        });
        let corners = TURN / SIDES;
        let parts = (0..SIDES).map(|k| grid.patch(0..=3, k * corners..=(k + 1) * corners)).collect();
        Geometry { mesh: grid.looped(), parts }
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let across_flats_m = between(rng, 0.03, 0.045);
        Self {
            across_flats_m,
            hole_radius_m: across_flats_m * between(rng, 0.24, 0.32),
            height_m: between(rng, 0.018, 0.03),
        }
    }

    fn density() -> (f64, f64) {
        (1500.0, 7800.0)
    }
}

/// A small pin around z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Peg {
    /// Radius.
    pub radius_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Peg {
    fn checks(&self) -> Vec<Check> {
        vec![size("radius_m", self.radius_m), size("height_m", self.height_m)]
    }

    fn geometry(&self) -> Geometry {
        Cylinder { radius_m: self.radius_m, height_m: self.height_m }.geometry()
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.009, 0.015), height_m: between(rng, 0.035, 0.05) }
    }

    fn density() -> (f64, f64) {
        (900.0, 3000.0)
    }
}

/// A small building block.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Edge lengths along x, y and z.
    pub size_m: [f64; 3],
}

impl Solid for Block {
    fn checks(&self) -> Vec<Check> {
        self.size_m.iter().map(|&s| size("size_m", s)).collect()
    }

    fn geometry(&self) -> Geometry {
        Cuboid { size_m: self.size_m }.geometry()
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { size_m: [between(rng, 0.03, 0.05), between(rng, 0.025, 0.04), between(rng, 0.025, 0.04)] }
    }

    fn density() -> (f64, f64) {
        (500.0, 1500.0)
    }
}
