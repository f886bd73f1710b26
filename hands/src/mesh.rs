//! Triangle meshes from untrusted bytes: binary and ASCII STL, and OBJ.

use std::collections::HashMap;

use nalgebra::Point3;

/// Why bytes are no triangle mesh.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("found {found}, expected a triangle mesh")]
pub struct MeshError {
    /// What was found, with its line where there are lines.
    pub found: String,
}

impl From<String> for MeshError {
    fn from(found: String) -> Self {
        Self { found }
    }
}

/// Vertices, and triangles as indices into them, in the file's units. Coordinates may be anything that an
/// `f32` or `f64` can be, infinite and NaN too; indices are within the vertices.
pub type Parsed = Result<(Vec<Point3<f64>>, Vec<[u32; 3]>), MeshError>;

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

/// Reads STL, binary or ASCII. Equal corners become one vertex; triangles without three corners are dropped.
///
/// # Errors
/// [`MeshError`] for bytes that are neither, and for more than `budget` triangles.
pub fn parse_stl(bytes: &[u8], budget: usize) -> Parsed {
    // Binary files may begin with "solid" too: the length decides.
    if let Some(count) = bytes.get(80..84).and_then(|c| c.try_into().ok()).map(u32::from_le_bytes) {
        let count = count as usize;
        if count.checked_mul(50).and_then(|n| n.checked_add(84)) == Some(bytes.len()) {
            if count > budget {
                return Err(too_many(budget).into());
            }
            return Ok(stl_binary(&bytes[84..]));
        }
    }
    if bytes.trim_ascii_start().starts_with(b"solid") {
        return stl_ascii(&String::from_utf8_lossy(bytes), budget);
    }
    Err("neither a binary STL of the length it declares nor an ASCII STL".to_owned().into())
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
                return Err(format!("a facet of {} vertices", corners.len()).into());
            };
            push(&mut triangles, [a, b, c]);
            corners.clear();
            if triangles.len() > budget {
                return Err(too_many(budget).into());
            }
        }
    }
    Ok((welder.vertices, triangles))
}

/// Reads the vertices and faces of an OBJ; polygons become fans. Everything else is passed over.
///
/// # Errors
/// [`MeshError`] for numbers that are none, indices of no vertex, and more than `budget` triangles.
pub fn parse_obj(bytes: &[u8], budget: usize) -> Parsed {
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
                    return Err(format!("more than {} vertices", 3 * budget.max(1)).into());
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
                        return Err(too_many(budget).into());
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1/1 2/2 -1\nf 1 4 3\nf 2 3 4\n";

    /// The same solid as STL, binary.
    fn binary() -> Vec<u8> {
        let (vertices, triangles) = parse_obj(TETRAHEDRON.as_bytes(), 10).unwrap();
        let mut bytes = b"solid that is binary".to_vec();
        bytes.resize(80, 0);
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for triangle in triangles {
            bytes.extend([0; 12]);
            for corner in triangle {
                for c in &vertices[corner as usize].coords {
                    bytes.extend((*c as f32).to_le_bytes());
                }
            }
            bytes.extend([0; 2]);
        }
        bytes
    }

    #[test]
    fn obj_and_stl_give_the_same_solid() {
        let (vertices, triangles) = parse_obj(TETRAHEDRON.as_bytes(), 4).unwrap();
        assert_eq!((vertices.len(), triangles.len()), (4, 4));
        let (welded, again) = parse_stl(&binary(), 4).unwrap();
        assert_eq!((welded.len(), again.len()), (4, 4));
        let corners = |v: &[Point3<f64>], t: &[[u32; 3]]| -> Vec<Point3<f64>> {
            t.iter().flatten().map(|&i| v[i as usize]).collect()
        };
        assert_eq!(corners(&vertices, &triangles), corners(&welded, &again));
        assert!(parse_stl(&binary(), 3).unwrap_err().to_string().contains("more than 3 triangles"));
        assert!(parse_obj(TETRAHEDRON.as_bytes(), 3).is_err());
    }

    #[test]
    fn what_is_wrong_is_named() {
        let found = parse_obj(b"v 0 0 0\nf 1 2 3\n", 9).unwrap_err().found;
        assert!(found.contains("line 2") && found.contains("\"2\""), "{found}");
        assert!(parse_stl(b"solid x\nfacet\nvertex 0 0 z\n", 9).unwrap_err().found.contains("\"z\""));
        assert!(parse_stl(b"", 9).is_err());
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(at in 0..400_usize, byte: u8, cut in 0..400_usize) {
            for mut bytes in [binary(), TETRAHEDRON.as_bytes().to_vec()] {
                let (n, m) = (bytes.len(), at % bytes.len());
                bytes[m] = byte;
                bytes.truncate(if cut < n { cut } else { n });
                let parsed = [parse_stl(&bytes, 100), parse_obj(&bytes, 100)];
                for (vertices, triangles) in parsed.into_iter().flatten() {
                    prop_assert!(triangles.iter().flatten().all(|&i| (i as usize) < vertices.len()));
                }
            }
        }
    }
}
