//! What a structured-light or time-of-flight camera makes of exact depth: axial noise that grows with the
//! square of depth, no returns at grazing surfaces and depth edges, whole millimetres.
//!
//! Axial noise after Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise" (2012):
//! σ = 1.2 mm + 1.9 mm/m² · (z − 0.4 m)², taken at 60 % since later sensors are better.

use super::camera::{Camera, Hit};

/// Share of the 2012 model's noise.
const NOISE_SHARE: f64 = 0.6;
/// Surfaces seen flatter than this (cosine) return nothing.
const GRAZING: f64 = 0.12;
/// A step between neighbours larger than this is a depth edge, metres.
const EDGE_M: f64 = 0.015;
/// Share of pixels at a depth edge without a return.
const EDGE_LOSS: f64 = 0.6;
/// Share of all pixels without a return.
const SPECKLE: f64 = 0.0015;

/// A seeded stream of random numbers for one pixel (SplitMix64), so that the image does not depend on the
/// order in which pixels are made.
#[derive(Debug, Clone)]
pub(crate) struct Noise(u64);

impl Noise {
    /// The stream of one pixel.
    pub(crate) fn new(seed: u64, pixel: u64) -> Self {
        let mut own = Self(seed ^ pixel.wrapping_mul(0xd134_2543_de82_ef95));
        own.next();
        own
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in 0..1.
    pub(crate) fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal to within what matters here: the sum of twelve uniforms. Unlike Box-Muller it needs
    /// neither logarithm nor sine, which differ in the last bit between platforms.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Depth in millimetres as the sensor reports it, 0 where it sees nothing.
pub(crate) fn observe(camera: &Camera, exact: &[Hit], seed: u64) -> Vec<u16> {
    let (width, height) = (camera.width, camera.height);
    let at_edge = |u: usize, v: usize| {
        let z = exact[v * width + u].z_m;
        let step = |du: isize, dv: isize| {
            let (Some(a), Some(b)) = (u.checked_add_signed(du), v.checked_add_signed(dv)) else {
                return false;
            };
            a < width && b < height && (exact[b * width + a].z_m - z).abs() > EDGE_M
        };
        step(-1, 0) || step(1, 0) || step(0, -1) || step(0, 1)
    };
    (0..width * height)
        .map(|i| {
            let hit = exact[i];
            let mut noise = Noise::new(seed, i as u64);
            let (edge, speckle) = (noise.uniform(), noise.uniform());
            let lost = hit.z_m <= 0.0
                || hit.facing < GRAZING + 0.04 * noise.normal()
                || speckle < SPECKLE
                || (edge < EDGE_LOSS && at_edge(i % width, i / width));
            if lost {
                return 0;
            }
            let sigma = NOISE_SHARE * (0.0012 + 0.0019 * (hit.z_m - 0.4).powi(2));
            let z_mm = (hit.z_m + sigma * noise.normal()) * 1000.0;
            z_mm.round().clamp(0.0, f64::from(u16::MAX)) as u16
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_standard_normal() {
        let samples: Vec<f64> = (0..20_000).map(|i| Noise::new(7, i).normal()).collect();
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        let variance = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / samples.len() as f64;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    }

    #[test]
    fn grazing_surfaces_and_edges_lose_returns() {
        let camera = Camera { width: 40, height: 40, ..Camera::above_table() };
        let flat = vec![Hit { z_m: 0.7, facing: 0.9 }; 1600];
        let lost = |hits: &[Hit]| observe(&camera, hits, 1).iter().filter(|&&d| d == 0).count();
        assert!(lost(&flat) < 20);
        assert!(lost(&vec![Hit { z_m: 0.7, facing: 0.01 }; 1600]) > 1500);
        let mut step = flat.clone();
        for (i, hit) in step.iter_mut().enumerate() {
            hit.z_m += if i % 40 < 20 { 0.0 } else { 0.1 };
        }
        assert!(lost(&step) > lost(&flat) + 30);
    }
}
