//! A small software renderer: a pinhole camera, a geometry buffer filled through a depth test, one light with
//! shadows, and ambient occlusion.

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use rayon::prelude::*;

/// Nearer than this is not drawn, metres.
const NEAR_M: f64 = 0.03;

/// Where a picture is taken from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pinhole {
    /// Focal length, pixels.
    pub(crate) focal_px: f64,
    /// Principal point, pixels.
    pub(crate) center_px: [f64; 2],
    /// Takes world coordinates to optical ones (x right, y down, z forward).
    pub(crate) camera_from_world: Isometry3<f64>,
}

impl Pinhole {
    /// Pixel and depth of a point of the world; `None` behind the camera.
    pub(crate) fn project(&self, p: &Point3<f64>) -> Option<[f64; 3]> {
        let c = self.camera_from_world * p;
        (c.z > NEAR_M).then(|| {
            [
                self.focal_px * c.x / c.z + self.center_px[0],
                self.focal_px * c.y / c.z + self.center_px[1],
                c.z,
            ]
        })
    }

    fn unproject(&self, u: f64, v: f64, z: f64) -> Point3<f64> {
        let x = (u - self.center_px[0]) / self.focal_px * z;
        let y = (v - self.center_px[1]) / self.focal_px * z;
        self.camera_from_world.inverse_transform_point(&Point3::new(x, y, z))
    }
}

/// What is seen at each pixel, before light.
#[derive(Debug, Clone)]
pub(crate) struct Buffer {
    /// Width, pixels.
    pub(crate) width: usize,
    /// Height, pixels.
    pub(crate) height: usize,
    depth: Vec<f32>,
    normal: Vec<[f32; 3]>,
    albedo: Vec<[f32; 3]>,
}

/// A triangle's corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Corner {
    /// World frame.
    pub(crate) point: Point3<f64>,
    /// World frame, unit length.
    pub(crate) normal: Vector3<f64>,
    /// Linear red, green, blue.
    pub(crate) color: [f32; 3],
}

impl Buffer {
    /// Nothing seen anywhere.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let n = width * height;
        Self {
            width,
            height,
            depth: vec![f32::INFINITY; n],
            normal: vec![[0.0; 3]; n],
            albedo: vec![[0.0; 3]; n],
        }
    }

    /// Draws a triangle, whichever way it faces.
    pub(crate) fn triangle(&mut self, camera: &Pinhole, corners: &[Corner; 3]) {
        let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|i| camera.project(&corners[i].point)) else {
            return;
        };
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-12 {
            return;
        }
        let range = |axis: usize, size: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).ceil().max(0.0);
            let high = a[axis].max(b[axis]).max(c[axis]).floor().min(size as f64 - 1.0);
            (low as usize, high)
        };
        let ((u0, u1), (v0, v1)) = (range(0, self.width), range(1, self.height));
        if u1 < u0 as f64 || v1 < v0 as f64 {
            return;
        }
        for v in v0..=v1 as usize {
            for u in u0..=u1 as usize {
                let (x, y) = (u as f64, v as f64);
                let wa = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area;
                let wb = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area;
                let wc = 1.0 - wa - wb;
                if wa < 0.0 || wb < 0.0 || wc < 0.0 {
                    continue;
                }
                // Inverse depth is what is linear in the image.
                let inverse = wa / a[2] + wb / b[2] + wc / c[2];
                let z = (1.0 / inverse) as f32;
                let i = v * self.width + u;
                if z >= self.depth[i] {
                    continue;
                }
                let weights = [wa / a[2] / inverse, wb / b[2] / inverse, wc / c[2] / inverse];
                let mut normal = Vector3::zeros();
                let mut color = [0f32; 3];
                for (corner, w) in corners.iter().zip(weights) {
                    normal += corner.normal * w;
                    for (sum, part) in color.iter_mut().zip(corner.color) {
                        *sum += part * w as f32;
                    }
                }
                self.depth[i] = z;
                self.normal[i] = [normal.x as f32, normal.y as f32, normal.z as f32];
                self.albedo[i] = color;
            }
        }
    }

    /// True when nothing nearer than `z` (with a small allowance) is at this pixel.
    pub(crate) fn shows(&self, u: f64, v: f64, z: f64) -> bool {
        let (u, v) = (u.round(), v.round());
        if u < 0.0 || v < 0.0 || u >= self.width as f64 || v >= self.height as f64 {
            return false;
        }
        z < f64::from(self.depth[v as usize * self.width + u as usize]) + 0.006
    }

    /// Lights the buffer: linear red, green, blue per pixel.
    pub(crate) fn shade(&self, camera: &Pinhole, shadows: &ShadowMap, background: [f32; 3]) -> Vec<[f32; 3]> {
        let to_light = shadows.to_light.into_inner();
        let up = shadows.up.into_inner();
        let eye = camera.camera_from_world.inverse_transform_point(&Point3::origin());
        let spiral = spiral();
        (0..self.width * self.height)
            .into_par_iter()
            .map(|i| {
                let z = self.depth[i];
                if !z.is_finite() {
                    return background;
                }
                let (u, v) = (i % self.width, i / self.width);
                let p = camera.unproject(u as f64, v as f64, f64::from(z));
                let view = (eye - p).normalize();
                let n = self.normal[i].map(f64::from);
                let mut n = Vector3::new(n[0], n[1], n[2]).try_normalize(1e-9).unwrap_or(view);
                if n.dot(&view) < 0.0 {
                    n = -n;
                }
                let lit = shadows.lit(&(p + n * 0.002));
                let diffuse = n.dot(&to_light).max(0.0) * lit;
                let half = (to_light + view).normalize();
                let gloss = n.dot(&half).max(0.0).powi(40) * 0.22 * lit;
                let sky = 0.5 + 0.5 * n.dot(&up);
                let ambient = (0.20 + 0.28 * sky) * self.openness(&spiral, u, v, z);
                let rim = (1.0 - n.dot(&view)).powi(3) * 0.10;
                let light = (0.72 * diffuse + ambient + rim) as f32;
                self.albedo[i].map(|c| c * light + gloss as f32)
            })
            .collect()
    }

    /// Share of the surroundings that is not in front of a pixel: ambient occlusion in image space.
    fn openness(&self, spiral: &Spiral, u: usize, v: usize, z: f32) -> f64 {
        let mut hidden = 0.0;
        for (x, y) in spiral[(u * 7 + v * 13) % TURNS] {
            let (a, b) = (u as f64 + x, v as f64 + y);
            if a < 0.0 || b < 0.0 || a >= self.width as f64 || b >= self.height as f64 {
                continue;
            }
            let ahead = z - self.depth[b as usize * self.width + a as usize];
            if ahead > 0.003 && ahead < 0.06 {
                hidden += 1.0 - f64::from(ahead) / 0.06;
            }
        }
        1.0 - 0.75 * hidden / 16.0
    }
}

/// Rotations of the pattern in which ambient occlusion looks around.
const TURNS: usize = 8;

/// Sixteen offsets of growing distance, pixels, for each rotation; neighbouring pixels use different ones.
type Spiral = [[(f64, f64); 16]; TURNS];

fn spiral() -> Spiral {
    std::array::from_fn(|turn| {
        std::array::from_fn(|k| {
            // The golden angle spreads directions evenly.
            let (sin, cos) = (k as f64 * 2.399_963 + turn as f64 * 0.0982).sin_cos();
            let radius = (k as f64 + 1.0) * 1.6;
            (cos * radius, sin * radius)
        })
    })
}

/// Depth as the light sees it, for one directional light.
#[derive(Debug, Clone)]
pub(crate) struct ShadowMap {
    /// Direction to the light, world frame.
    to_light: Unit<Vector3<f64>>,
    /// Up, world frame.
    up: Unit<Vector3<f64>>,
    center: Point3<f64>,
    axes: [Vector3<f64>; 2],
    half_m: f64,
    size: usize,
    height: Vec<f32>,
}

impl ShadowMap {
    /// A map of the surroundings of `center`.
    pub(crate) fn new(
        center: Point3<f64>,
        half_m: f64,
        size: usize,
        to_light: Unit<Vector3<f64>>,
        up: Unit<Vector3<f64>>,
    ) -> Self {
        let helper = if to_light.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let a = to_light.cross(&helper).normalize();
        let b = to_light.cross(&a);
        Self {
            to_light,
            up,
            center,
            axes: [a, b],
            half_m,
            size,
            height: vec![f32::NEG_INFINITY; size * size],
        }
    }

    fn place(&self, p: &Point3<f64>) -> (f64, f64, f64) {
        let d = p - self.center;
        let scale = self.size as f64 / (2.0 * self.half_m);
        let at = |axis: &Vector3<f64>| (d.dot(axis) + self.half_m) * scale;
        (at(&self.axes[0]), at(&self.axes[1]), d.dot(&self.to_light))
    }

    /// Lets a triangle cast a shadow.
    pub(crate) fn add(&mut self, corners: [Point3<f64>; 3]) {
        let [a, b, c] = corners.map(|p| self.place(&p));
        let area = (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        if area.abs() < 1e-12 {
            return;
        }
        let top = self.size as f64 - 1.0;
        let clamp = |x: f64| x.clamp(0.0, top) as usize;
        for v in clamp(a.1.min(b.1).min(c.1))..=clamp(a.1.max(b.1).max(c.1).ceil()) {
            for u in clamp(a.0.min(b.0).min(c.0))..=clamp(a.0.max(b.0).max(c.0).ceil()) {
                let (x, y) = (u as f64, v as f64);
                let wa = ((b.0 - x) * (c.1 - y) - (b.1 - y) * (c.0 - x)) / area;
                let wb = ((c.0 - x) * (a.1 - y) - (c.1 - y) * (a.0 - x)) / area;
                let wc = 1.0 - wa - wb;
                if wa >= -1e-9 && wb >= -1e-9 && wc >= -1e-9 {
                    let h = (wa * a.2 + wb * b.2 + wc * c.2) as f32;
                    let slot = &mut self.height[v * self.size + u];
                    *slot = slot.max(h);
                }
            }
        }
    }

    /// Share of the light that reaches a point, softened over 5×5 texels.
    fn lit(&self, p: &Point3<f64>) -> f64 {
        let (u, v, h) = self.place(p);
        let top = self.size as f64;
        let (mut lit, mut count) = (0.0, 0.0);
        for dv in -2..=2 {
            for du in -2..=2 {
                let (a, b) = (u + f64::from(du) * 1.5, v + f64::from(dv) * 1.5);
                if a < 0.0 || b < 0.0 || a >= top || b >= top {
                    continue;
                }
                count += 1.0;
                if f64::from(self.height[b as usize * self.size + a as usize]) < h + 0.007 {
                    lit += 1.0;
                }
            }
        }
        if count > 0.0 { lit / count } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(z: f64, half: f64, color: [f32; 3]) -> [[Corner; 3]; 2] {
        let corner = |x: f64, y: f64| Corner { point: Point3::new(x, y, z), normal: -Vector3::z(), color };
        let [a, b, c, d] =
            [corner(-half, -half), corner(half, -half), corner(half, half), corner(-half, half)];
        [[a, b, c], [a, c, d]]
    }

    #[test]
    fn the_nearer_triangle_hides_the_farther_one_in_any_order() {
        let camera =
            Pinhole { focal_px: 20.0, center_px: [10.0, 10.0], camera_from_world: Isometry3::identity() };
        let (near, far) = (quad(0.5, 0.1, [1.0, 0.0, 0.0]), quad(1.0, 0.5, [0.0, 1.0, 0.0]));
        for order in [[&near, &far], [&far, &near]] {
            let mut buffer = Buffer::new(21, 21);
            for triangle in order.into_iter().flatten() {
                buffer.triangle(&camera, triangle);
            }
            assert_eq!(buffer.albedo[10 * 21 + 10], [1.0, 0.0, 0.0]);
            assert_eq!(buffer.albedo[2 * 21 + 2], [0.0, 1.0, 0.0]);
            assert!(buffer.shows(10.0, 10.0, 0.5) && !buffer.shows(10.0, 10.0, 1.0));
        }
    }

    #[test]
    fn a_triangle_behind_the_camera_is_not_drawn() {
        let camera =
            Pinhole { focal_px: 20.0, center_px: [5.0, 5.0], camera_from_world: Isometry3::identity() };
        let mut buffer = Buffer::new(11, 11);
        for triangle in &quad(-0.5, 0.2, [1.0; 3]) {
            buffer.triangle(&camera, triangle);
        }
        assert!(buffer.depth.iter().all(|z| z.is_infinite()));
    }

    #[test]
    fn what_is_under_a_plate_is_in_its_shadow() {
        let up = Vector3::z_axis();
        let mut map = ShadowMap::new(Point3::origin(), 0.5, 64, up, up);
        for triangle in quad(0.2, 0.2, [0.0; 3]) {
            map.add(triangle.map(|c| c.point));
        }
        assert_eq!(map.lit(&Point3::origin()), 0.0);
        assert_eq!(map.lit(&Point3::new(0.4, 0.4, 0.0)), 1.0);
        assert_eq!(map.lit(&Point3::new(0.0, 0.0, 0.3)), 1.0);
    }
}
