//! Building blocks of the families: grids of points skinned with triangles, prisms, and convex pieces of them.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use nalgebra::{Point3, Vector3};

use crate::mesh::Mesh;

/// Corners of a full turn in the meshes of round things: 0.9 % of the radius is lost between two of them.
pub(super) const TURN: usize = 24;

/// What a family makes: how it looks and what collides.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Geometry {
    /// Closed shells, triangles facing outwards.
    pub(super) mesh: Mesh,
    /// Vertices of convex parts whose union is the shells' inside.
    pub(super) parts: Vec<Vec<Point3<f64>>>,
}

impl Geometry {
    /// A convex body: its mesh's vertices are its one part.
    pub(super) fn convex(mesh: Mesh) -> Self {
        let parts = vec![mesh.vertices.clone()];
        Self { mesh, parts }
    }

    /// Adds another body that may overlap with this one.
    pub(super) fn join(&mut self, other: Self) {
        self.mesh.append(&other.mesh, &nalgebra::Isometry3::identity());
        self.parts.extend(other.parts);
    }

    /// Moves every point.
    pub(super) fn map(mut self, f: impl Fn(&Point3<f64>) -> Point3<f64>) -> Self {
        self.mesh.vertices.iter_mut().chain(self.parts.iter_mut().flatten()).for_each(|p| *p = f(p));
        self
    }
}

/// Rings of points, each the same number of corners counter-clockwise seen from the way the rings go.
#[derive(Debug, Clone, Default)]
pub(super) struct Grid {
    pub(super) rings: Vec<Vec<Point3<f64>>>,
}

impl Grid {
    /// Rings around z at these radii and heights.
    pub(super) fn revolve(profile: &[[f64; 2]]) -> Self {
        Self::around(profile.len(), |ring, angle| {
            let [r, z] = profile[ring];
            Point3::new(r * angle.cos(), r * angle.sin(), z)
        })
    }

    /// `count` rings of [`TURN`] points, each a function of ring and angle.
    pub(super) fn around(count: usize, point: impl Fn(usize, f64) -> Point3<f64>) -> Self {
        let ring = |i| (0..TURN).map(|k| point(i, TAU * k as f64 / TURN as f64)).collect();
        Self { rings: (0..count).map(ring).collect() }
    }

    /// Skin between the rings, closed at both ends by a fan around a point.
    pub(super) fn capped(&self, first: Point3<f64>, last: Point3<f64>) -> Mesh {
        let mut mesh = self.skin(false);
        let (first_at, last_at) = (mesh.vertices.len() as u32, mesh.vertices.len() as u32 + 1);
        mesh.vertices.extend([first, last]);
        let turn = self.rings.first().map_or(0, Vec::len) as u32;
        let top = turn * (self.rings.len() as u32).saturating_sub(1);
        for k in 0..turn {
            let next = (k + 1) % turn;
            mesh.triangles.push([first_at, next, k]);
            mesh.triangles.push([last_at, top + k, top + next]);
        }
        mesh
    }

    /// Skin between the rings, the last joined to the first.
    pub(super) fn looped(&self) -> Mesh {
        self.skin(true)
    }

    fn skin(&self, looped: bool) -> Mesh {
        let turn = self.rings.first().map_or(0, Vec::len) as u32;
        let count = self.rings.len() as u32;
        let mut triangles = Vec::new();
        for ring in 0..if looped { count } else { count.saturating_sub(1) } {
            let (low, high) = (ring * turn, (ring + 1) % count * turn);
            for k in 0..turn {
                let next = (k + 1) % turn;
                triangles.push([low + k, low + next, high + next]);
                triangles.push([low + k, high + next, high + k]);
            }
        }
        Mesh { vertices: self.rings.iter().flatten().copied().collect(), triangles }
    }

    /// The points of some rings, whole turns.
    pub(super) fn slice(&self, rings: RangeInclusive<usize>) -> Vec<Point3<f64>> {
        self.rings[rings].iter().flatten().copied().collect()
    }

    /// The points of some rings between two corners of the turn, both included.
    pub(super) fn patch(
        &self,
        rings: RangeInclusive<usize>,
        corners: RangeInclusive<usize>,
    ) -> Vec<Point3<f64>> {
        let mut out = Vec::new();
        for ring in &self.rings[rings] {
            out.extend(corners.clone().map(|k| ring[k % ring.len()]));
        }
        out
    }
}

/// A prism over a polygon (counter-clockwise) whose cap is given as triangles; centred in height.
pub(super) fn prism(polygon: &[[f64; 2]], cap: &[[u32; 3]], height: f64) -> Mesh {
    let n = polygon.len() as u32;
    let level = |z: f64| polygon.iter().map(move |&[x, y]| Point3::new(x, y, z));
    let vertices = level(-height / 2.0).chain(level(height / 2.0)).collect();
    let mut triangles = Vec::new();
    for &[a, b, c] in cap {
        triangles.push([a, c, b]);
        triangles.push([a + n, b + n, c + n]);
    }
    for k in 0..n {
        let next = (k + 1) % n;
        triangles.push([k, next, next + n]);
        triangles.push([k, next + n, k + n]);
    }
    Mesh { vertices, triangles }
}

/// The corners of a box between two corners.
pub(super) fn box_corners(low: [f64; 3], high: [f64; 3]) -> Vec<Point3<f64>> {
    let (low, high) = (Point3::from(low), Point3::from(high));
    let middle = nalgebra::center(&low, &high);
    let half: Vector3<f64> = (high - low) / 2.0;
    Mesh::cuboid(half).vertices.into_iter().map(|v| middle + v.coords).collect()
}

/// A bent round bar along a path of points in the xz plane, which must turn about +y from start to end.
/// `pieces` convex parts follow one another along it.
pub(super) fn bar(path: &[[f64; 2]], radius: f64, pieces: usize) -> Geometry {
    const CORNERS: usize = 10;
    let last = path.len() - 1;
    let at = |i: usize| Point3::new(path[i][0], 0.0, path[i][1]);
    let mut grid = Grid::default();
    for i in 0..=last {
        let along = (at((i + 1).min(last)) - at(i.saturating_sub(1))).normalize();
        let side = Vector3::y();
        let up = along.cross(&side);
        let ring = (0..CORNERS).map(|k| {
            let angle = TAU * k as f64 / CORNERS as f64;
            at(i) + (side * angle.cos() + up * angle.sin()) * radius
        });
        grid.rings.push(ring.collect());
    }
    // side × up = along: corners run counter-clockwise seen from the way the rings go.
    let pieces = pieces.clamp(1, last);
    let parts = (0..pieces).map(|p| grid.slice(p * last / pieces..=(p + 1) * last / pieces)).collect();
    Geometry { mesh: grid.capped(at(0), at(last)), parts }
}
