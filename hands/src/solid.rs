//! Signed distances and surface samples of shapes, for covering them with spheres.
//!
//! The one place that speaks to parry (which speaks glam).

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d_f64::math::Vector as Glam;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

use crate::Shape;

/// A shape prepared for distance queries, placed in some frame.
pub(crate) struct Solid<'a> {
    /// Takes shape coordinates to the frame of the queries.
    pose: Isometry3<f64>,
    shape: &'a Shape,
    mesh: Option<TriMesh>,
}

fn glam(p: &Point3<f64>) -> Glam {
    Glam::new(p.x, p.y, p.z)
}

impl<'a> Solid<'a> {
    /// Prepares a shape. `None` for a mesh from which no solid can be made.
    pub(crate) fn new(pose: Isometry3<f64>, shape: &'a Shape) -> Option<Self> {
        let mesh = match shape {
            Shape::Mesh { vertices, triangles } => {
                Some(TriMesh::new(vertices.iter().map(glam).collect(), triangles.clone()).ok()?)
            }
            _ => None,
        };
        Some(Self { pose, shape, mesh })
    }

    /// Distance to the surface: positive inside, negative outside.
    pub(crate) fn depth(&self, at: &Point3<f64>) -> f64 {
        let p = self.pose.inverse_transform_point(at);
        match self.shape {
            Shape::Sphere { radius } => radius - p.coords.norm(),
            Shape::Box { half_extents } => {
                let q = p.coords.abs() - half_extents;
                -(q.sup(&Vector3::zeros()).norm() + q.max().min(0.0))
            }
            Shape::Cylinder { radius, half_length } => {
                let (side, cap) = (p.coords.xy().norm() - radius, p.z.abs() - half_length);
                -(side.max(0.0).hypot(cap.max(0.0)) + side.max(cap).min(0.0))
            }
            Shape::Mesh { .. } => {
                let Some(mesh) = &self.mesh else { return f64::NEG_INFINITY };
                let local = glam(&p);
                let distance = (mesh.project_local_point(local, false).point - local).length();
                if inside(mesh, local) { distance } else { -distance }
            }
        }
    }

    /// Axis-aligned bounds in the query frame.
    pub(crate) fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        let (low, high) = self.local_bounds();
        let (mut min, mut max) = (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3]));
        for corner in 0..8 {
            let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
            let p = self.pose * Point3::new(pick(0), pick(1), pick(2));
            (min, max) = (min.inf(&p), max.sup(&p));
        }
        (min, max)
    }

    /// Axis-aligned bounds in the shape's own frame.
    pub(crate) fn local_bounds(&self) -> (Point3<f64>, Point3<f64>) {
        match self.shape {
            Shape::Sphere { radius } => (Point3::from([-radius; 3]), Point3::from([*radius; 3])),
            Shape::Box { half_extents } => ((-half_extents).into(), (*half_extents).into()),
            Shape::Cylinder { radius, half_length } => {
                let high = Point3::new(*radius, *radius, *half_length);
                (-high, high)
            }
            Shape::Mesh { vertices, .. } => vertices.iter().fold(
                (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3])),
                |(low, high), v| (low.inf(v), high.sup(v)),
            ),
        }
    }

    /// A grid through the inside, symmetric about the shape's middle, with at most `spacing` between
    /// points and at least one plane through the middle; points in the query frame.
    pub(crate) fn grid(&self, spacing: f64, most: usize) -> Vec<Point3<f64>> {
        let (low, high) = self.local_bounds();
        let size = high - low;
        let steps = |axis: usize, spacing: f64| {
            let n = (size[axis] / spacing).ceil().clamp(1.0, 1000.0) as usize;
            if n.is_multiple_of(2) { n + 1 } else { n }
        };
        let grid = |spacing: f64| [steps(0, spacing), steps(1, spacing), steps(2, spacing)];
        // Coarser for large shapes: `most` bounds the work.
        let mut spacing = spacing;
        while grid(spacing).iter().product::<usize>() > most.max(1) && spacing < 10.0 {
            spacing *= 1.1;
        }
        let n = grid(spacing);
        let mut out = Vec::with_capacity(n.iter().product());
        for x in 0..n[0] {
            for y in 0..n[1] {
                for z in 0..n[2] {
                    let fraction =
                        |axis: usize, i: usize| low[axis] + size[axis] * (i as f64 + 0.5) / n[axis] as f64;
                    let p = self.pose * Point3::new(fraction(0, x), fraction(1, y), fraction(2, z));
                    if self.depth(&p) > 0.0 {
                        out.push(p);
                    }
                }
            }
        }
        out
    }

    /// Points on the surface, about `spacing` apart, corners and edges included; in the query frame.
    pub(crate) fn surface(&self, spacing: f64) -> Vec<Point3<f64>> {
        let mut local = Vec::new();
        match self.shape {
            Shape::Box { half_extents: h } => {
                for axis in 0..3 {
                    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                    for a in spread(-h[u], h[u], spacing) {
                        for b in spread(-h[v], h[v], spacing) {
                            for side in [-h[axis], h[axis]] {
                                let mut p = Point3::origin();
                                (p[axis], p[u], p[v]) = (side, a, b);
                                local.push(p);
                            }
                        }
                    }
                }
            }
            Shape::Cylinder { radius, half_length } => {
                for z in spread(-half_length, *half_length, spacing) {
                    ring(*radius, z, spacing, &mut local);
                }
                for r in spread(0.0, *radius, spacing) {
                    ring(r, *half_length, spacing, &mut local);
                    ring(r, -half_length, spacing, &mut local);
                }
            }
            Shape::Sphere { radius } => {
                let arc = std::f64::consts::PI * radius;
                for s in spread(0.0, arc, spacing) {
                    let (sin, cos) = (s / radius).sin_cos();
                    ring(radius * sin, radius * cos, spacing, &mut local);
                }
            }
            Shape::Mesh { vertices, triangles } => {
                for t in triangles {
                    let [a, b, c] = t.map(|i| vertices[i as usize]);
                    let longest = (b - a).norm().max((c - a).norm()).max((c - b).norm());
                    let n = (longest / spacing).ceil().clamp(1.0, 500.0) as usize;
                    for i in 0..=n {
                        for j in 0..=n - i {
                            let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
                            local.push(a + (b - a) * u + (c - a) * v);
                        }
                    }
                }
            }
        }
        local.iter().map(|p| self.pose * p).collect()
    }

    /// Rough surface area, square metres.
    pub(crate) fn area(&self) -> f64 {
        match self.shape {
            Shape::Box { half_extents: h } => 8.0 * (h.x * h.y + h.y * h.z + h.z * h.x),
            Shape::Cylinder { radius, half_length } => {
                std::f64::consts::TAU * radius * (radius + 2.0 * half_length)
            }
            Shape::Sphere { radius } => 2.0 * std::f64::consts::TAU * radius * radius,
            Shape::Mesh { vertices, triangles } => triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(|i| vertices[i as usize]);
                    (b - a).cross(&(c - a)).norm() / 2.0
                })
                .sum(),
        }
    }
}

/// Values from `low` to `high`, both included, at most `spacing` apart.
fn spread(low: f64, high: f64, spacing: f64) -> impl Iterator<Item = f64> {
    let n = ((high - low) / spacing).ceil().clamp(1.0, 1000.0);
    (0..=n as usize).map(move |i| low + (high - low) * i as f64 / n)
}

fn ring(radius: f64, z: f64, spacing: f64, out: &mut Vec<Point3<f64>>) {
    let n = (std::f64::consts::TAU * radius / spacing).ceil().clamp(1.0, 1000.0);
    for i in 0..n as usize {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / n).sin_cos();
        out.push(Point3::new(radius * cos, radius * sin, z));
    }
}

/// Whether a point is inside a mesh: the majority of three rays counts an odd number of crossings.
///
/// Needs neither a closed mesh nor consistent triangles, which exported meshes often lack.
fn inside(mesh: &TriMesh, p: Glam) -> bool {
    // Skewed directions: rays along the axes run through edges of CAD models.
    let directions =
        [Glam::new(0.961, 0.213, 0.177), Glam::new(-0.195, 0.957, 0.214), Glam::new(0.183, -0.241, 0.953)];
    directions.iter().filter(|&&d| crossings(mesh, p, d) % 2 == 1).count() >= 2
}

fn crossings(mesh: &TriMesh, mut origin: Glam, direction: Glam) -> usize {
    const STEP: f64 = 1e-7;
    let mut count = 0;
    while count < 64 {
        let Some(t) = mesh.cast_local_ray(&Ray::new(origin, direction), 10.0, false) else { break };
        origin += direction * (t + STEP);
        count += 1;
    }
    count
}

impl std::fmt::Debug for Solid<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Solid").field("pose", &self.pose).field("shape", &self.shape).finish_non_exhaustive()
    }
}
