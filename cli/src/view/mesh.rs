//! Triangle meshes of a hand's shapes, one per moving body.

use graspd_hands::{Hand, Shape};
use nalgebra::{Isometry3, Point3};

/// Segments around a cylinder.
const AROUND: u32 = 28;

/// Triangles in some frame, counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TriangleMesh {
    /// Vertices, metres.
    pub(crate) vertices: Vec<Point3<f64>>,
    /// Indices into the vertices.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Adds another mesh, moved by `pose`.
    pub(crate) fn add(&mut self, other: &Self, pose: &Isometry3<f64>) {
        let base = self.vertices.len() as u32;
        self.vertices.extend(other.vertices.iter().map(|p| pose * p));
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
    }

    /// Triangles of a shape in its own frame.
    pub(crate) fn of_shape(shape: &Shape) -> Self {
        match shape {
            Shape::Box { half_extents } => {
                let corner = |i: usize| {
                    let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                    Point3::new(sign(0) * half_extents.x, sign(1) * half_extents.y, sign(2) * half_extents.z)
                };
                // Two triangles a face; bit 0 of a corner's number is x, bit 1 y, bit 2 z.
                let faces: [[u32; 4]; 6] =
                    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
                Self {
                    vertices: (0..8).map(corner).collect(),
                    triangles: faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect(),
                }
            }
            Shape::Cylinder { radius, half_length } => {
                let mut mesh = Self {
                    vertices: vec![Point3::new(0.0, 0.0, -half_length), Point3::new(0.0, 0.0, *half_length)],
                    triangles: Vec::new(),
                };
                for i in 0..AROUND {
                    let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / f64::from(AROUND)).sin_cos();
                    for z in [-half_length, *half_length] {
                        mesh.vertices.push(Point3::new(radius * cos, radius * sin, z));
                    }
                    let (a, b) = (2 + 2 * i, 2 + 2 * ((i + 1) % AROUND));
                    mesh.triangles.extend([[0, b, a], [1, a + 1, b + 1], [a, b, b + 1], [a, b + 1, a + 1]]);
                }
                mesh
            }
            Shape::Sphere { radius } => sphere(*radius),
            Shape::Mesh { vertices, triangles } => {
                Self { vertices: vertices.clone(), triangles: triangles.clone() }
            }
        }
    }
}

/// A sphere of latitude rings.
fn sphere(radius: f64) -> TriangleMesh {
    let (rings, around) = (12u32, 20u32);
    let mut mesh = TriangleMesh::default();
    for r in 0..=rings {
        let (sin_r, cos_r) = (f64::from(r) * std::f64::consts::PI / f64::from(rings)).sin_cos();
        for a in 0..around {
            let (sin_a, cos_a) = (f64::from(a) * std::f64::consts::TAU / f64::from(around)).sin_cos();
            mesh.vertices.push(Point3::new(sin_r * cos_a, sin_r * sin_a, cos_r) * radius);
            if r < rings {
                let (i, j) = (r * around + a, r * around + (a + 1) % around);
                mesh.triangles.extend([[i, i + around, j + around], [i, j + around, j]]);
            }
        }
    }
    mesh
}

/// What is drawn of a hand: one mesh per body of its tree, in the body's frame.
pub(crate) fn of_hand(hand: &Hand) -> Vec<TriangleMesh> {
    let mut bodies = vec![TriangleMesh::default(); hand.tree.bodies.len()];
    let shapes = if hand.visuals.is_empty() { &hand.collision } else { &hand.visuals };
    for shape in shapes {
        let link = &hand.tree.links[shape.link];
        bodies[link.body]
            .add(&TriangleMesh::of_shape(&shape.shape), &(link.body_from_link * shape.link_from_shape));
    }
    bodies
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// Volume by the divergence theorem: positive only if every triangle faces outwards.
    fn volume(mesh: &TriangleMesh) -> f64 {
        let at = |i: u32| mesh.vertices[i as usize].coords;
        mesh.triangles.iter().map(|t| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0).sum()
    }

    #[test]
    fn meshes_are_closed_and_face_outwards() {
        let cube = TriangleMesh::of_shape(&Shape::Box { half_extents: Vector3::new(0.1, 0.2, 0.3) });
        assert!((volume(&cube) - 0.048).abs() < 1e-12);
        let rod = TriangleMesh::of_shape(&Shape::Cylinder { radius: 0.1, half_length: 0.5 });
        let exact = std::f64::consts::PI * 0.01;
        assert!((volume(&rod) / exact - 1.0).abs() < 0.02);
        let ball = TriangleMesh::of_shape(&Shape::Sphere { radius: 0.1 });
        assert!((volume(&ball) / (4.0 / 3.0 * std::f64::consts::PI * 1e-3) - 1.0).abs() < 0.06);
    }
}
