//! Where and how a camera looks.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A pinhole lens: what projects a point in the optical frame (x right, y down, z forward) to a pixel.
/// The centre of the first pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pinhole {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Principal point, x, pixels.
    pub cx_px: f64,
    /// Principal point, y, pixels.
    pub cy_px: f64,
}

impl Pinhole {
    /// The pixel of a point, and its depth; `None` for a point that is not in front of the camera.
    pub fn project(&self, p: &Point3<f64>) -> Option<([f64; 2], f64)> {
        (p.z > 0.0).then(|| ([self.fx_px * p.x / p.z + self.cx_px, self.fy_px * p.y / p.z + self.cy_px], p.z))
    }

    /// Direction of the ray through a pixel, with z = 1.
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx_px) / self.fx_px, (v - self.cy_px) / self.fy_px, 1.0)
    }
}

/// Pose of an optical frame at `eye` that looks at `target`, with the image's upper edge towards `up`.
/// Looking straight along `up` is allowed: the upper edge then points along the world's y axis.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>, up: &Vector3<f64>) -> Isometry3<f64> {
    let z = (target - eye).try_normalize(1e-12).unwrap_or_else(|| -Vector3::z());
    let x = z.cross(up).try_normalize(1e-6).or_else(|| z.cross(&Vector3::y()).try_normalize(1e-6));
    let x = x.unwrap_or_else(Vector3::x);
    let y = z.cross(&x);
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[x, y, z]);
    Isometry3::from_parts(eye.coords.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looking_at_a_point_puts_it_in_the_middle() {
        let lens = Pinhole { width: 100, height: 80, fx_px: 90.0, fy_px: 90.0, cx_px: 49.5, cy_px: 39.5 };
        for eye in [Point3::new(0.3, -0.4, 0.7), Point3::new(0.0, 0.0, 0.9)] {
            let world_from_camera = look_at(&eye, &Point3::origin(), &Vector3::z());
            let (pixel, depth) = lens.project(&(world_from_camera.inverse() * Point3::origin())).unwrap();
            assert!((pixel[0] - 49.5).abs() < 1e-9 && (pixel[1] - 39.5).abs() < 1e-9);
            assert!((depth - eye.coords.norm()).abs() < 1e-9);
            // The image's upper edge is up: a point above the target projects above the middle.
            let above = world_from_camera.inverse() * Point3::new(0.0, 0.1, 0.1);
            assert!(lens.project(&above).unwrap().0[1] < 39.5);
        }
    }
}
