//! The mesh files that a hand's URDF names: found in its folder, parsed, scaled.

use crate::mesh::{self, MeshError};
use crate::urdf::MAX_LENGTH_M;
use crate::{HandFiles, Shape};

/// Largest mesh file, bytes.
const MAX_BYTES: usize = 32 * 1024 * 1024;

/// Where (a file; `None`: the URDF that names it), what was found, what was expected.
pub(crate) type MeshProblem = (Option<String>, String, String);

/// The path inside the hand's folder that a URDF's mesh name stands for.
///
/// A relative name is taken as it is; `package://NAME/rest` is `rest` (a hand's folder is its own
/// package). Names that leave the folder are errors.
pub(crate) fn path(name: &str) -> Result<String, MeshProblem> {
    let refuse = |expected: &str| Err((None, format!("{name:?}"), expected.to_owned()));
    let relative = match name.strip_prefix("package://") {
        Some(rest) => match rest.split_once('/') {
            Some((package, path)) if !package.is_empty() => path,
            _ => return refuse("package://NAME/path"),
        },
        None if name.contains("://") => return refuse("a path relative to the hand's folder"),
        None => name,
    };
    if relative.contains('\\') || relative.contains('\0') || relative.contains(':') {
        return refuse("a path with / between its parts");
    }
    if relative.starts_with('/') {
        return refuse("a path relative to the hand's folder");
    }
    let mut parts = Vec::new();
    for part in relative.split('/') {
        match part {
            "" | "." => {}
            ".." => return refuse("a path that stays in the hand's folder"),
            part => parts.push(part),
        }
    }
    if parts.is_empty() {
        return refuse("the name of a file");
    }
    Ok(parts.join("/"))
}

/// Finds, parses and scales a mesh. `budget` is the number of triangles still allowed in the hand.
pub(crate) fn load(
    files: &HandFiles,
    name: &str,
    scale: [f64; 3],
    budget: &mut usize,
) -> Result<Shape, MeshProblem> {
    let path = path(name)?;
    let problem = |found: String, expected: &str| (Some(path.clone()), found, expected.to_owned());
    if !scale.iter().all(|s| s.is_finite() && s.abs() > 1e-9 && s.abs() <= 1e4) {
        return Err((None, format!("scale {scale:?}"), "three finite factors other than zero".into()));
    }
    let extension = path.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase()).unwrap_or_default();
    if !matches!(extension.as_str(), "stl" | "obj") {
        return Err(problem(format!("a .{extension} file"), "STL or OBJ: convert the mesh to STL or OBJ"));
    }
    let Some(bytes) = files.files.get(&path) else {
        return Err(problem("no such file".into(), "the mesh that the URDF names"));
    };
    if bytes.len() > MAX_BYTES {
        return Err(problem(format!("{} bytes", bytes.len()), "at most 32 MiB"));
    }
    let parsed = match extension.as_str() {
        "stl" => mesh::parse_stl(bytes, *budget),
        _ => mesh::parse_obj(bytes, *budget),
    };
    let (mut vertices, mut triangles) = parsed.map_err(|MeshError { found }| {
        problem(found, "a triangle mesh, hands up to 400,000 triangles in all")
    })?;
    for vertex in &mut vertices {
        for (value, factor) in vertex.coords.iter_mut().zip(scale) {
            *value *= factor;
        }
    }
    if scale.iter().product::<f64>() < 0.0 {
        // A mirrored mesh turns its triangles inside out.
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    if let Some(v) = vertices.iter().find(|v| !v.iter().all(|c| c.is_finite() && c.abs() <= MAX_LENGTH_M)) {
        return Err(problem(
            format!("a vertex at {:?}", v.coords.as_slice()),
            "metres within ±2 (a mesh in millimetres needs scale=\"0.001 0.001 0.001\")",
        ));
    }
    if triangles.is_empty() {
        return Err(problem("no triangles".into(), "a triangle mesh"));
    }
    *budget -= triangles.len();
    Ok(Shape::Mesh { vertices, triangles })
}
