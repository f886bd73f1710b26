//! Triangle meshes: what objects look like to a camera.

use graspd_hands::mesh::{MeshError, parse_obj, parse_stl};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::object::MOST_TRIANGLES;

/// A triangle mesh in its own frame, metres.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<Point3<f64>>,
    /// Indices into the vertices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// A mesh from the bytes of an STL file, binary or ASCII, in the file's units. It may be open or not
    /// finite: [`Object::from_mesh`](crate::object::Object::from_mesh) finds out.
    ///
    /// # Errors
    /// [`MeshError`] for bytes that are no STL, and for more than 200,000 triangles.
    pub fn from_stl(bytes: &[u8]) -> Result<Self, MeshError> {
        parse_stl(bytes, MOST_TRIANGLES).map(|(vertices, triangles)| Self { vertices, triangles })
    }

    /// A mesh from the bytes of an OBJ file, in the file's units; see [`Mesh::from_stl`].
    ///
    /// # Errors
    /// [`MeshError`] for bytes that are no OBJ, and for more than 200,000 triangles.
    pub fn from_obj(bytes: &[u8]) -> Result<Self, MeshError> {
        parse_obj(bytes, MOST_TRIANGLES).map(|(vertices, triangles)| Self { vertices, triangles })
    }

    /// Adds another mesh, moved.
    pub fn append(&mut self, other: &Self, self_from_other: &Isometry3<f64>) {
        let base = self.vertices.len() as u32;
        self.vertices.extend(other.vertices.iter().map(|v| self_from_other * v));
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
    }

    /// Corners of a triangle.
    ///
    /// # Panics
    /// If the index is out of range.
    pub fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|i| self.vertices[i as usize])
    }

    /// Smallest and largest corner of the bounding box; `None` for a mesh without vertices.
    pub fn bounds(&self) -> Option<(Point3<f64>, Point3<f64>)> {
        let first = *self.vertices.first()?;
        Some(self.vertices.iter().fold((first, first), |(low, high), v| (low.inf(v), high.sup(v))))
    }

    /// Enclosed volume, cubic metres: positive for a closed mesh whose triangles face outwards.
    pub fn volume(&self) -> f64 {
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t);
                a.coords.dot(&b.coords.cross(&c.coords)) / 6.0
            })
            .sum()
    }

    /// A box with these half extents, centred.
    pub fn cuboid(half: Vector3<f64>) -> Self {
        let vertices = (0..8)
            .map(|i| {
                let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                Point3::new(sign(0) * half.x, sign(1) * half.y, sign(2) * half.z)
            })
            .collect();
        let triangles = vec![
            [0, 4, 6],
            [0, 6, 2],
            [1, 3, 7],
            [1, 7, 5],
            [0, 1, 5],
            [0, 5, 4],
            [2, 6, 7],
            [2, 7, 3],
            [0, 2, 3],
            [0, 3, 1],
            [4, 5, 7],
            [4, 7, 6],
        ];
        Self { vertices, triangles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_becomes_an_object() {
        let text = "v 0 0 0\nv 40 0 0\nv 0 40 0\nv 0 0 40\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
        let mesh = Mesh::from_obj(text.as_bytes()).unwrap();
        assert!((mesh.volume() - 64_000.0 / 6.0).abs() < 1e-9);
        let options = crate::object::MeshOptions { scale: 0.001, ..Default::default() };
        let object = crate::object::Object::from_mesh("corner", mesh, &options).unwrap();
        assert!((object.mass_kg - 500.0 * 64e-6 / 6.0).abs() < 1e-12);
        assert!(Mesh::from_stl(text.as_bytes()).is_err());
    }

    #[test]
    fn a_box_encloses_its_volume() {
        let mesh = Mesh::cuboid(Vector3::new(0.5, 1.0, 1.5));
        assert!((mesh.volume() - 6.0).abs() < 1e-12);
        let (low, high) = mesh.bounds().unwrap();
        assert_eq!((low, high), (Point3::new(-0.5, -1.0, -1.5), Point3::new(0.5, 1.0, 1.5)));
    }
}
