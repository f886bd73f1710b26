//! The exact surface of what lies on the table: points for collision checks, rays for contacts.

use std::collections::BTreeMap;

use graspd_sim::mesh::Mesh;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

/// Spacing of points on a model and on the table, metres: the benchmark's voxel size.
pub const SPACING_M: f64 = 0.008;
/// Half the side of the square of table points, metres: a table of 1 m by 1 m.
const TABLE_HALF_M: f64 = 0.5;
/// Thickness of the table, metres.
const TABLE_THICKNESS_M: f64 = 0.05;
/// Points of a triangle lie this densely before they are thinned, metres.
const FINE_M: f64 = 0.002;

/// Points of a mesh's surface, one per cube of [`SPACING_M`] (the mean of the dense samples in it), in the
/// mesh's frame and in an order that depends on nothing but the mesh.
pub fn sample(mesh: &Mesh) -> Vec<Point3<f64>> {
    let mut cubes: BTreeMap<[i64; 3], (Vector3<f64>, f64)> = BTreeMap::new();
    for triangle in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(triangle);
        let longest = (b - a).norm().max((c - a).norm()).max((c - b).norm());
        let steps = ((longest / FINE_M).ceil() as usize).max(1);
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                let p = a + (b - a) * u + (c - a) * v;
                let cube = [p.x, p.y, p.z].map(|x| (x / SPACING_M).floor() as i64);
                let entry = cubes.entry(cube).or_insert((Vector3::zeros(), 0.0));
                entry.0 += p.coords;
                entry.1 += 1.0;
            }
        }
    }
    cubes.into_values().map(|(sum, count)| Point3::from(sum / count)).collect()
}

/// Points of the table around the world's origin: a block of 1.0 x 1.0 x 0.05 m below z = 0, of which a gripper
/// can only reach the top layers.
pub fn table_points() -> Vec<Point3<f64>> {
    let side = (2.0 * TABLE_HALF_M / SPACING_M) as usize;
    let layers = (TABLE_THICKNESS_M / SPACING_M) as usize + 1;
    let at = |i: usize| -TABLE_HALF_M + i as f64 * SPACING_M;
    (0..side)
        .flat_map(|i| (0..side).map(move |j| (i, j)))
        .flat_map(|(i, j)| (0..layers).map(move |k| Point3::new(at(i), at(j), -(k as f64) * SPACING_M)))
        .collect()
}

/// Where a ray first meets a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the ray, metres.
    pub distance_m: f64,
    /// Outward normal of the surface.
    pub normal: Unit<Vector3<f64>>,
}

/// Where a line meets a triangle: the distance along its direction from the origin, negative behind it, and the
/// triangle's normal, not of unit length (Möller and Trumbore 1997, both sides).
pub(crate) fn meet(
    [a, b, c]: &[Point3<f64>; 3],
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
) -> Option<(f64, Vector3<f64>)> {
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(&e2);
    let determinant = e1.dot(&p);
    if determinant.abs() < 1e-14 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(&p) / determinant;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / determinant;
    let inside = u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9;
    inside.then(|| (e2.dot(&q) / determinant, e1.cross(&e2)))
}

/// The first triangle that a ray meets, from either side; all in the frame in which the mesh stands at `pose`.
pub fn cast(
    mesh: &Mesh,
    pose: &Isometry3<f64>,
    origin: &Point3<f64>,
    direction: &Unit<Vector3<f64>>,
) -> Option<Hit> {
    let origin = pose.inverse_transform_point(origin);
    let direction = pose.inverse_transform_unit_vector(direction);
    let mut first: Option<Hit> = None;
    for triangle in 0..mesh.triangles.len() {
        let corners = mesh.corners(triangle);
        let Some((distance_m, normal)) = meet(&corners, &origin, &direction) else { continue };
        if distance_m < 0.0 {
            continue;
        }
        if first.is_none_or(|f| distance_m < f.distance_m)
            && let Some(normal) = Unit::try_new(normal, 1e-18)
        {
            first = Some(Hit { distance_m, normal: pose.rotation * normal });
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_sampled_on_its_surface_and_evenly() {
        let mesh = Mesh::cuboid(Vector3::new(0.02, 0.03, 0.04));
        let points = sample(&mesh);
        // 2 (4·6 + 4·8 + 6·8) cm² at one point per 0.64 cm².
        assert!((250..500).contains(&points.len()), "{}", points.len());
        for p in &points {
            let depth = (0.02 - p.x.abs()).min(0.03 - p.y.abs()).min(0.04 - p.z.abs());
            assert!((-1e-9..SPACING_M).contains(&depth), "{p}");
        }
    }

    #[test]
    fn a_ray_meets_a_turned_box_where_it_should() {
        let mesh = Mesh::cuboid(Vector3::new(0.02, 0.03, 0.04));
        let pose = Isometry3::new(Vector3::new(0.1, 0.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let hit = cast(&mesh, &pose, &Point3::origin(), &Vector3::x_axis()).unwrap();
        assert!((hit.distance_m - 0.07).abs() < 1e-12 && (hit.normal.x + 1.0).abs() < 1e-12, "{hit:?}");
        assert_eq!(cast(&mesh, &pose, &Point3::new(0.0, 0.05, 0.0), &Vector3::x_axis()), None);
        assert_eq!(cast(&mesh, &pose, &Point3::new(0.2, 0.0, 0.0), &Vector3::x_axis()), None);
    }

    #[test]
    fn the_table_ends_at_zero() {
        let points = table_points();
        assert!(points.iter().all(|p| (-0.05..=0.0).contains(&p.z)));
        assert!(points.iter().filter(|p| p.z == 0.0).count() >= 125 * 125);
    }
}
