//! What of a hand can bump into things: shapes for drawing and exact checks, spheres for the optimizer.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::solid::Solid;

/// A geometric shape in its own frame, metres.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A box with these half extents.
    Box {
        /// Half extents along x, y and z.
        half_extents: Vector3<f64>,
    },
    /// A cylinder along z, centred.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half of its length along z.
        half_length: f64,
    },
    /// A sphere about the origin.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A triangle mesh.
    Mesh {
        /// Vertices.
        vertices: Vec<Point3<f64>>,
        /// Triangles: indices into the vertices, counter-clockwise seen from outside.
        triangles: Vec<[u32; 3]>,
    },
}

impl Shape {
    /// Points on the surface, at most about `spacing_m` apart, corners and edges included, in the shape's frame. Every triangle
    /// of a mesh has its corners at least. None for a mesh that is no solid.
    pub fn surface(&self, spacing_m: f64) -> Vec<Point3<f64>> {
        Solid::new(Isometry3::identity(), self).map_or_else(Vec::new, |solid| solid.surface(spacing_m))
    }
}

/// A shape attached to a link.
#[derive(Debug, Clone, PartialEq)]
pub struct CollisionShape {
    /// The link that carries it; index into [`crate::Tree::links`].
    pub link: usize,
    /// Takes coordinates in the shape's frame to coordinates in the link frame.
    pub link_from_shape: Isometry3<f64>,
    /// The shape.
    pub shape: Shape,
}

/// A sphere of the covering that the optimizer checks against distance fields.
///
/// Together the spheres of a link cover its collision shapes from within: their union reaches the
/// surface everywhere to within the covering's tolerance and never sticks out by more than it.
#[derive(Debug, Clone, PartialEq)]
pub struct CollisionSphere {
    /// The body that carries it; index into [`crate::Tree::bodies`].
    pub body: usize,
    /// The link that it came from; index into [`crate::Tree::links`].
    pub link: usize,
    /// Centre in the *body* frame, metres.
    pub center: Point3<f64>,
    /// Radius, metres.
    pub radius: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_surface_lie_on_it_everywhere() {
        let corners = [[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.04]];
        let shapes = [
            Shape::Box { half_extents: Vector3::new(0.02, 0.03, 0.01) },
            Shape::Cylinder { radius: 0.02, half_length: 0.03 },
            Shape::Sphere { radius: 0.02 },
            Shape::Mesh {
                vertices: corners.map(Point3::from).to_vec(),
                triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
            },
        ];
        for shape in shapes {
            let solid = Solid::new(Isometry3::identity(), &shape).unwrap();
            let points = shape.surface(0.004);
            assert!(points.iter().all(|p| solid.depth(p).abs() < 1e-9), "{shape:?}");
            // From anywhere on a finer surface the next of them is near.
            for p in shape.surface(0.001) {
                let near = points.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min);
                assert!(near < 0.004, "{shape:?}: {p} is {near} m from all");
            }
        }
        let broken = Shape::Mesh { vertices: Vec::new(), triangles: Vec::new() };
        assert!(broken.surface(0.004).is_empty());
    }
}
