//! Convex hulls as the physics engine needs them.
//!
//! The engine's contact manifolds take the first four corners of a convex polyhedron's face and leave out the
//! others (parry: `ConvexPolyhedron::local_support_feature`). A can would stand on a sliver of its round base, and
//! rock for ever. Here such faces become quadrilaterals: their four widest corners stay, the others draw back by a
//! hair, far enough to leave the face and too little to be seen. Beyond a tilt of about a degree the true rim bears.

use nalgebra::Point3;
use rapier3d_f64::prelude::{ConvexPolyhedron, SharedShape, Vector};

use crate::convert;

/// How far corners draw back from faces of more than four, metres: less than a depth camera's noise.
const DRAWN_BACK_M: f64 = 0.0002;

/// The convex hull of points, ready to collide; `None` for points that span no volume.
pub(crate) fn shape(points: &[Point3<f64>]) -> Option<SharedShape> {
    let points: Vec<_> = points.iter().map(convert::point).collect();
    let hull = ConvexPolyhedron::from_convex_hull(&points)?;
    let drawn = ConvexPolyhedron::from_convex_hull(&draw_back(&hull));
    // Something thinner than a hair keeps its faces.
    Some(SharedShape::new(drawn.unwrap_or(hull)))
}

/// The hull's corners after faces of more than four have become quadrilaterals.
fn draw_back(hull: &ConvexPolyhedron) -> Vec<Vector> {
    let points = hull.points();
    let mut out = points.to_vec();
    for face in hull.faces() {
        let first = face.first_vertex_or_edge as usize;
        let corners = &hull.vertices_adj_to_face()[first..first + face.num_vertices_or_edges as usize];
        if corners.len() <= 4 {
            continue;
        }
        let kept = widest_four(points, corners, face.normal);
        for &corner in corners.iter().filter(|c| !kept.contains(c)) {
            out[corner as usize] -= face.normal * DRAWN_BACK_M;
        }
    }
    out
}

/// The two corners farthest from one another, and on each side of the line through them the farthest from it.
fn widest_four(points: &[Vector], corners: &[u32], normal: Vector) -> [u32; 4] {
    let at = |c: u32| points[c as usize];
    let (mut a, mut b, mut longest) = (corners[0], corners[0], -1.0);
    for (i, &p) in corners.iter().enumerate() {
        for &q in &corners[i + 1..] {
            let length = (at(q) - at(p)).length_squared();
            // Longer by more than rounding, so that a regular face gives the same corners everywhere.
            if length > longest * (1.0 + 1e-9) {
                (a, b, longest) = (p, q, length);
            }
        }
    }
    let across = normal.cross(at(b) - at(a));
    let (mut low, mut high) = ((a, 0.0), (a, 0.0));
    for &c in corners {
        let side = (at(c) - at(a)).dot(across);
        if side < low.1 {
            low = (c, side);
        }
        if side > high.1 {
            high = (c, side);
        }
    }
    [a, b, low.0, high.0]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    fn round(corners: usize) -> Vec<Point3<f64>> {
        let ring = |z: f64| {
            (0..corners).map(move |k| {
                let angle = TAU * k as f64 / corners as f64;
                Point3::new(0.03 * angle.cos(), 0.03 * angle.sin(), z)
            })
        };
        ring(-0.05).chain(ring(0.05)).collect()
    }

    #[test]
    fn round_faces_become_quadrilaterals_that_span_them() {
        let shape = shape(&round(24)).unwrap();
        let hull = shape.as_convex_polyhedron().unwrap();
        let flat: Vec<_> = hull.faces().iter().filter(|f| f.normal.z.abs() > 0.9999).collect();
        let caps: Vec<_> = flat.iter().filter(|f| f.normal.z.abs() > 1.0 - 1e-12).collect();
        assert_eq!(caps.len(), 2);
        assert!(caps.iter().all(|f| f.num_vertices_or_edges == 4));
        assert!(hull.faces().iter().all(|f| f.num_vertices_or_edges <= 4));
        // No corner has gone farther than a hair.
        for p in round(24) {
            let moved = hull.points().iter().map(|q| (*q - convert::point(&p)).length());
            assert!(moved.fold(f64::MAX, f64::min) < DRAWN_BACK_M * 1.01);
        }
    }

    #[test]
    fn a_box_stays_as_it_is_and_a_sheet_is_nothing() {
        let cube = crate::mesh::Mesh::cuboid(nalgebra::Vector3::new(0.1, 0.2, 0.3)).vertices;
        let shape = shape(&cube).unwrap();
        assert_eq!(shape.as_convex_polyhedron().unwrap().points().len(), 8);
        assert!((shape.mass_properties(1.0).mass() - 0.048).abs() < 1e-9);
        assert!(super::shape(&cube[..2]).is_none());
    }
}
