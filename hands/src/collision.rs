//! What of a hand can bump into things: shapes for drawing and exact checks, spheres for the optimizer.

use nalgebra::{Isometry3, Point3, Vector3};

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
