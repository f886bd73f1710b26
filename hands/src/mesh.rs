//! Triangle meshes from untrusted bytes: binary and ASCII STL, and OBJ.

use std::collections::HashMap;

use nalgebra::Point3;

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
    let (mut vertices, mut triangles) = match extension.as_str() {
        "stl" => stl(bytes, *budget),
        _ => obj(bytes, *budget),
    }
    .map_err(|found| problem(found, "a triangle mesh, hands up to 400,000 triangles in all"))?;
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

type Parsed = Result<(Vec<Point3<f64>>, Vec<[u32; 3]>), String>;

/// Joins equal corners: STL repeats every vertex for each triangle.
#[derive(Default)]
struct Welder {
    index: HashMap<[u32; 3], u32>,
    vertices: Vec<Point3<f64>>,
}

impl Welder {
    fn add(&mut self, corner: [f32; 3]) -> u32 {
        // Adding 0.0 turns -0.0 into 0.0, so that both weld.
        let key = corner.map(|c| (c + 0.0).to_bits());
        *self.index.entry(key).or_insert_with(|| {
            self.vertices.push(Point3::from(corner.map(f64::from)));
            (self.vertices.len() - 1) as u32
        })
    }
}

fn too_many(budget: usize) -> String {
    format!("more than {budget} triangles")
}

fn stl(bytes: &[u8], budget: usize) -> Parsed {
    // Binary files may begin with "solid" too: the length decides.
    if let Some(count) = bytes.get(80..84).and_then(|c| c.try_into().ok()).map(u32::from_le_bytes) {
        let count = count as usize;
        if count.checked_mul(50).and_then(|n| n.checked_add(84)) == Some(bytes.len()) {
            if count > budget {
                return Err(too_many(budget));
            }
            return Ok(stl_binary(&bytes[84..]));
        }
    }
    if bytes.trim_ascii_start().starts_with(b"solid") {
        return stl_ascii(&String::from_utf8_lossy(bytes), budget);
    }
    Err("neither a binary STL of the length it declares nor an ASCII STL".into())
}

fn stl_binary(records: &[u8]) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let mut welder = Welder::default();
    let mut triangles = Vec::with_capacity(records.len() / 50);
    for record in records.chunks_exact(50) {
        let mut corners = [0_u32; 3];
        for (slot, corner) in corners.iter_mut().zip(record[12..48].chunks_exact(12)) {
            let number =
                |i: usize| f32::from_le_bytes([corner[i], corner[i + 1], corner[i + 2], corner[i + 3]]);
            *slot = welder.add([number(0), number(4), number(8)]);
        }
        push(&mut triangles, corners);
    }
    (welder.vertices, triangles)
}

fn stl_ascii(text: &str, budget: usize) -> Parsed {
    let mut welder = Welder::default();
    let mut triangles = Vec::new();
    let mut corners = Vec::with_capacity(3);
    let mut words = text.split_whitespace();
    while let Some(word) = words.next() {
        if word == "vertex" {
            let mut corner = [0.0; 3];
            for slot in &mut corner {
                let number = words.next().unwrap_or_default();
                *slot = number.parse().map_err(|_| format!("vertex coordinate {number:?}"))?;
            }
            corners.push(welder.add(corner));
        } else if word == "endfacet" {
            let &[a, b, c] = corners.as_slice() else {
                return Err(format!("a facet of {} vertices", corners.len()));
            };
            push(&mut triangles, [a, b, c]);
            corners.clear();
            if triangles.len() > budget {
                return Err(too_many(budget));
            }
        }
    }
    Ok((welder.vertices, triangles))
}

fn obj(bytes: &[u8], budget: usize) -> Parsed {
    let text = String::from_utf8_lossy(bytes);
    let mut vertices: Vec<Point3<f64>> = Vec::new();
    let mut triangles = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut corner = [0.0; 3];
                for slot in &mut corner {
                    let word = words.next().unwrap_or_default();
                    *slot = word.parse().map_err(|_| format!("line {}: coordinate {word:?}", number + 1))?;
                }
                vertices.push(Point3::from(corner));
                if vertices.len() > 3 * budget.max(1) {
                    return Err(format!("more than {} vertices", 3 * budget.max(1)));
                }
            }
            Some("f") => {
                let mut face = Vec::new();
                for word in words {
                    let index = word.split('/').next().unwrap_or_default();
                    face.push(
                        obj_index(index, vertices.len())
                            .ok_or_else(|| format!("line {}: face index {word:?}", number + 1))?,
                    );
                }
                // Polygons become fans.
                for pair in face.windows(2).skip(1) {
                    push(&mut triangles, [face[0], pair[0], pair[1]]);
                    if triangles.len() > budget {
                        return Err(too_many(budget));
                    }
                }
            }
            _ => {}
        }
    }
    Ok((vertices, triangles))
}

/// OBJ counts from one, or backwards from the latest vertex.
fn obj_index(word: &str, count: usize) -> Option<u32> {
    let index: i64 = word.parse().ok()?;
    let index = if index < 0 { (count as i64).checked_add(index)? } else { index.checked_sub(1)? };
    usize::try_from(index).ok().filter(|&i| i < count).and_then(|i| u32::try_from(i).ok())
}

/// Adds a triangle unless two of its corners are one.
fn push(triangles: &mut Vec<[u32; 3]>, t: [u32; 3]) {
    if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
        triangles.push(t);
    }
}
