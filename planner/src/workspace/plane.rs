//! Finding the table: the largest plane that a camera above it would see, by seeded random sampling and
//! least squares.

use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::points::FramePoints;

/// Planes tried.
const TRIALS: usize = 600;
/// Points on which a trial is scored.
const SCORED: usize = 1500;
/// A point within this distance of a plane belongs to it, metres.
const INLIER_M: f64 = 0.008;
/// A table holds at least this share of the points.
const MIN_SHARE: f64 = 0.12;
/// Largest angle between the table's normal and the direction against the optical axis, radians: cameras that
/// look more flatly over a table do not see it well enough to find it.
const MAX_TILT_RAD: f64 = 1.36;
/// With a known pose, a plane within this angle of horizontal is preferred, radians.
const LEVEL_RAD: f64 = 0.26;

/// A plane `normal · p + offset = 0` in the optical frame, the normal towards the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Towards the camera.
    pub normal: Unit<Vector3<f64>>,
    /// Distance of the camera from the plane, metres.
    pub offset_m: f64,
    /// Share of the points that belong to it.
    pub share: f64,
}

impl Plane {
    /// Signed distance of a point, metres, positive on the camera's side.
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) + self.offset_m
    }
}

/// The table, if the points show one. Deterministic.
pub fn find_table(points: &FramePoints) -> Option<Plane> {
    let all = &points.camera;
    if all.len() < 50 {
        return None;
    }
    let up = points.posed.then(|| points.world_from_camera.inverse_transform_vector(&Vector3::z()));

    let mut rng = Xoshiro256PlusPlus::seed_from_u64(0x7AB1E);
    // Drawn, not strided: a stride can beat with the image's rows.
    let scored: Vec<Point3<f64>> = (0..SCORED).map(|_| all[rng.random_range(0..all.len())]).collect();
    let mut best: Option<(f64, Plane)> = None;
    for _ in 0..TRIALS {
        let pick: [Point3<f64>; 3] = std::array::from_fn(|_| all[rng.random_range(0..all.len())]);
        let Some(plane) = through(&pick) else { continue };
        if !admissible(&plane) {
            continue;
        }
        // What lies clearly below a table is seen past its edge: a plane with much below it is a box's top.
        let mut score: f64 = scored
            .iter()
            .map(|p| {
                let height = plane.height(p);
                if height.abs() < INLIER_M {
                    1.0
                } else if height < -3.0 * INLIER_M {
                    -0.25
                } else {
                    0.0
                }
            })
            .sum();
        if let Some(up) = &up
            && plane.normal.angle(up) > LEVEL_RAD
        {
            score *= 0.4;
        }
        if best.as_ref().is_none_or(|(s, _)| score > *s) {
            best = Some((score, plane));
        }
    }
    let (_, mut plane) = best?;
    for width in [1.5, 1.0, 1.0, 1.0] {
        let inliers = all.iter().filter(|p| plane.height(p).abs() < width * INLIER_M);
        let fitted = fit(inliers)?;
        if !admissible(&fitted) {
            return None;
        }
        plane = fitted;
    }
    let inliers = all.iter().filter(|p| plane.height(p).abs() < INLIER_M).count();
    plane.share = inliers as f64 / all.len() as f64;
    (plane.share >= MIN_SHARE).then_some(plane)
}

/// The camera is above the table and looks down on it.
fn admissible(plane: &Plane) -> bool {
    plane.offset_m > 0.05 && -plane.normal.z > MAX_TILT_RAD.cos()
}

fn facing(normal: Vector3<f64>, on: &Vector3<f64>) -> Option<Plane> {
    let normal = Unit::try_new(normal, 1e-9)?;
    let offset_m = -normal.dot(on);
    let plane = if offset_m < 0.0 {
        Plane { normal: -normal, offset_m: -offset_m, share: 0.0 }
    } else {
        Plane { normal, offset_m, share: 0.0 }
    };
    Some(plane)
}

fn through(p: &[Point3<f64>; 3]) -> Option<Plane> {
    let (a, b) = (p[1] - p[0], p[2] - p[0]);
    let n = a.cross(&b);
    // Points close together or on a line say nothing about a plane.
    (n.norm() > 1e-3 * a.norm().max(b.norm()) && a.norm() > 0.03 && b.norm() > 0.03)
        .then(|| facing(n, &p[0].coords))
        .flatten()
}

/// Least squares: the direction of least scatter about the mean.
fn fit<'a>(points: impl Iterator<Item = &'a Point3<f64>>) -> Option<Plane> {
    let (mut count, mut sum, mut square) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for p in points {
        count += 1.0;
        sum += p.coords;
        square += p.coords * p.coords.transpose();
    }
    if count < 10.0 {
        return None;
    }
    let mean = sum / count;
    let eigen = (square / count - mean * mean.transpose()).symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    facing(eigen.eigenvectors.column(least).into_owned(), &mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, UnitQuaternion};
    use proptest::prelude::*;

    /// A table with boxes on it, seen by a camera that looks at its middle from `distance` at `tilt`, rolled.
    fn table(tilt: f64, roll: f64, distance: f64, noise: f64) -> (FramePoints, Vector3<f64>) {
        let camera_from_table = Isometry3::translation(0.0, 0.0, distance)
            * UnitQuaternion::from_euler_angles(0.0, 0.0, roll)
            * UnitQuaternion::from_euler_angles(std::f64::consts::PI - tilt, 0.0, 0.0);
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(5);
        let mut camera = Vec::new();
        for i in 0..60 {
            for j in 0..60 {
                let (x, y) = (0.01 * f64::from(i) - 0.3, 0.01 * f64::from(j) - 0.3);
                let on_box = (5..15).contains(&(i % 20)) && (5..15).contains(&(j % 30));
                let z = if on_box { 0.06 } else { 0.0 } + noise * (rng.random::<f64>() - 0.5);
                camera.push(camera_from_table * Point3::new(x, y, z));
            }
        }
        let eccentricity = vec![0.0; camera.len()];
        let points =
            FramePoints { camera, eccentricity, world_from_camera: Isometry3::identity(), posed: false };
        (points, camera_from_table * Vector3::z())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn finds_the_table_from_any_side(
            tilt in 0.0f64..1.2, roll in -3.1f64..3.1, distance in 0.5f64..1.2, noise in 0.0f64..0.006,
        ) {
            let (points, up) = table(tilt, roll, distance, noise);
            let plane = find_table(&points).unwrap();
            prop_assert!(plane.normal.angle(&up) < 0.01, "{}", plane.normal.angle(&up));
            prop_assert!((plane.offset_m - distance * tilt.cos()).abs() < 0.003);
        }
    }

    #[test]
    fn nothing_and_noise_have_no_table() {
        let (mut points, _) = table(0.5, 0.0, 0.8, 0.0);
        points.camera.truncate(20);
        assert!(find_table(&points).is_none());
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        points.camera = (0..3000)
            .map(|_| Point3::new(rng.random::<f64>(), rng.random::<f64>(), 0.5 + rng.random::<f64>()))
            .collect();
        assert!(find_table(&points).is_none());
    }

    #[test]
    fn a_known_pose_prefers_the_level_plane() {
        // A wall larger than the floor; only the pose says which is which.
        let mut camera = Vec::new();
        for i in 0..60 {
            for j in 0..60 {
                let (a, b) = (0.02 * f64::from(i) - 0.6, 0.02 * f64::from(j) - 0.6);
                camera.push(Point3::new(a, b - 0.6, 1.5));
                if j % 2 == 0 {
                    let s = std::f64::consts::FRAC_1_SQRT_2;
                    camera.push(Point3::new(a, 0.6 - s * (b + 0.6), 0.9 + s * (b + 0.6)));
                }
            }
        }
        let up_in_camera = Vector3::new(0.0, -1.0, -1.0).normalize();
        let rotation = nalgebra::UnitQuaternion::rotation_between(&up_in_camera, &Vector3::z()).unwrap();
        let world_from_camera = Isometry3::from_parts(nalgebra::Translation3::identity(), rotation);
        let eccentricity = vec![0.0; camera.len()];
        let mut points = FramePoints { camera, eccentricity, world_from_camera, posed: true };
        assert!(find_table(&points).unwrap().normal.angle(&up_in_camera) < 0.02);
        points.posed = false;
        assert!(find_table(&points).unwrap().normal.angle(&-Vector3::z()) < 0.02);
    }
}
