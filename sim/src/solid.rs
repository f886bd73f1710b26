//! What a mesh encloses: how far a point is from its surface, on which side, and which way out is.

use nalgebra::{Point3, Unit, Vector3};
use parry3d_f64::query::{PointQuery as _, PointQueryWithLocation as _};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};

use crate::convert;
use crate::mesh::Mesh;

/// A closed mesh that can be asked about points. Where it is made of several closed pieces, as a mug and its handle, it is
/// their union.
#[derive(Debug, Clone)]
pub struct Solid {
    pieces: Vec<TriMesh>,
}

/// The surface as seen from a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Distance to the surface, metres; negative inside.
    pub distance_m: f64,
    /// Outward normal of the surface there.
    pub normal: Unit<Vector3<f64>>,
}

impl Solid {
    /// `None` for a mesh without a triangle of any area.
    pub fn new(mesh: &Mesh) -> Option<Self> {
        let pieces: Vec<TriMesh> =
            pieces(mesh).into_iter().filter_map(|triangles| piece(mesh, &triangles)).collect();
        (!pieces.is_empty()).then_some(Self { pieces })
    }

    /// The surface as seen from a point of the mesh's frame. In a place where pieces overlap the nearest surface of the
    /// piece that the point is deepest in counts.
    pub fn nearest(&self, point: &Point3<f64>) -> Nearest {
        let none = Nearest { distance_m: f64::INFINITY, normal: Vector3::z_axis() };
        let seen = self.pieces.iter().map(|piece| nearest(piece, point));
        seen.fold(none, |best, seen| if seen.distance_m < best.distance_m { seen } else { best })
    }
}

fn nearest(piece: &TriMesh, point: &Point3<f64>) -> Nearest {
    let at = convert::point(point);
    let seen = piece.project_local_point(at, false);
    let out = convert::from_vector(at - seen.point);
    let side = if seen.is_inside { -1.0 } else { 1.0 };
    let distance_m = side * out.norm();
    let normal = Unit::try_new(out * side, 1e-9).unwrap_or_else(|| {
        // On the surface only the triangle knows.
        let (_, (triangle, _)) = piece.project_local_point_and_get_location(at, false);
        let normal = piece.triangle(triangle).normal().map_or_else(Vector3::z, convert::from_vector);
        Unit::new_normalize(normal)
    });
    Nearest { distance_m, normal }
}

/// One piece with what is needed to tell inside from outside.
fn piece(mesh: &Mesh, triangles: &[[u32; 3]]) -> Option<TriMesh> {
    let vertices = mesh.vertices.iter().map(convert::point).collect();
    let flags = TriMeshFlags::ORIENTED
        | TriMeshFlags::MERGE_DUPLICATE_VERTICES
        | TriMeshFlags::DELETE_DEGENERATE_TRIANGLES;
    TriMesh::with_flags(vertices, triangles.to_vec(), flags).ok()
}

/// Triangles that hang together, by the vertices that they share.
fn pieces(mesh: &Mesh) -> Vec<Vec<[u32; 3]>> {
    let mut parents: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    fn root(parents: &mut [u32], mut at: u32) -> u32 {
        while parents[at as usize] != at {
            parents[at as usize] = parents[parents[at as usize] as usize];
            at = parents[at as usize];
        }
        at
    }
    for &[a, b, c] in &mesh.triangles {
        for other in [b, c] {
            let (from, to) = (root(&mut parents, other), root(&mut parents, a));
            parents[from as usize] = to;
        }
    }
    let mut found: std::collections::BTreeMap<u32, Vec<[u32; 3]>> = std::collections::BTreeMap::new();
    for &triangle in &mesh.triangles {
        found.entry(root(&mut parents, triangle[0])).or_default().push(triangle);
    }
    found.into_values().collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use proptest::prelude::*;

    use super::*;

    const HALF: Vector3<f64> = Vector3::new(0.01, 0.02, 0.03);

    /// Signed distance of a centred box.
    fn of_box(p: &Point3<f64>, half: &Vector3<f64>) -> f64 {
        let beyond = p.coords.abs() - half;
        beyond.sup(&Vector3::zeros()).norm() + beyond.max().min(0.0)
    }

    proptest! {
        #[test]
        fn a_box_is_as_far_as_its_formula_says(
            x in -0.05..0.05f64, y in -0.05..0.05f64, z in -0.05..0.05f64,
        ) {
            let solid = Solid::new(&Mesh::cuboid(HALF)).unwrap();
            let p = Point3::new(x, y, z);
            let seen = solid.nearest(&p);
            prop_assert!((seen.distance_m - of_box(&p, &HALF)).abs() < 1e-9);
            // Along the normal back to the surface.
            let surface = p - seen.normal.into_inner() * seen.distance_m;
            prop_assert!(of_box(&surface, &HALF).abs() < 1e-9);
        }

        #[test]
        fn two_boxes_are_their_union(x in -0.04..0.09f64, y in -0.05..0.05f64, z in -0.05..0.05f64) {
            let moved = Isometry3::translation(0.03, 0.0, 0.0);
            let mut mesh = Mesh::cuboid(HALF);
            mesh.append(&Mesh::cuboid(HALF * 1.5), &moved);
            let solid = Solid::new(&mesh).unwrap();
            let p = Point3::new(x, y, z);
            let expected = of_box(&p, &HALF).min(of_box(&(moved.inverse() * p), &(HALF * 1.5)));
            prop_assert!((solid.nearest(&p).distance_m - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn on_the_surface_the_normal_is_the_faces() {
        let solid = Solid::new(&Mesh::cuboid(HALF)).unwrap();
        let seen = solid.nearest(&Point3::new(0.002, 0.003, 0.03));
        assert!(seen.distance_m.abs() < 1e-12);
        assert!((seen.normal.into_inner() - Vector3::z()).norm() < 1e-9, "{:?}", seen.normal);
        assert!(Solid::new(&Mesh::default()).is_none());
    }
}
