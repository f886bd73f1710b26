//! What the depth camera saw, as a surface with normals: for pictures and pages, not for planning.

use graspd_planner::frame::Frame;
use nalgebra::{Isometry3, Point3, Vector3};

/// Neighbours further apart than this share of their depth do not belong together.
const EDGE_SHARE: f64 = 0.02;

/// A depth image as points in the world; one per kept pixel, in rows.
#[derive(Debug, Clone)]
pub(crate) struct Surface {
    /// Points in a row.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    /// World frame; `None` without a return.
    pub(crate) points: Vec<Option<Point3<f64>>>,
    /// Unit normals towards the camera, world frame; zero without a return.
    pub(crate) normals: Vec<Vector3<f64>>,
}

impl Surface {
    /// Smooths and back-projects every `stride`-th pixel. Lens distortion is not undone: pictures do not need it.
    pub(crate) fn new(frame: &Frame, world_from_camera: &Isometry3<f64>, stride: usize) -> Self {
        let smooth = smoothed(frame);
        let (width, height) = (frame.image.width / stride, frame.image.height / stride);
        let lens = &frame.intrinsics;
        let camera_points: Vec<Option<Point3<f64>>> = (0..width * height)
            .map(|i| {
                let (u, v) = (i % width * stride, i / width * stride);
                let z = smooth[v * frame.image.width + u]?;
                Some(Point3::new(
                    (u as f64 - lens.cx_px) / lens.fx_px * z,
                    (v as f64 - lens.cy_px) / lens.fy_px * z,
                    z,
                ))
            })
            .collect();
        let at =
            |u: usize, v: usize| camera_points.get(v * width + u).copied().flatten().filter(|_| u < width);
        let mut normals = vec![Vector3::zeros(); width * height];
        for (i, normal) in normals.iter_mut().enumerate() {
            let (u, v) = (i % width, i / width);
            let Some(p) = camera_points[i] else { continue };
            let near = |q: Option<Point3<f64>>| q.filter(|q| (q.z - p.z).abs() < EDGE_SHARE * p.z);
            let right = near(at(u + 1, v)).unwrap_or(p);
            let left = u.checked_sub(1).and_then(|u| near(at(u, v))).unwrap_or(p);
            let down = near(at(u, v + 1)).unwrap_or(p);
            let up = v.checked_sub(1).and_then(|v| near(at(u, v))).unwrap_or(p);
            // y points down and z away: (down − up) × (right − left) faces the camera.
            let n = (down - up).cross(&(right - left));
            *normal =
                world_from_camera.rotation * n.try_normalize(1e-15).unwrap_or_else(|| -p.coords.normalize());
        }
        let points = camera_points.iter().map(|p| p.map(|p| world_from_camera * p)).collect();
        Self { width, height, points, normals }
    }

    /// Triangles between neighbours that belong together.
    pub(crate) fn triangles(&self, eye: &Point3<f64>) -> Vec<[u32; 3]> {
        let mut out = Vec::new();
        for v in 1..self.height {
            for u in 1..self.width {
                let (d, c) = (v * self.width + u, v * self.width + u - 1);
                let (b, a) = (d - self.width, c - self.width);
                for t in [[a, c, b], [b, c, d]] {
                    let [Some(p), Some(q), Some(r)] = t.map(|i| self.points[i]) else { continue };
                    let reach = (p - eye).norm() * EDGE_SHARE;
                    if (p - q).norm() < reach && (q - r).norm() < reach && (r - p).norm() < reach {
                        out.push(t.map(|i| i as u32));
                    }
                }
            }
        }
        out
    }
}

/// Depth after an edge-preserving mean over 7×7 pixels, which also closes pin holes.
fn smoothed(frame: &Frame) -> Vec<Option<f64>> {
    use rayon::prelude::*;
    let (width, height) = (frame.image.width, frame.image.height);
    let valid = |z: f32| (z.is_finite() && z > 0.0).then_some(f64::from(z));
    (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (u, v) = (i % width, i / width);
            let (us, vs) =
                (u.saturating_sub(3)..(u + 4).min(width), v.saturating_sub(3)..(v + 4).min(height));
            let around = || vs.clone().flat_map(|b| us.clone().map(move |a| b * width + a));
            let own = valid(frame.image.depth_m[i]);
            let middle = match own {
                Some(z) => z,
                None => {
                    // A hole is closed only if most of its surroundings are there and agree.
                    let mut near: Vec<f64> = around().filter_map(|j| valid(frame.image.depth_m[j])).collect();
                    if near.len() < 30 {
                        return None;
                    }
                    near.sort_by(f64::total_cmp);
                    if near[near.len() - 3] - near[2] > 0.6 * EDGE_SHARE * near[0] {
                        return None;
                    }
                    near[near.len() / 2]
                }
            };
            let (mut sum, mut weights) = (0.0, 0.0);
            for j in around() {
                if let Some(z) = valid(frame.image.depth_m[j]) {
                    let (du, dv) = ((j % width) as f64 - u as f64, (j / width) as f64 - v as f64);
                    let range = (z - middle) / (0.006 * middle);
                    let weight = (-(du * du + dv * dv) / 8.0 - range * range).exp();
                    sum += weight * z;
                    weights += weight;
                }
            }
            (weights > 0.0).then(|| sum / weights)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_planner::frame::{DepthImage, Intrinsics};

    #[test]
    fn a_flat_wall_has_normals_towards_the_camera() {
        let intrinsics =
            Intrinsics { fx_px: 200.0, fy_px: 200.0, cx_px: 10.0, cy_px: 8.0, distortion: [0.0; 8] };
        let mut depth_m = vec![0.8f32; 20 * 16];
        depth_m[8 * 20 + 10] = 0.0;
        let image = DepthImage { width: 20, height: 16, depth_m };
        let frame = Frame { image, intrinsics, world_from_camera: None, labels: None };
        let surface = Surface::new(&frame, &Isometry3::identity(), 1);
        assert!(surface.points[8 * 20 + 10].is_some(), "a pin hole is closed");
        assert!(surface.normals.iter().all(|n| (n + Vector3::z()).norm() < 1e-6));
        assert_eq!(surface.triangles(&Point3::origin()).len(), 2 * 19 * 15);
    }
}
