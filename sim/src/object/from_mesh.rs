//! Objects from a user's mesh: checked, scaled, centred, and cut into convex parts.

use std::collections::HashMap;
use std::sync::Arc;

use nalgebra::Point3;
use parry3d_f64::transformation::try_convex_hull;
use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};

use super::{Object, ObjectError, Source, Surface, centroid, check_properties};
use crate::convert;
use crate::mesh::Mesh;

/// Most triangles of a user's mesh.
pub(crate) const MOST_TRIANGLES: usize = 200_000;
/// Smallest and largest extent along each axis, metres.
const EXTENTS_M: (f64, f64) = (0.001, 1.0);
/// Most convex parts.
const MOST_PARTS: usize = 64;
/// Most points of a convex part.
const MOST_CORNERS: usize = 20_000;
/// Resolution of the decomposition's voxels along the longest side.
const RESOLUTION: u32 = 64;

/// How a mesh becomes heavy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Filling {
    /// Mass over enclosed volume, kilograms per cubic metre.
    Density(f64),
    /// Mass, kilograms.
    Mass(f64),
}

/// What a mesh does not say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshOptions {
    /// Metres in a unit of the file: 0.001 for millimetres.
    pub scale: f64,
    /// How heavy it is.
    pub filling: Filling,
    /// Coulomb friction of its surface.
    pub friction: f64,
    /// What a depth camera gets back from it.
    pub surface: Surface,
}

impl Default for MeshOptions {
    /// A file in metres, filled as loosely as household things are.
    fn default() -> Self {
        Self { scale: 1.0, filling: Filling::Density(500.0), friction: 0.5, surface: Surface::default() }
    }
}

impl Object {
    /// An object from a closed mesh, whose z is its upright axis. Equal vertices are joined, a mesh that is
    /// inside out is turned, the origin moves to the centre of mass, and convex parts are found by V-HACD.
    ///
    /// # Errors
    /// [`ObjectError::Mesh`] for a mesh that is empty, open, flat, not finite or too large, and
    /// [`ObjectError::Size`] for options out of bounds.
    pub fn from_mesh(
        name: impl Into<String>,
        mesh: Mesh,
        options: &MeshOptions,
    ) -> Result<Self, ObjectError> {
        ObjectError::check("scale", options.scale, (1e-6, 1e3))?;
        let mut mesh = mesh;
        mesh.vertices.iter_mut().for_each(|v| *v *= options.scale);
        let mut mesh = check_solid(weld(check_size(mesh)?))?;
        let mass_kg = match options.filling {
            Filling::Mass(mass) => mass,
            Filling::Density(density) => density * mesh.volume(),
        };
        check_properties(mass_kg, options.friction, &options.surface)?;
        let mut parts = decompose(&mesh);
        if parts.is_empty() {
            return Err(ObjectError::Mesh {
                found: "no convex part with a volume".into(),
                expected: "a closed solid",
            });
        }
        let center = centroid(&parts);
        mesh.vertices.iter_mut().chain(parts.iter_mut().flatten()).for_each(|p| *p -= center);
        Ok(Self {
            name: name.into(),
            mesh: Arc::new(mesh),
            parts,
            mass_kg,
            friction: options.friction,
            surface: options.surface,
            source: Source::Mesh,
        })
    }
}

/// A mesh whose numbers can be worked with.
fn check_size(mesh: Mesh) -> Result<Mesh, ObjectError> {
    let wrong = |found: String, expected| Err(ObjectError::Mesh { found, expected });
    let (vertices, triangles) = (mesh.vertices.len(), mesh.triangles.len());
    if !(4..=MOST_TRIANGLES).contains(&triangles) || vertices > 3 * MOST_TRIANGLES {
        return wrong(
            format!("{triangles} triangles, {vertices} vertices"),
            "4 to 200,000 triangles that enclose a solid",
        );
    }
    if let Some(t) = mesh.triangles.iter().find(|t| t.iter().any(|&i| i as usize >= vertices)) {
        return wrong(format!("triangle {t:?} of {vertices} vertices"), "indices of vertices");
    }
    if let Some(v) = mesh.vertices.iter().find(|v| !v.iter().all(|c| c.is_finite() && c.abs() < 1e3)) {
        return wrong(format!("a vertex at {:?}", v.coords.as_slice()), "finite coordinates near the origin");
    }
    // Only vertices of triangles count.
    let mut corners = mesh.triangles.iter().flatten().map(|&i| mesh.vertices[i as usize]);
    let first = corners.next().unwrap_or_default();
    let (low, high) = corners.fold((first, first), |(low, high), v| (low.inf(&v), high.sup(&v)));
    let extent = high - low;
    if extent.iter().any(|e| !(EXTENTS_M.0..=EXTENTS_M.1).contains(e)) {
        return wrong(
            format!("extents of {:?} m", extent.as_slice()),
            "1 mm to 1 m along each axis (a file in millimetres needs scale 0.001)",
        );
    }
    Ok(mesh)
}

/// Joins equal vertices, drops unused ones and triangles without an area.
fn weld(mesh: Mesh) -> Mesh {
    let mut index = HashMap::new();
    let mut out = Mesh::default();
    for triangle in &mesh.triangles {
        let t = triangle.map(|i| {
            let v = mesh.vertices[i as usize];
            // Adding 0.0 turns -0.0 into 0.0, so that both are equal.
            let key = [v.x + 0.0, v.y + 0.0, v.z + 0.0].map(f64::to_bits);
            *index.entry(key).or_insert_with(|| {
                out.vertices.push(v);
                (out.vertices.len() - 1) as u32
            })
        });
        if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            out.triangles.push(t);
        }
    }
    out
}

/// A closed mesh with a volume, turned outwards.
fn check_solid(mut mesh: Mesh) -> Result<Mesh, ObjectError> {
    // Each edge is passed as often one way as the other.
    let mut passes: HashMap<(u32, u32), i64> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let (key, way) = if a < b { ((a, b), 1) } else { ((b, a), -1) };
            *passes.entry(key).or_default() += way;
        }
    }
    let open = passes.values().filter(|&&p| p != 0).count();
    if open > 0 {
        return Err(ObjectError::Mesh {
            found: format!("{open} edges that do not have a triangle on both sides, turned alike"),
            expected: "a closed surface",
        });
    }
    let Some((low, high)) = mesh.bounds() else {
        return Err(ObjectError::Mesh { found: "no triangles".into(), expected: "a closed surface" });
    };
    let volume = mesh.volume();
    let all: f64 = (high - low).iter().product();
    if volume.abs() < 1e-4 * all {
        return Err(ObjectError::Mesh {
            found: format!("an enclosed volume of {volume:.3e} m³"),
            expected: "a solid",
        });
    }
    if volume < 0.0 {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Ok(mesh)
}

/// Checks a mesh and parts that were an object's once: a solid, and convex parts near it.
pub(crate) fn check_mesh(mesh: Mesh, parts: &[Vec<Point3<f64>>]) -> Result<Mesh, ObjectError> {
    let mesh = check_solid(check_size(mesh)?)?;
    let wrong = |found: String, expected| Err(ObjectError::Mesh { found, expected });
    if !(1..=MOST_PARTS).contains(&parts.len()) {
        return wrong(format!("{} parts", parts.len()), "1 to 64 convex parts");
    }
    let far = |p: &Point3<f64>| !p.iter().all(|c| c.abs() <= 2.0 * EXTENTS_M.1);
    for (index, part) in parts.iter().enumerate() {
        if part.len() > MOST_CORNERS {
            return wrong(format!("part {index} of {} points", part.len()), "at most 20,000 points");
        }
        if let Some(p) = part.iter().find(|p| far(p)) {
            return wrong(format!("part {index}: {:?}", p.coords.as_slice()), "points near the mesh");
        }
        if hull(part).is_none() {
            return wrong(format!("part {index} without a volume"), "convex parts with a volume");
        }
    }
    Ok(mesh)
}

/// Corners of the convex hull; `None` for points that span no volume.
fn hull(points: &[Point3<f64>]) -> Option<Vec<Point3<f64>>> {
    let points: Vec<_> = points.iter().map(convert::point).collect();
    let (corners, triangles) = try_convex_hull(&points).ok()?;
    let vertices: Vec<_> = corners.into_iter().map(|v| Point3::from(convert::from_vector(v))).collect();
    let mesh = Mesh { vertices, triangles };
    (mesh.volume() > 1e-12).then_some(mesh.vertices)
}

/// Convex parts: the mesh's own hull where that is what it is, else by V-HACD.
fn decompose(mesh: &Mesh) -> Vec<Vec<Point3<f64>>> {
    if let Some(corners) = hull(&mesh.vertices) {
        let points: Vec<_> = corners.iter().map(convert::point).collect();
        let hull_volume = try_convex_hull(&points).ok().map(|(corners, triangles)| {
            let vertices = corners.into_iter().map(|v| Point3::from(convert::from_vector(v))).collect();
            Mesh { vertices, triangles }.volume()
        });
        if hull_volume.is_some_and(|v| mesh.volume() > 0.99 * v) {
            return vec![corners];
        }
    }
    let points: Vec<_> = mesh.vertices.iter().map(convert::point).collect();
    let parameters = VHACDParameters {
        resolution: RESOLUTION,
        max_convex_hulls: MOST_PARTS as u32,
        ..VHACDParameters::default()
    };
    let decomposition = VHACD::decompose(&parameters, &points, &mesh.triangles, true);
    // Points where each part's voxels meet the surface: hulls made of them follow it, not the voxels.
    decomposition
        .voxel_parts()
        .iter()
        .filter(|part| part.voxels().iter().any(|v| v.is_on_surface))
        .filter_map(|part| {
            let points = part.compute_primitive_intersections(&points, &mesh.triangles);
            let points: Vec<_> = points.into_iter().map(|v| Point3::from(convert::from_vector(v))).collect();
            hull(&points)
        })
        .collect()
}
