//! Things to grasp: what they look like, what they collide with, how heavy and slippery they are.

use std::sync::Arc;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::mesh::Mesh;

/// How a surface answers to a depth camera's light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Surface {
    /// Diffuse reflectivity in the near infrared, 0 (black) to 1 (white).
    pub albedo: f64,
    /// Share of the light that is mirrored instead of scattered, 0 (matt) to 1 (polished metal).
    pub specular: f64,
}

impl Default for Surface {
    fn default() -> Self {
        Self { albedo: 0.6, specular: 0.0 }
    }
}

/// A rigid thing. Its frame's origin lies within it; z is its upright axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// Shown to people, for example `mug`.
    pub name: String,
    /// What a camera sees, and what scores are measured against: closed, triangles facing outwards.
    pub mesh: Arc<Mesh>,
    /// What collides: vertices of convex parts whose union is the object.
    pub parts: Vec<Vec<Point3<f64>>>,
    /// Kilograms.
    pub mass_kg: f64,
    /// Coulomb friction of its surface.
    pub friction: f64,
    /// What a depth camera gets back from it.
    pub surface: Surface,
}
