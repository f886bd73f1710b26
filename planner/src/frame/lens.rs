//! The lens: projection, its distortion model, and its inverse.
//!
//! Distortion is OpenCV's rational Brown-Conrady model: with normalized coordinates (x, y) and r² = x² + y²,
//! `x' = x·(1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2x²)`, and y' likewise.
//! Pixel (0, 0) has its centre at image coordinates (0, 0).

use super::Intrinsics;

/// Newton steps of the inversion; a lens that can be inverted at a pixel needs fewer than ten.
const MAX_STEPS: usize = 30;
/// Accepted error of the inversion in normalized coordinates: a thousandth of a pixel at f = 1000 px.
const TOLERANCE: f64 = 1e-6;

impl Intrinsics {
    /// True when some distortion coefficient is not zero.
    pub fn is_distorted(&self) -> bool {
        self.distortion.iter().any(|&k| k != 0.0)
    }

    /// Normalized coordinates as the lens bends them.
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion;
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// Inverts [`Self::distort`] by Newton's method with halved steps. `None` where the lens model folds over
    /// (no point of the scene lands there) or the iteration does not converge.
    pub fn undistort(&self, target: [f64; 2]) -> Option<[f64; 2]> {
        if !self.is_distorted() {
            return Some(target);
        }
        let error = |p: [f64; 2]| {
            let d = self.distort(p);
            [d[0] - target[0], d[1] - target[1]]
        };
        let norm = |e: [f64; 2]| (e[0] * e[0] + e[1] * e[1]).sqrt();
        let mut p = target;
        let mut e = error(p);
        for _ in 0..MAX_STEPS {
            if norm(e) < TOLERANCE * 1e-3 {
                break;
            }
            let h = 1e-6;
            let ex = error([p[0] + h, p[1]]);
            let ey = error([p[0], p[1] + h]);
            let (a, b) = ((ex[0] - e[0]) / h, (ey[0] - e[0]) / h);
            let (c, d) = ((ex[1] - e[1]) / h, (ey[1] - e[1]) / h);
            let det = a * d - b * c;
            if !det.is_finite() || det <= 1e-9 {
                // The map turns inside out here: beyond the model's range.
                return None;
            }
            let step = [(d * e[0] - b * e[1]) / det, (a * e[1] - c * e[0]) / det];
            let mut share = 1.0;
            loop {
                let candidate = [p[0] - share * step[0], p[1] - share * step[1]];
                let new = error(candidate);
                if norm(new) < norm(e) {
                    p = candidate;
                    e = new;
                    break;
                }
                share *= 0.5;
                if share < 1e-3 {
                    return (norm(e) < TOLERANCE).then_some(p);
                }
            }
        }
        (norm(e) < TOLERANCE && p[0].is_finite() && p[1].is_finite()).then_some(p)
    }

    /// Image coordinates (pixels) of a point in the optical frame; `None` behind the camera.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        if point[2].is_nan() || point[2] <= 0.0 {
            return None;
        }
        let [x, y] = self.distort([point[0] / point[2], point[1] / point[2]]);
        Some([self.fx_px * x + self.cx_px, self.fy_px * y + self.cy_px])
    }

    /// The ray of image coordinates (pixels) as `[x/z, y/z]`; `None` where the lens model has none.
    pub fn ray(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        self.undistort([(pixel[0] - self.cx_px) / self.fx_px, (pixel[1] - self.cy_px) / self.fy_px])
    }

    /// Largest `(x/z)² + (y/z)²` that the border of an image of this size sees; infinite without distortion.
    /// Points further out may be folded back into the image by the polynomial and must not be looked up.
    pub(crate) fn largest_radius_squared(&self, width: usize, height: usize) -> f64 {
        if !self.is_distorted() {
            return f64::INFINITY;
        }
        let mut largest = 0.0f64;
        let (w, h) = ((width - 1) as f64, (height - 1) as f64);
        for step in 0..=32 {
            let t = f64::from(step) / 32.0;
            for pixel in [[t * w, 0.0], [t * w, h], [0.0, t * h], [w, t * h]] {
                if let Some([x, y]) = self.ray(pixel) {
                    largest = largest.max(x * x + y * y);
                }
            }
        }
        // One per cent beyond the border keeps the pixels at the very corner.
        if largest > 0.0 { largest * 1.01 } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(distortion: [f64; 8]) -> Intrinsics {
        Intrinsics { fx_px: 610.0, fy_px: 608.0, cx_px: 321.0, cy_px: 242.0, distortion }
    }

    proptest! {
        #[test]
        fn projection_and_ray_are_inverse(
            x in -0.5f64..0.5, y in -0.4f64..0.4, z in 0.2f64..3.0,
            k1 in -0.15f64..0.15, k2 in -0.05f64..0.05, p1 in -2e-3f64..2e-3, p2 in -2e-3f64..2e-3,
        ) {
            let lens = lens([k1, k2, p1, p2, 0.01, 0.0, 0.0, 0.0]);
            let pixel = lens.project([x * z, y * z, z]).unwrap();
            let ray = lens.ray(pixel).unwrap();
            prop_assert!((ray[0] - x).abs() < 1e-5 && (ray[1] - y).abs() < 1e-5);
        }

        #[test]
        fn hostile_coefficients_end_without_panic(
            k in proptest::array::uniform8(-1e3f64..1e3), u in -1e4f64..1e4, v in -1e4f64..1e4,
        ) {
            let lens = lens(k);
            if let Some(ray) = lens.ray([u, v]) {
                let back = lens.distort(ray);
                let x = (u - lens.cx_px) / lens.fx_px;
                let y = (v - lens.cy_px) / lens.fy_px;
                prop_assert!((back[0] - x).hypot(back[1] - y) < 1e-5);
            }
        }
    }

    #[test]
    fn published_rational_coefficients_are_inverted() {
        // The size of coefficients that a time-of-flight camera's factory calibration has.
        let lens = lens([0.72, -2.7, 7.7e-4, -4.4e-4, 1.56, 0.6, -2.53, 1.48]);
        for (u, v) in [(5.0, 7.0), (320.0, 240.0), (600.0, 30.0), (635.0, 470.0)] {
            let ray = lens.ray([u, v]).unwrap();
            let back = lens.project([ray[0], ray[1], 1.0]).unwrap();
            assert!((back[0] - u).hypot(back[1] - v) < 1e-3);
        }
    }
}
