//! Shapes of hands as triangles.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use graspd_hands::Shape;
use nalgebra::Point3;

use crate::mesh::Mesh;

/// Sides of a full turn.
const SIDES: u32 = 24;
/// Rings of a sphere between its poles.
const RINGS: u32 = 11;

/// Triangles of a shape, in its own frame.
#[derive(Debug, Clone)]
pub struct Triangles<'a> {
    /// Vertices.
    pub vertices: Cow<'a, [Point3<f64>]>,
    /// Indices into the vertices, counter-clockwise seen from outside.
    pub triangles: Cow<'a, [[u32; 3]]>,
}

impl Triangles<'_> {
    /// As a mesh of its own.
    pub fn into_mesh(self) -> Mesh {
        Mesh { vertices: self.vertices.into_owned(), triangles: self.triangles.into_owned() }
    }
}

/// Triangles of a shape: borrowed from a mesh, made for everything else.
pub fn triangulate(shape: &Shape) -> Triangles<'_> {
    let made = match shape {
        Shape::Mesh { vertices, triangles } => {
            return Triangles { vertices: vertices.into(), triangles: triangles.into() };
        }
        Shape::Box { half_extents } => Mesh::cuboid(*half_extents),
        Shape::Cylinder { radius, half_length } => turned(&[
            (0.0, -half_length),
            (*radius, -half_length),
            (*radius, *half_length),
            (0.0, *half_length),
        ]),
        Shape::Sphere { radius } => sphere(*radius),
    };
    Triangles { vertices: made.vertices.into(), triangles: made.triangles.into() }
}

/// A sphere about the origin.
pub fn sphere(radius: f64) -> Mesh {
    let profile: Vec<_> = (0..=RINGS + 1)
        .map(|i| {
            let angle = PI * f64::from(i) / f64::from(RINGS + 1);
            // The poles exactly on the axis, or they would not be closed.
            let across = if i == 0 || i == RINGS + 1 { 0.0 } else { angle.sin() };
            (radius * across, -radius * angle.cos())
        })
        .collect();
    turned(&profile)
}

/// A profile of (radius, height) turned about z, from its lower end on the axis to its upper end on the axis.
fn turned(profile: &[(f64, f64)]) -> Mesh {
    let mut mesh = Mesh::default();
    let [(_, low), rings @ .., (_, high)] = profile else { return mesh };
    mesh.vertices.push(Point3::new(0.0, 0.0, *low));
    for (radius, height) in rings {
        mesh.vertices.extend((0..SIDES).map(|side| {
            let (sin, cos) = (TAU * f64::from(side) / f64::from(SIDES)).sin_cos();
            Point3::new(radius * cos, radius * sin, *height)
        }));
    }
    let top = mesh.vertices.len() as u32;
    mesh.vertices.push(Point3::new(0.0, 0.0, *high));
    for side in 0..SIDES {
        let next = (side + 1) % SIDES;
        mesh.triangles.push([0, 1 + next, 1 + side]);
        for ring in 1..rings.len() as u32 {
            let (lower, upper) = (1 + (ring - 1) * SIDES, 1 + ring * SIDES);
            mesh.triangles.push([lower + side, lower + next, upper + next]);
            mesh.triangles.push([lower + side, upper + next, upper + side]);
        }
        let last = top - SIDES;
        mesh.triangles.push([last + side, last + next, top]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn volume(shape: &Shape) -> f64 {
        triangulate(shape).into_mesh().volume()
    }

    #[test]
    fn shapes_are_closed_and_face_outwards() {
        let half_extents = Vector3::new(0.1, 0.2, 0.3);
        assert!((volume(&Shape::Box { half_extents }) - 0.048).abs() < 1e-12);
        let cylinder = volume(&Shape::Cylinder { radius: 0.1, half_length: 0.2 });
        assert!((cylinder / (PI * 0.01 * 0.4) - 1.0).abs() < 0.02, "{cylinder}");
        let sphere = volume(&Shape::Sphere { radius: 0.1 });
        assert!((sphere / (PI * 4.0 / 3.0 * 0.001) - 1.0).abs() < 0.04, "{sphere}");
        // A mesh that is moved keeps its volume only if no face is missing.
        let Mesh { vertices, triangles } = triangulate(&Shape::Sphere { radius: 0.1 }).into_mesh();
        let vertices = vertices.iter().map(|v| v + Vector3::new(3.0, -2.0, 5.0)).collect();
        assert!((volume(&Shape::Mesh { vertices, triangles }) - sphere).abs() < 1e-9);
    }
}
