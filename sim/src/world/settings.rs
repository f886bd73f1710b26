//! What a world is made of before anything is put into it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A tray on the table: four walls around a rectangle centred on the world's origin; its floor is the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tray {
    /// Inner width along x, metres.
    pub width_m: f64,
    /// Inner length along y, metres.
    pub length_m: f64,
    /// Height of the walls, metres.
    pub height_m: f64,
    /// Thickness of the walls, metres.
    pub wall_m: f64,
}

impl Default for Tray {
    /// A flat tray that fits the planner's 0.4 m workspace.
    fn default() -> Self {
        Self { width_m: 0.36, length_m: 0.36, height_m: 0.03, wall_m: 0.008 }
    }
}

impl Tray {
    /// Centre and half extents of the four walls, world frame.
    pub fn walls(&self) -> [(Vector3<f64>, Vector3<f64>); 4] {
        let (x, y, z, t) = (self.width_m / 2.0, self.length_m / 2.0, self.height_m / 2.0, self.wall_m / 2.0);
        let along_y = Vector3::new(t, y + 2.0 * t, z);
        let along_x = Vector3::new(x + 2.0 * t, t, z);
        [
            (Vector3::new(x + t, 0.0, z), along_y),
            (Vector3::new(-x - t, 0.0, z), along_y),
            (Vector3::new(0.0, y + t, z), along_x),
            (Vector3::new(0.0, -y - t, z), along_x),
        ]
    }
}

/// Constants of a world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldSettings {
    /// Length of a step, seconds.
    pub dt_s: f64,
    /// Iterations of the contact solver in a step.
    pub solver_iterations: usize,
    /// Acceleration towards −z, metres per second squared.
    pub gravity: f64,
    /// Half the side of the square table, metres.
    pub table_half_extent_m: f64,
    /// Coulomb friction of table and tray.
    pub table_friction: f64,
    /// What a depth camera gets back from table and tray.
    pub table_surface: crate::object::Surface,
    /// A tray on the table.
    pub tray: Option<Tray>,
}

impl Default for WorldSettings {
    fn default() -> Self {
        Self {
            dt_s: 1.0 / 400.0,
            solver_iterations: 4,
            gravity: 9.81,
            table_half_extent_m: 0.6,
            table_friction: 0.5,
            table_surface: crate::object::Surface::default(),
            tray: None,
        }
    }
}
