//! The lens of a camera of the device: points to pixels and back.
//!
//! With x = X/Z, y = Y/Z about the centre of distortion and r² = x² + y²: `x' = x·(1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² +
//! k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2x²)` and y' likewise: OpenCV's rational model. Early devices have the older model,
//! in which the mixed term is not doubled. Nothing beyond the metric radius is seen.

use graspd_adapters_core::Lens;

/// Newton steps of the inversion.
const MAX_STEPS: usize = 30;
/// Accepted error of the inversion, pixels squared, as the SDK has it.
const TOLERANCE_PX2: f64 = 1e-6;

/// Which formula the coefficients belong to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensModel {
    /// OpenCV's rational model: all devices that were sold.
    BrownConrady,
    /// `Rational6KT` of early devices: the mixed tangential term is not doubled.
    Rational6Kt,
}

/// The lens of one camera in one mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KinectLens {
    /// Formula.
    pub model: LensModel,
    /// Width and height of the image, pixels.
    pub size: (usize, usize),
    /// Focal lengths, pixels.
    pub f: [f64; 2],
    /// Principal point, pixels; the centre of the first pixel is 0.
    pub c: [f64; 2],
    /// k1 to k6.
    pub k: [f64; 6],
    /// p1, p2.
    pub p: [f64; 2],
    /// Centre of distortion in the plane Z = 1: codx, cody. Zero in all devices that were sold.
    pub center: [f64; 2],
    /// Largest distance from the axis in the plane Z = 1.
    pub metric_radius: f64,
}

/// A lens that frames of a cell cannot carry.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "lens: found {model:?} with a centre of distortion at {center:?}, expected BrownConrady with 0, 0 (an early device?)"
)]
pub struct LensError {
    model: LensModel,
    center: [f64; 2],
}

impl KinectLens {
    /// The lens as frames carry it.
    ///
    /// # Errors
    /// [`LensError`]: only lenses of early devices, which need a formula that frames do not have.
    pub fn to_frame(&self) -> Result<Lens, LensError> {
        if self.model != LensModel::BrownConrady || self.center != [0.0; 2] {
            return Err(LensError { model: self.model, center: self.center });
        }
        let ([k1, k2, k3, k4, k5, k6], [p1, p2]) = (self.k, self.p);
        Ok(Lens {
            fx_px: self.f[0],
            fy_px: self.f[1],
            cx_px: self.c[0],
            cy_px: self.c[1],
            distortion: [k1, k2, p1, p2, k3, k4, k5, k6],
        })
    }

    /// Normalized coordinates as the lens bends them, with the derivatives `[dx'/dx, dx'/dy, dy'/dx, dy'/dy]`.
    fn distort(&self, [x, y]: [f64; 2]) -> ([f64; 2], [f64; 4]) {
        let ([k1, k2, k3, k4, k5, k6], [p1, p2]) = (self.k, self.p);
        let (x, y) = (x - self.center[0], y - self.center[1]);
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let inverse = if below == 0.0 { 1.0 } else { 1.0 / below };
        let d = above * inverse;
        let above_dr2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let below_dr2 = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let d_dr2 = (above_dr2 - d * below_dr2) * inverse;
        let mixed = match self.model {
            LensModel::BrownConrady => 2.0,
            LensModel::Rational6Kt => 1.0,
        };
        let bent = [
            x * d + mixed * p1 * x * y + p2 * (r2 + 2.0 * x * x) + self.center[0],
            y * d + mixed * p2 * x * y + p1 * (r2 + 2.0 * y * y) + self.center[1],
        ];
        let cross = 2.0 * x * y * d_dr2;
        let derivatives = [
            d + 2.0 * x * x * d_dr2 + mixed * p1 * y + 6.0 * p2 * x,
            cross + mixed * p1 * x + 2.0 * p2 * y,
            cross + mixed * p2 * y + 2.0 * p1 * x,
            d + 2.0 * y * y * d_dr2 + mixed * p2 * x + 6.0 * p1 * y,
        ];
        (bent, derivatives)
    }

    fn inside(&self, [x, y]: [f64; 2]) -> bool {
        let (x, y) = (x - self.center[0], y - self.center[1]);
        x * x + y * y <= self.metric_radius * self.metric_radius
    }

    /// Image coordinates of a point of the optical frame, pixels; `None` behind the camera or beyond the metric radius.
    pub fn project(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        let positive = z > 0.0;
        let ray = [x / z, y / z];
        if !positive || !self.inside(ray) {
            return None;
        }
        let ([x, y], _) = self.distort(ray);
        Some([self.f[0] * x + self.c[0], self.f[1] * y + self.c[1]])
    }

    /// The ray of image coordinates as `[x/z, y/z]`; `None` where nothing is seen.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let target = [(pixel[0] - self.c[0]) / self.f[0], (pixel[1] - self.c[1]) / self.f[1]];
        let mut ray = self.first_guess(target);
        for _ in 0..MAX_STEPS {
            let (bent, [a, b, c, d]) = self.distort(ray);
            let error = [bent[0] - target[0], bent[1] - target[1]];
            let (ex, ey) = (error[0] * self.f[0], error[1] * self.f[1]);
            let determinant = a * d - b * c;
            let error_px2 = ex * ex + ey * ey;
            // One step more than the tolerance asks: it costs nothing and leaves an error of rounding only.
            if error_px2 < TOLERANCE_PX2 * 1e-9 || determinant.abs() < 1e-12 || !error_px2.is_finite() {
                break;
            }
            ray = [
                ray[0] - (d * error[0] - b * error[1]) / determinant,
                ray[1] - (a * error[1] - c * error[0]) / determinant,
            ];
        }
        let ([x, y], _) = self.distort(ray);
        let (ex, ey) = ((x - target[0]) * self.f[0], (y - target[1]) * self.f[1]);
        let good = ex * ex + ey * ey <= TOLERANCE_PX2;
        (good && self.inside(ray)).then_some(ray)
    }

    /// The radial factor at the bent radius, inverted: near enough for Newton's steps.
    fn first_guess(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, k3, k4, k5, k6] = self.k;
        let (x, y) = (x - self.center[0], y - self.center[1]);
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let factor = if above == 0.0 { 1.0 } else { below / above };
        [x * factor + self.center[0], y * factor + self.center[1]]
    }

    /// The ray of every pixel, row major; NaN where nothing is seen.
    pub fn rays(&self) -> Vec<[f32; 2]> {
        let (width, height) = self.size;
        let mut rays = Vec::with_capacity(width * height);
        for row in 0..height {
            for column in 0..width {
                let ray = self.unproject([column as f64, row as f64]);
                rays.push(ray.map_or([f32::NAN; 2], |[x, y]| [x as f32, y as f32]));
            }
        }
        rays
    }
}

/// The point of every pixel, metres, optical frame; zeros where there is no depth or nothing is seen. `rays` are those of
/// [`KinectLens::rays`], `depth_mm` is row major.
pub fn points(rays: &[[f32; 2]], depth_mm: &[u16]) -> Vec<[f32; 3]> {
    let point = |([x, y], &mm): (&[f32; 2], &u16)| {
        let z = f32::from(mm) * 1e-3;
        if mm == 0 || x.is_nan() { [0.0; 3] } else { [x * z, y * z, z] }
    };
    rays.iter().zip(depth_mm).map(point).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Coefficients of a real device's depth camera, rounded.
    pub(crate) fn lens() -> KinectLens {
        KinectLens {
            model: LensModel::BrownConrady,
            size: (640, 576),
            f: [504.608, 504.733],
            c: [332.781, 348.830],
            k: [0.54794, -0.02097, -0.00265, 0.88968, 0.08613, -0.01391],
            p: [2.06e-5, -7.21e-5],
            center: [0.0; 2],
            metric_radius: 1.74,
        }
    }

    proptest! {
        #[test]
        fn every_pixel_has_a_ray_that_leads_back(u in -0.5f64..639.5, v in -0.5f64..575.5, z in 0.1f64..6.0) {
            let lens = lens();
            let [x, y] = lens.unproject([u, v]).unwrap();
            let back = lens.project([x * z, y * z, z]).unwrap();
            prop_assert!((back[0] - u).hypot(back[1] - v) < 1e-6);
        }

        #[test]
        fn derivatives_are_those_of_the_formula(
            x in -1.0f64..1.0, y in -1.0f64..1.0, early in any::<bool>(),
            center in proptest::array::uniform2(-0.01f64..0.01), p in proptest::array::uniform2(-0.01f64..0.01),
        ) {
            let model = if early { LensModel::Rational6Kt } else { LensModel::BrownConrady };
            let lens = KinectLens { model, center, p, ..lens() };
            let h = 1e-6;
            let at = |x: f64, y: f64| lens.distort([x, y]).0;
            let (_, found) = lens.distort([x, y]);
            for i in 0..2 {
                let dx = (at(x + h, y)[i] - at(x - h, y)[i]) / (2.0 * h);
                let dy = (at(x, y + h)[i] - at(x, y - h)[i]) / (2.0 * h);
                prop_assert!((found[2 * i] - dx).abs() < 1e-7 && (found[2 * i + 1] - dy).abs() < 1e-7);
            }
        }

        #[test]
        fn what_a_frame_carries_is_the_same_lens(u in 0f64..639.0, v in 0f64..575.0) {
            let frame = lens().to_frame().unwrap();
            let other = graspd_planner::frame::Intrinsics {
                fx_px: frame.fx_px, fy_px: frame.fy_px, cx_px: frame.cx_px, cy_px: frame.cy_px,
                distortion: frame.distortion,
            };
            let (ours, theirs) = (lens().unproject([u, v]).unwrap(), other.ray([u, v]).unwrap());
            prop_assert!((ours[0] - theirs[0]).hypot(ours[1] - theirs[1]) < 1e-5, "{ours:?} {theirs:?}");
        }

        #[test]
        fn hostile_coefficients_end_without_panic(
            k in proptest::array::uniform6(-1e6f64..1e6), f in proptest::array::uniform2(-1e3f64..1e3),
            pixel in proptest::array::uniform2(-1e6f64..1e6),
        ) {
            let lens = KinectLens { k, f, ..lens() };
            if let Some([x, y]) = lens.unproject(pixel) {
                prop_assert!(x.is_finite() && y.is_finite());
            }
        }
    }

    #[test]
    fn early_lenses_invert_too_but_no_frame_carries_them() {
        let early = KinectLens { model: LensModel::Rational6Kt, center: [0.004, -0.003], ..lens() };
        let [x, y] = early.unproject([40.0, 500.0]).unwrap();
        let back = early.project([x, y, 1.0]).unwrap();
        assert!((back[0] - 40.0).hypot(back[1] - 500.0) < 1e-6);
        let refused = early.to_frame().unwrap_err().to_string();
        assert!(refused.contains("Rational6Kt"), "{refused}");
    }

    #[test]
    fn nothing_is_seen_beyond_the_metric_radius_or_behind() {
        let lens = lens();
        assert!(lens.project([1.7, 0.0, 1.0]).is_some());
        assert!(lens.project([1.8, 0.0, 1.0]).is_none());
        assert!(lens.project([0.0, 0.0, -1.0]).is_none() && lens.project([0.0, 0.0, f64::NAN]).is_none());
        let narrow = KinectLens { metric_radius: 0.3, ..lens };
        assert!(narrow.unproject([5.0, 5.0]).is_none() && narrow.unproject([330.0, 340.0]).is_some());
    }

    #[test]
    fn points_scale_with_depth_and_holes_stay_holes() {
        let lens = KinectLens { size: (2, 1), ..lens() };
        let rays = lens.rays();
        let cloud = points(&rays, &[1000, 0]);
        assert_eq!((cloud[0][2], cloud[1]), (1.0, [0.0; 3]));
        let [x, y] = lens.unproject([0.0, 0.0]).unwrap();
        assert!((f64::from(cloud[0][0]) - x).abs() < 1e-6 && (f64::from(cloud[0][1]) - y).abs() < 1e-6);
    }
}
