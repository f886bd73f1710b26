//! Revolved profiles: cans, bottles, cups, bowls.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Point3;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::family::{Check, Solid, between, size};
use super::skin::{Geometry, Grid, TURN};

/// Convex pieces around a hollow wall: the hollow loses 3.4 % of its radius between two corners.
const WALL_PIECES: usize = 12;

/// A can: a cylinder with bevelled edges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Can {
    /// Radius.
    pub radius_m: f64,
    /// Height.
    pub height_m: f64,
    /// Width and height of the bevel at both ends.
    pub bevel_m: f64,
}

impl Solid for Can {
    fn checks(&self) -> Vec<Check> {
        let most = self.radius_m.min(self.height_m / 2.0) * 0.9;
        vec![
            size("radius_m", self.radius_m),
            size("height_m", self.height_m),
            ("bevel_m", self.bevel_m, 0.0001, most),
        ]
    }

    fn geometry(&self) -> Geometry {
        let (r, h, b) = (self.radius_m, self.height_m, self.bevel_m);
        solid(&[[r - b, 0.0], [r, b], [r, h - b], [r - b, h]], &[])
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.026, 0.04), height_m: between(rng, 0.06, 0.13), bevel_m: 0.003 }
    }

    fn density() -> (f64, f64) {
        (150.0, 1050.0)
    }
}

/// A bottle, filled and closed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bottle {
    /// Radius of the body.
    pub body_radius_m: f64,
    /// Height of the body up to the shoulder.
    pub body_height_m: f64,
    /// Height of the shoulder.
    pub shoulder_height_m: f64,
    /// Radius of the neck.
    pub neck_radius_m: f64,
    /// Height of the neck.
    pub neck_height_m: f64,
}

impl Solid for Bottle {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("body_radius_m", self.body_radius_m),
            size("body_height_m", self.body_height_m),
            size("shoulder_height_m", self.shoulder_height_m),
            ("neck_radius_m", self.neck_radius_m, 0.0005, self.body_radius_m * 0.95),
            size("neck_height_m", self.neck_height_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        const SHOULDER: usize = 5;
        let (r, h) = (self.body_radius_m, self.body_height_m);
        let mut profile = vec![[r, 0.0]];
        // A quarter of an ellipse from the body's side to the neck's foot.
        for i in 0..=SHOULDER {
            let angle = FRAC_PI_2 * i as f64 / SHOULDER as f64;
            profile.push([
                self.neck_radius_m + (r - self.neck_radius_m) * angle.cos(),
                h + self.shoulder_height_m * angle.sin(),
            ]);
        }
        profile.push([self.neck_radius_m, h + self.shoulder_height_m + self.neck_height_m]);
        solid(&profile, &[SHOULDER + 1])
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let body_radius_m = between(rng, 0.026, 0.038);
        Self {
            body_radius_m,
            body_height_m: between(rng, 0.06, 0.11),
            shoulder_height_m: between(rng, 0.015, 0.035),
            neck_radius_m: body_radius_m * between(rng, 0.35, 0.6),
            neck_height_m: between(rng, 0.015, 0.03),
        }
    }

    fn density() -> (f64, f64) {
        (120.0, 1000.0)
    }
}

/// A solid of revolution, cut into convex parts at some rings of its profile.
fn solid(profile: &[[f64; 2]], cuts: &[usize]) -> Geometry {
    let grid = Grid::revolve(profile);
    let last = profile.len() - 1;
    let mesh = grid.capped(Point3::new(0.0, 0.0, profile[0][1]), Point3::new(0.0, 0.0, profile[last][1]));
    let ends = cuts.iter().copied().chain([last]);
    let parts = ends.scan(0, |from, to| Some(grid.slice(std::mem::replace(from, to)..=to))).collect();
    Geometry { mesh, parts }
}

/// A cup without a handle, hollow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cup {
    /// Outer radius at the foot.
    pub bottom_radius_m: f64,
    /// Outer radius at the rim.
    pub top_radius_m: f64,
    /// Height.
    pub height_m: f64,
    /// Thickness of wall and floor.
    pub wall_m: f64,
}

impl Solid for Cup {
    fn checks(&self) -> Vec<Check> {
        let narrowest = self.bottom_radius_m.min(self.top_radius_m).min(self.height_m);
        vec![
            size("bottom_radius_m", self.bottom_radius_m),
            size("top_radius_m", self.top_radius_m),
            size("height_m", self.height_m),
            ("wall_m", self.wall_m, 0.0005, narrowest * 0.8),
        ]
    }

    fn geometry(&self) -> Geometry {
        let radius =
            |z: f64| self.bottom_radius_m + (self.top_radius_m - self.bottom_radius_m) * z / self.height_m;
        let levels = [0.0, self.wall_m, self.height_m].map(|z| [radius(z), z]);
        vessel(&levels, self.wall_m, 1)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let bottom_radius_m = between(rng, 0.026, 0.034);
        Self {
            bottom_radius_m,
            top_radius_m: bottom_radius_m * between(rng, 1.0, 1.3),
            height_m: between(rng, 0.06, 0.11),
            wall_m: between(rng, 0.002, 0.004),
        }
    }

    fn density() -> (f64, f64) {
        (900.0, 2400.0)
    }
}

/// A bowl, hollow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bowl {
    /// Outer radius at the foot.
    pub foot_radius_m: f64,
    /// Outer radius at the rim.
    pub rim_radius_m: f64,
    /// Height.
    pub height_m: f64,
    /// Thickness of wall and floor.
    pub wall_m: f64,
}

impl Solid for Bowl {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("rim_radius_m", self.rim_radius_m),
            ("foot_radius_m", self.foot_radius_m, 0.001, self.rim_radius_m),
            size("height_m", self.height_m),
            ("wall_m", self.wall_m, 0.0005, self.foot_radius_m.min(self.height_m) * 0.5),
        ]
    }

    fn geometry(&self) -> Geometry {
        const LEVELS: usize = 6;
        let (h, b) = (self.height_m, self.wall_m);
        // A quarter of an ellipse from the foot's edge to the upright rim.
        let radius = |z: f64| {
            let s = 1.0 - z / h;
            self.foot_radius_m + (self.rim_radius_m - self.foot_radius_m) * (1.0 - s * s).max(0.0).sqrt()
        };
        let mut levels = vec![[self.foot_radius_m, 0.0]];
        levels.extend((0..=LEVELS).map(|i| {
            // Even in the ellipse's angle: closer together where it runs flat, near the foot.
            let share = 1.0 - (FRAC_PI_2 * i as f64 / LEVELS as f64).cos();
            let z = b + (h - b) * share;
            [radius(z), z]
        }));
        vessel(&levels, b, 2)
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let rim_radius_m = between(rng, 0.05, 0.075);
        Self {
            foot_radius_m: rim_radius_m * between(rng, 0.4, 0.55),
            rim_radius_m,
            height_m: between(rng, 0.035, 0.06),
            wall_m: between(rng, 0.003, 0.005),
        }
    }

    fn density() -> (f64, f64) {
        (900.0, 2400.0)
    }
}

/// A hollow, open vessel: `levels` are outer radii and heights from the foot up, the second of them the
/// floor's upper side; `step` levels of the wall make a convex part.
pub(super) fn vessel(levels: &[[f64; 2]], wall: f64, step: usize) -> Geometry {
    let last = levels.len() - 1;
    let mut profile = levels.to_vec();
    // Down the inside, from the rim to the floor.
    profile.extend(levels[1..].iter().rev().map(|&[r, z]| [r - wall, z]));
    let grid = Grid::revolve(&profile);
    let floor = levels[1][1];
    let mesh = grid.capped(Point3::new(0.0, 0.0, levels[0][1]), Point3::new(0.0, 0.0, floor));
    let mut parts = vec![grid.slice(0..=1)];
    let corners = TURN / WALL_PIECES;
    for low in (1..last).step_by(step) {
        let high = (low + step).min(last);
        let inner = |level: usize| 2 * last + 1 - level;
        for k in (0..TURN).step_by(corners) {
            let mut part = grid.patch(low..=high, k..=k + corners);
            part.extend(grid.patch(inner(high)..=inner(low), k..=k + corners));
            parts.push(part);
        }
    }
    Geometry { mesh, parts }
}
