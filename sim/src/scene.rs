//! A scene in one JSON file: what the world is made of, which objects, where.
//!
//! ```json
//! {"graspd_scene": 1,
//!  "settings": {"gravity": 9.81},
//!  "objects": [
//!   {"name": "can", "source": {"family": {"cylinder": {"radius_m": 0.03, "height_m": 0.1}}}, "mass_kg": 0.3,
//!    "friction": 0.5, "surface": {"albedo": 0.6, "specular": 0.0},
//!    "position_m": [0.0, 0.0, 0.05], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}]}
//! ```
//!
//! An object's source is a procedural family with its sizes, or a mesh with its convex parts. Settings that are
//! not named have their defaults. Objects stand in the order of their ids; a loaded world counts them from 1.
//! Motion is not saved: a loaded world is at rest. Numbers are read as exactly as they are written.

mod fields;
mod settings;

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::mesh::Mesh;
use crate::object::{Family, Object, ObjectError, Source, Surface, check_mesh, check_properties};
use crate::world::World;
use fields::{Fields, within};

/// The version that is written, and the only one that is read.
const VERSION: u64 = 1;
/// Most objects of a scene.
const MOST_OBJECTS: usize = 1000;
/// Farthest from the origin that an object may be along an axis, metres.
const FARTHEST_M: f64 = 10.0;

/// Why a scene file cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// A field is not what it should be.
    #[error("{field}: found {found}, expected {expected}")]
    Field {
        /// Path of the field.
        field: String,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
}

/// An object's source in a file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum SourceFile {
    Family(Family),
    Mesh(MeshFile),
}

/// A mesh in a file, in the object's frame.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MeshFile {
    vertices: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<Vec<Point3<f64>>>,
}

/// The world's objects and poses as JSON, an object a line. Hands are not part of a scene.
pub fn to_json(world: &World) -> String {
    let objects: Vec<String> = world
        .ids()
        .into_iter()
        .filter_map(|id| Some(object_json(world.object(id)?, &world.pose(id)?).to_string()))
        .collect();
    let settings = json!(world.settings());
    let objects = objects.join(",\n");
    format!("{{\"graspd_scene\":{VERSION},\n\"settings\":{settings},\n\"objects\":[\n{objects}\n]}}\n")
}

fn object_json(object: &Object, pose: &Isometry3<f64>) -> Value {
    let source = match object.source {
        Source::Family(family) => SourceFile::Family(family),
        Source::Mesh => SourceFile::Mesh(MeshFile {
            vertices: object.mesh.vertices.clone(),
            triangles: object.mesh.triangles.clone(),
            parts: object.parts.clone(),
        }),
    };
    json!({
        "name": object.name,
        "source": source,
        "mass_kg": object.mass_kg,
        "friction": object.friction,
        "surface": object.surface,
        "position_m": pose.translation.vector.as_slice(),
        "orientation_xyzw": pose.rotation.coords.as_slice(),
    })
}

/// A world from JSON, without hands.
///
/// # Errors
/// [`SceneError`] with the field that is wrong: text that is not JSON, an unknown version, a field that is
/// missing, unknown, of the wrong type or out of bounds, a mesh that is no solid.
pub fn from_json(text: &str) -> Result<World, SceneError> {
    let value: Value = serde_json::from_str(text).map_err(|e| SceneError::Field {
        field: "scene".into(),
        found: e.to_string(),
        expected: "JSON".into(),
    })?;
    let mut fields = Fields::new("scene", value)?;
    let version: u64 = fields.take("graspd_scene", "the version of the format, 1")?;
    if version != VERSION {
        return Err(fields.wrong("graspd_scene", version, "1, the version that this program reads"));
    }
    let settings = fields.take("settings", "a world's settings")?;
    settings::check(&settings)?;
    let objects: Vec<Value> = fields.take("objects", "an array of objects")?;
    fields.finish()?;
    if objects.len() > MOST_OBJECTS {
        let found = format!("{} objects", objects.len());
        return Err(SceneError::Field {
            field: "objects".into(),
            found,
            expected: format!("at most {MOST_OBJECTS}"),
        });
    }
    let mut world = World::new(settings);
    for (index, value) in objects.into_iter().enumerate() {
        let (object, pose) = object(Fields::new(&format!("objects[{index}]"), value)?)?;
        world.add(Arc::new(object), &pose);
    }
    Ok(world)
}

fn object(mut fields: Fields) -> Result<(Object, Isometry3<f64>), SceneError> {
    let name: String = fields.take("name", "a text")?;
    let source: SourceFile = fields.take("source", "a family with its sizes, or a mesh with its parts")?;
    let mass_kg: f64 = fields.take("mass_kg", "a mass in kilograms")?;
    let friction: f64 = fields.take("friction", "a coefficient of friction")?;
    let surface: Surface = fields.take("surface", "albedo and specular share")?;
    let position: [f64; 3] = fields.take("position_m", "three coordinates in metres")?;
    let orientation: [f64; 4] = fields.take("orientation_xyzw", "a quaternion of length 1")?;
    let path = fields.finish()?;
    for value in position {
        within(&path, "position_m", value, -FARTHEST_M, FARTHEST_M)?;
    }
    let [x, y, z, w] = orientation;
    let rotation = Quaternion::new(w, x, y, z);
    within(&path, "orientation_xyzw: length", rotation.norm(), 0.999, 1.001)?;
    // What is unit already keeps every bit.
    let unit = (rotation.norm() - 1.0).abs() < 1e-14;
    let rotation =
        if unit { UnitQuaternion::new_unchecked(rotation) } else { UnitQuaternion::new_normalize(rotation) };
    let object = match source {
        SourceFile::Family(family) => Object::from_family(name, family, mass_kg, friction, surface)
            .map_err(|e| explained(&path, "source.family.", e))?,
        SourceFile::Mesh(MeshFile { vertices, triangles, parts }) => {
            check_properties(mass_kg, friction, &surface).map_err(|e| explained(&path, "", e))?;
            let mesh = check_mesh(Mesh { vertices, triangles }, &parts)
                .map_err(|e| explained(&path, "source.", e))?;
            Object { name, mesh: mesh.into(), parts, mass_kg, friction, surface, source: Source::Mesh }
        }
    };
    Ok((object, Isometry3::from_parts(Translation3::from(position), rotation)))
}

/// An object's error, at its place in the file.
fn explained(path: &str, prefix: &str, error: ObjectError) -> SceneError {
    match error {
        ObjectError::Size { field, found, low, high } => {
            // Sizes are named after their family, properties are not.
            let own = ["mass_kg", "friction", "surface.albedo", "surface.specular"].contains(&field.as_str());
            let prefix = if own { "" } else { prefix };
            SceneError::Field {
                field: format!("{path}.{prefix}{field}"),
                found: found.to_string(),
                expected: format!("{low} to {high}"),
            }
        }
        ObjectError::Mesh { found, expected } => {
            SceneError::Field { field: format!("{path}.{prefix}mesh"), found, expected: expected.to_owned() }
        }
    }
}

#[cfg(test)]
mod tests;
