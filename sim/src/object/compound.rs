//! Compounds: mugs with handles, hammers, L and T pieces, rings.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Point3;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::convex::Cylinder;
use super::family::{Check, Solid, between, size};
use super::revolved::vessel;
use super::skin::{Geometry, Grid, TURN, bar, box_corners, prism};

/// A mug: a hollow cylinder with a bent handle towards +x.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mug {
    /// Outer radius.
    pub radius_m: f64,
    /// Height.
    pub height_m: f64,
    /// Thickness of wall and floor.
    pub wall_m: f64,
    /// How far the handle's middle line stands off the wall.
    pub handle_reach_m: f64,
    /// Height of the handle's middle line.
    pub handle_height_m: f64,
    /// Radius of the handle's round bar.
    pub handle_radius_m: f64,
}

impl Solid for Mug {
    fn checks(&self) -> Vec<Check> {
        let bar = self.handle_radius_m;
        vec![
            size("radius_m", self.radius_m),
            size("height_m", self.height_m),
            ("wall_m", self.wall_m, 0.0005, self.radius_m.min(self.height_m) * 0.5),
            ("handle_radius_m", bar, 0.0005, self.radius_m * 0.25),
            ("handle_reach_m", self.handle_reach_m, 2.0 * bar, 1.0),
            ("handle_height_m", self.handle_height_m, 4.0 * bar, self.height_m - 2.0 * bar),
        ]
    }

    fn geometry(&self) -> Geometry {
        const STEPS: usize = 12;
        const PIECES: usize = 6;
        let (r, h, wall) = (self.radius_m, self.height_m, self.wall_m);
        let mut mug = vessel(&[[r, 0.0], [r, wall], [r, h]], wall, 1);
        // Half an ellipse whose ends stand in the middle of the wall.
        let foot = r - wall / 2.0;
        let path: Vec<_> = (0..=STEPS)
            .map(|i| {
                let angle = FRAC_PI_2 - PI * i as f64 / STEPS as f64;
                let reach = self.handle_reach_m + wall / 2.0;
                [foot + reach * angle.cos(), h / 2.0 + self.handle_height_m / 2.0 * angle.sin()]
            })
            .collect();
        mug.join(bar(&path, self.handle_radius_m, PIECES));
        mug
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        let height_m = between(rng, 0.07, 0.10);
        Self {
            radius_m: between(rng, 0.03, 0.04),
            height_m,
            wall_m: between(rng, 0.003, 0.005),
            handle_reach_m: between(rng, 0.022, 0.032),
            handle_height_m: height_m * between(rng, 0.5, 0.65),
            handle_radius_m: between(rng, 0.004, 0.006),
        }
    }

    fn density() -> (f64, f64) {
        (1200.0, 2400.0)
    }
}

/// A hammer that lies: handle along x, head along y at its +x end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hammer {
    /// Radius of the handle.
    pub handle_radius_m: f64,
    /// Length of the handle up to the head's axis.
    pub handle_length_m: f64,
    /// Radius of the head.
    pub head_radius_m: f64,
    /// Length of the head.
    pub head_length_m: f64,
}

impl Solid for Hammer {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("head_radius_m", self.head_radius_m),
            ("handle_radius_m", self.handle_radius_m, 0.0005, self.head_radius_m * 0.95),
            ("handle_length_m", self.handle_length_m, self.head_radius_m * 1.1, 1.0),
            ("head_length_m", self.head_length_m, self.handle_radius_m * 2.0, 1.0),
        ]
    }

    fn geometry(&self) -> Geometry {
        let cylinder = |radius_m, height_m| Cylinder { radius_m, height_m }.geometry();
        let length = self.handle_length_m;
        // Both are turned, not mirrored: z to x, and z to y.
        let mut hammer =
            cylinder(self.handle_radius_m, length).map(|p| Point3::new(p.z - length / 2.0, p.y, -p.x));
        hammer.join(cylinder(self.head_radius_m, self.head_length_m).map(|p| Point3::new(p.y, p.z, p.x)));
        hammer
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self {
            handle_radius_m: between(rng, 0.009, 0.014),
            handle_length_m: between(rng, 0.12, 0.17),
            head_radius_m: between(rng, 0.016, 0.022),
            head_length_m: between(rng, 0.06, 0.09),
        }
    }

    fn density() -> (f64, f64) {
        (700.0, 2500.0)
    }
}

/// An L-shaped piece that lies: two legs from one corner, along x and y.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ell {
    /// Outer lengths of the legs along x and y.
    pub legs_m: [f64; 2],
    /// Width of the legs.
    pub width_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Ell {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("legs_m", self.legs_m[0]),
            size("legs_m", self.legs_m[1]),
            ("width_m", self.width_m, 0.0005, self.legs_m[0].min(self.legs_m[1]) * 0.95),
            size("height_m", self.height_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        let ([a, b], w, h) = (self.legs_m, self.width_m, self.height_m / 2.0);
        let polygon = [[w, w], [w, b], [0.0, b], [0.0, 0.0], [a, 0.0], [a, w]];
        // Every corner is seen from the inner one.
        let cap = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
        let parts = vec![box_corners([0.0, 0.0, -h], [a, w, h]), box_corners([0.0, w, -h], [w, b, h])];
        Geometry { mesh: prism(&polygon, &cap, self.height_m), parts }
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self {
            legs_m: [between(rng, 0.07, 0.14), between(rng, 0.06, 0.11)],
            width_m: between(rng, 0.02, 0.035),
            height_m: between(rng, 0.025, 0.05),
        }
    }

    fn density() -> (f64, f64) {
        (300.0, 1200.0)
    }
}

/// A T-shaped piece that lies: a bar along x, a stem from its middle along −y.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tee {
    /// Length of the bar.
    pub bar_m: f64,
    /// Length of the stem below the bar.
    pub stem_m: f64,
    /// Width of bar and stem.
    pub width_m: f64,
    /// Height.
    pub height_m: f64,
}

impl Solid for Tee {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("bar_m", self.bar_m),
            size("stem_m", self.stem_m),
            ("width_m", self.width_m, 0.0005, self.bar_m * 0.95),
            size("height_m", self.height_m),
        ]
    }

    fn geometry(&self) -> Geometry {
        let (x, s, w, l, h) =
            (self.bar_m / 2.0, self.width_m / 2.0, self.width_m, self.stem_m, self.height_m / 2.0);
        let polygon = [[-s, -l], [s, -l], [s, 0.0], [x, 0.0], [x, w], [-x, w], [-x, 0.0], [-s, 0.0]];
        let cap = [[0, 1, 2], [0, 2, 7], [2, 3, 4], [2, 4, 5], [2, 5, 7], [7, 5, 6]];
        let parts = vec![box_corners([-x, 0.0, -h], [x, w, h]), box_corners([-s, -l, -h], [s, 0.0, h])];
        Geometry { mesh: prism(&polygon, &cap, self.height_m), parts }
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self {
            bar_m: between(rng, 0.07, 0.13),
            stem_m: between(rng, 0.04, 0.09),
            width_m: between(rng, 0.02, 0.035),
            height_m: between(rng, 0.025, 0.05),
        }
    }

    fn density() -> (f64, f64) {
        (300.0, 1200.0)
    }
}

/// A round ring (torus) around z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ring {
    /// Radius of the tube's middle line.
    pub radius_m: f64,
    /// Radius of the tube.
    pub tube_radius_m: f64,
}

impl Solid for Ring {
    fn checks(&self) -> Vec<Check> {
        vec![
            size("radius_m", self.radius_m),
            ("tube_radius_m", self.tube_radius_m, 0.0005, self.radius_m * 0.9),
        ]
    }

    fn geometry(&self) -> Geometry {
        const TUBE: usize = 12;
        const PIECES: usize = 12;
        let profile: Vec<_> = (0..TUBE)
            .map(|i| {
                let angle = TAU * i as f64 / TUBE as f64;
                [self.radius_m + self.tube_radius_m * angle.cos(), self.tube_radius_m * angle.sin()]
            })
            .collect();
        let grid = Grid::revolve(&profile);
        let corners = TURN / PIECES;
        let parts = (0..PIECES).map(|k| grid.patch(0..=TUBE - 1, k * corners..=(k + 1) * corners)).collect();
        Geometry { mesh: grid.looped(), parts }
    }

    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self {
        Self { radius_m: between(rng, 0.028, 0.05), tube_radius_m: between(rng, 0.008, 0.014) }
    }

    fn density() -> (f64, f64) {
        (400.0, 1200.0)
    }
}
