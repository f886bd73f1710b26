//! The simulated camera: a pinhole that looks down at the table, and the rays it casts.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::objects::Placed;
use super::sensor::Noise;

/// Half extents of the table top, metres.
const TABLE_HALF_M: [f64; 2] = [0.60, 0.45];
/// Height of the floor under the table top, metres.
const FLOOR_M: f64 = -0.72;
/// Rays end here.
const FAR_M: f64 = 3.0;
/// Standard deviation of where in its pixel a ray really looks, pixels (Kinect-like lateral noise).
const LATERAL_PX: f64 = 0.45;

/// A pinhole camera in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Camera {
    /// Width, pixels.
    pub(crate) width: usize,
    /// Height, pixels.
    pub(crate) height: usize,
    /// Focal length, pixels.
    pub(crate) focal_px: f64,
    /// Principal point, pixels.
    pub(crate) cx_px: f64,
    /// Principal point, pixels.
    pub(crate) cy_px: f64,
    /// Takes optical coordinates to world coordinates.
    pub(crate) world_from_camera: Isometry3<f64>,
}

/// What one ray met.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Hit {
    /// Distance along the optical axis, metres; 0 for nothing.
    pub(crate) z_m: f64,
    /// Cosine between the surface normal and the direction back to the camera.
    pub(crate) facing: f64,
}

impl Camera {
    /// 0.66 m from the middle of the table, tilted 33° from vertical, a bit to one side.
    pub(crate) fn above_table() -> Self {
        let (tilt, azimuth) = (33f64.to_radians(), -78f64.to_radians());
        let away = Vector3::new(tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos());
        let eye = Point3::new(0.0, 0.0, 0.03) + away * 0.66;
        let z = -away;
        let x = z.cross(&Vector3::z()).normalize();
        let y = z.cross(&x);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            Matrix3::from_columns(&[x, y, z]),
        ));
        Self {
            width: 640,
            height: 480,
            focal_px: 585.0,
            cx_px: 319.5,
            cy_px: 239.5,
            world_from_camera: Isometry3::from_parts(Translation3::from(eye.coords), rotation),
        }
    }

    /// Direction through pixel (u, v), camera frame, with unit z.
    pub(crate) fn direction(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx_px) / self.focal_px, (v - self.cy_px) / self.focal_px, 1.0)
    }

    /// Casts one ray per pixel; each looks slightly beside its pixel's centre.
    pub(crate) fn cast(&self, objects: &[Placed], seed: u64) -> Vec<Hit> {
        (0..self.width * self.height)
            .into_par_iter()
            .map(|i| {
                let mut noise = Noise::new(seed ^ 0x7a11, i as u64);
                let u = (i % self.width) as f64 + LATERAL_PX * noise.normal();
                let v = (i / self.width) as f64 + LATERAL_PX * noise.normal();
                let along = self.direction(u, v);
                self.trace(objects, &along)
            })
            .collect()
    }

    fn trace(&self, objects: &[Placed], along: &Vector3<f64>) -> Hit {
        let length = along.norm();
        let direction = self.world_from_camera.rotation * (along / length);
        let eye = Point3::from(self.world_from_camera.translation.vector);
        let flat = ground(&eye, &direction);
        // Objects whose bounding ball the ray misses need no tracing.
        let near: Vec<&Placed> = objects
            .iter()
            .filter(|o| {
                let to = o.origin - eye;
                (to - direction * to.dot(&direction)).norm() < o.shape.bound() + 0.01
            })
            .collect();
        let mut t = 0.0;
        for _ in 0..160 {
            let p = eye + direction * t;
            let d = near.iter().map(|o| o.distance(&p)).fold(f64::INFINITY, f64::min);
            if d < 5e-5 {
                let normal = gradient(&near, &p);
                return Hit { z_m: t / length, facing: -normal.dot(&direction) };
            }
            t += d;
            if t > flat {
                break;
            }
        }
        if flat > FAR_M { Hit::default() } else { Hit { z_m: flat / length, facing: -direction.z } }
    }
}

/// Distance along the ray to the table top, else to the floor; infinite for a ray that looks up.
fn ground(eye: &Point3<f64>, direction: &Vector3<f64>) -> f64 {
    if direction.z >= -1e-6 {
        return f64::INFINITY;
    }
    let table = -eye.z / direction.z;
    let p = eye + direction * table;
    if p.x.abs() <= TABLE_HALF_M[0] && p.y.abs() <= TABLE_HALF_M[1] {
        table
    } else {
        (FLOOR_M - eye.z) / direction.z
    }
}

/// Unit normal of the union of `objects` near `p`, by central differences.
fn gradient(objects: &[&Placed], p: &Point3<f64>) -> Vector3<f64> {
    let at = |d: Vector3<f64>| objects.iter().map(|o| o.distance(&(p + d))).fold(f64::INFINITY, f64::min);
    let h = 2e-4;
    let g = Vector3::new(
        at(Vector3::x() * h) - at(-Vector3::x() * h),
        at(Vector3::y() * h) - at(-Vector3::y() * h),
        at(Vector3::z() * h) - at(-Vector3::z() * h),
    );
    g.try_normalize(1e-12).unwrap_or_else(Vector3::z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo_scene::shape::Shape;

    #[test]
    fn a_ray_meets_a_ball_where_geometry_says() {
        let camera = Camera::above_table();
        let ball = crate::demo_scene::objects::clutter()
            .into_iter()
            .find(|o| matches!(o.shape, Shape::Ball { .. }))
            .unwrap();
        let Shape::Ball { radius } = ball.shape else { panic!("a ball") };
        let center = camera.world_from_camera.inverse() * (ball.origin + Vector3::z() * radius);
        let along = center.coords / center.z;
        let hit = camera.trace(&[ball], &along);
        let expected = (center.coords.norm() - radius) / along.norm();
        assert!((hit.z_m - expected).abs() < 2e-4, "{} {expected}", hit.z_m);
        assert!(hit.facing > 0.999);
    }

    #[test]
    fn camera_looks_at_the_table_from_the_stated_pose() {
        let camera = Camera::above_table();
        let axis = camera.world_from_camera.rotation * Vector3::z();
        let tilt = (-axis.z).acos().to_degrees();
        assert!((tilt - 33.0).abs() < 1e-9);
        let down = camera.world_from_camera.rotation * Vector3::y();
        assert!(down.z < 0.0, "y points down in the image");
    }
}
