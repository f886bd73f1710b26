//! Things to grasp: what they look like, what they collide with, how heavy and slippery they are.

// Families, one group a file.
mod compound;
mod convex;
mod revolved;
mod small;

mod family;
mod from_mesh;
mod skin;

pub use compound::{Ell, Hammer, Mug, Ring, Tee};
pub use convex::{Ball, Capsule, Cuboid, Cylinder, Frustum, Superquadric};
pub use family::{Family, Kind};
pub use from_mesh::{Filling, MeshOptions};
pub(crate) use from_mesh::{MOST_TRIANGLES, check_mesh};
pub use revolved::{Bottle, Bowl, Can, Cup};
pub use small::{Block, Disc, Nut, Peg, Plate};

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rapier3d_f64::prelude::SharedShape;
use serde::{Deserialize, Serialize};

use crate::convert;
use crate::mesh::Mesh;

/// Lightest and heaviest household object that is drawn, kilograms.
const MASSES_KG: (f64, f64) = (0.02, 0.8);
/// Lightest and heaviest object that is accepted, kilograms.
const MASS_LIMITS_KG: (f64, f64) = (1e-4, 100.0);
/// Largest coefficient of friction that is accepted.
const MOST_FRICTION: f64 = 10.0;

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

/// Where an object's shape is from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Source {
    /// A procedural family.
    Family(Family),
    /// A user's mesh; its vertices are the object's.
    Mesh,
}

/// A rigid thing. Its frame's origin is its centre of mass (within it, or in its hollow); z is its upright axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Object {
    /// Shown to people, for example `mug`.
    pub name: String,
    /// What a camera sees, and what scores are measured against: closed shells, triangles facing outwards.
    /// Shells of compounds overlap where they are joined.
    pub mesh: Arc<Mesh>,
    /// What collides: vertices of convex parts whose union is the object.
    pub parts: Vec<Vec<Point3<f64>>>,
    /// Kilograms.
    pub mass_kg: f64,
    /// Coulomb friction of its surface.
    pub friction: f64,
    /// What a depth camera gets back from it.
    pub surface: Surface,
    /// Where its shape is from.
    pub source: Source,
}

/// Why no object can be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ObjectError {
    /// A size or property is out of bounds.
    #[error("{field}: found {found}, expected {low} to {high}")]
    Size {
        /// The field.
        field: String,
        /// Found value.
        found: f64,
        /// Smallest allowed value.
        low: f64,
        /// Largest allowed value.
        high: f64,
    },
    /// A mesh is no closed solid.
    #[error("mesh: found {found}, expected {expected}")]
    Mesh {
        /// What was found.
        found: String,
        /// What is expected.
        expected: &'static str,
    },
}

impl ObjectError {
    /// Checks that a value is within bounds, both included.
    pub(crate) fn check(field: &str, found: f64, (low, high): (f64, f64)) -> Result<(), Self> {
        if (low..=high).contains(&found) {
            return Ok(());
        }
        Err(Self::Size { field: field.to_owned(), found, low, high })
    }
}

impl Object {
    /// A member of a procedural family.
    ///
    /// # Errors
    /// [`ObjectError::Size`] for sizes that give no solid, and for mass or friction out of bounds.
    pub fn from_family(
        name: impl Into<String>,
        family: Family,
        mass_kg: f64,
        friction: f64,
        surface: Surface,
    ) -> Result<Self, ObjectError> {
        check_properties(mass_kg, friction, &surface)?;
        let geometry = family.geometry()?;
        let center = centroid(&geometry.parts);
        let geometry = geometry.map(|p| p - center);
        Ok(Self {
            name: name.into(),
            mesh: Arc::new(geometry.mesh),
            parts: geometry.parts,
            mass_kg,
            friction,
            surface,
            source: Source::Family(family),
        })
    }

    /// A member of a family with sizes, mass, friction and surface as in a household, drawn by seed.
    pub fn sample(kind: Kind, seed: u64) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        // Drawn sizes are within the family's bounds: the first draw is taken (a test draws many).
        loop {
            let family = kind.draw(&mut rng);
            let (low, high) = kind.density();
            let (density, friction) = (rng.random_range(low..high), rng.random_range(0.3..0.9));
            let surface = draw_surface(&mut rng);
            let Ok(mut object) = Self::from_family(kind.name(), family, 0.1, friction, surface) else {
                continue;
            };
            object.mass_kg = (density * object.mesh.volume()).clamp(MASSES_KG.0, MASSES_KG.1);
            return object;
        }
    }

    /// A box with these half extents, for tests and examples: 0.2 kg, friction 0.5, default surface.
    ///
    /// # Errors
    /// [`ObjectError::Size`] for sizes out of bounds.
    pub fn cuboid(name: impl Into<String>, half: Vector3<f64>) -> Result<Self, ObjectError> {
        let family = Family::Box(Cuboid { size_m: (half * 2.0).into() });
        Self::from_family(name, family, 0.2, 0.5, Surface::default())
    }
}

/// Checks what does not depend on the shape.
pub(crate) fn check_properties(mass_kg: f64, friction: f64, surface: &Surface) -> Result<(), ObjectError> {
    ObjectError::check("mass_kg", mass_kg, MASS_LIMITS_KG)?;
    ObjectError::check("friction", friction, (0.0, MOST_FRICTION))?;
    ObjectError::check("surface.albedo", surface.albedo, (0.0, 1.0))?;
    ObjectError::check("surface.specular", surface.specular, (0.0, 1.0))
}

/// Most things are matt and neither black nor white; a few are dark, a few shine.
fn draw_surface(rng: &mut Xoshiro256PlusPlus) -> Surface {
    let dark = rng.random_bool(0.1);
    let shiny = rng.random_bool(0.1);
    Surface {
        albedo: if dark { rng.random_range(0.04..0.15) } else { rng.random_range(0.3..0.9) },
        specular: if shiny { rng.random_range(0.4..0.9) } else { rng.random_range(0.0..0.1) },
    }
}

/// Centre of mass of convex parts of one density; zero for parts without volume.
fn centroid(parts: &[Vec<Point3<f64>>]) -> Vector3<f64> {
    let (mut sum, mut mass) = (Vector3::zeros(), 0.0);
    for part in parts {
        let points: Vec<_> = part.iter().map(convert::point).collect();
        let Some(hull) = SharedShape::convex_hull(&points) else { continue };
        let properties = hull.mass_properties(1.0);
        sum += convert::from_vector(properties.local_com) * properties.mass();
        mass += properties.mass();
    }
    if mass > 0.0 { sum / mass } else { Vector3::zeros() }
}

#[cfg(test)]
mod tests;
