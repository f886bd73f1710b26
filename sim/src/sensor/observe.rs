//! One exposure: a perfect view goes in, a depth image with a sensor's faults comes out.
//!
//! Each row has its own stream of random numbers, derived from the seed and the row: an image depends on nothing
//! but its view, its sensor and its seed.

use rand::{Rng, RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{DepthImage, Sensor};
use crate::render::View;

impl Sensor {
    /// One exposure. The seed decides the noise; the same seed gives the same image.
    ///
    /// The view decides the size of the image and the rays; it is normally rendered with this sensor's lens. A view
    /// whose lists do not have one value per pixel gives an image without returns.
    pub fn observe(&self, view: &View, seed: u64) -> DepthImage {
        let (width, height) = (view.lens.width, view.lens.height);
        let pixels = width.saturating_mul(height);
        let lengths = [view.depth_m.len(), view.cos_incidence.len(), view.albedo.len(), view.specular.len()];
        if pixels == 0 || lengths != [pixels; 4] {
            return DepthImage { width, height, depth_m: vec![0.0; pixels.min(view.depth_m.len())] };
        }
        let exposure = Exposure::new(self, view);
        let mut depth_m = vec![0.0; pixels];
        for (row, out) in depth_m.chunks_exact_mut(width).enumerate() {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(mix(mix(seed) ^ row as u64));
            exposure.row(row, out, &mut rng);
        }
        DepthImage { width, height, depth_m }
    }
}

/// The widest band of flying pixels on one side of an edge; also the limit of [`Sensor::check`].
pub(super) const MAX_REACH_PX: usize = 8;

/// Spreads the bits of a number: neighbouring seeds and rows must have nothing in common.
fn mix(x: u64) -> u64 {
    let x = (x ^ (x >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    let x = (x ^ (x >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    x ^ (x >> 32)
}

/// A number in 0..1 from 32 random bits.
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / 16_777_216.0
}

/// What is prepared once for all rows of an image.
struct Exposure<'a> {
    view: &'a View,
    sensor: &'a Sensor,
    /// Inverse depth, 0 where there is nothing: linear along planes.
    inverse: Vec<f32>,
    /// Where depth jumps.
    edge: Vec<bool>,
    systematic: Systematic,
    axial: [f32; 4],
    amplitude: [f32; 3],
    range: [f32; 2],
    grazing_cos: [f32; 2],
    shiny: [f32; 2],
    blur: f32,
    jitter: f32,
    quantum: Option<[f32; 2]>,
}

impl<'a> Exposure<'a> {
    fn new(sensor: &'a Sensor, view: &'a View) -> Self {
        let inverse: Vec<f32> =
            view.depth_m.iter().map(|&z| if z > 0.0 && z < f32::MAX { 1.0 / z } else { 0.0 }).collect();
        let edge = edges(&inverse, &view.lens, sensor.edges.step_m as f32, sensor.edges.reach_px);
        let cos = |degrees: f64| degrees.to_radians().cos() as f32;
        let amplitude = &sensor.amplitude;
        let quantum = sensor.quantum_m;
        Self {
            view,
            sensor,
            inverse,
            edge,
            systematic: Systematic::new(sensor),
            axial: [
                sensor.axial.floor_m.powi(2) as f32,
                sensor.axial.linear.powi(2) as f32,
                sensor.axial.quadratic.powi(2) as f32,
                sensor.axial.cap_m as f32,
            ],
            amplitude: [
                (amplitude.floor * (1.0 - amplitude.fade)) as f32,
                (amplitude.floor * (1.0 + amplitude.fade)) as f32,
                if amplitude.ceiling > 0.0 { amplitude.ceiling as f32 } else { f32::INFINITY },
            ],
            range: [sensor.range.nearest_m as f32, sensor.range.farthest_m as f32],
            grazing_cos: [cos(sensor.grazing.end_deg), cos(sensor.grazing.start_deg)],
            shiny: [sensor.shiny.anywhere as f32, sensor.shiny.facing as f32],
            blur: sensor.lateral.blur as f32,
            // The standard deviation of a uniform number is its range over the square root of 12.
            jitter: (sensor.lateral.jitter_px * 12f64.sqrt()) as f32,
            quantum: (quantum > 0.0).then(|| [(1.0 / quantum) as f32, quantum as f32]),
        }
    }

    /// One row of the image; `out` begins as zeros.
    fn row(&self, row: usize, out: &mut [f32], rng: &mut Xoshiro256PlusPlus) {
        let view = self.view;
        let width = view.lens.width;
        let (first, last) = lit(&self.sensor.illumination, &view.lens, row);
        let last_row = view.lens.height - 1;
        for column in first..last {
            let i = row * width + column;
            let inverse = self.inverse[i];
            if inverse == 0.0 {
                continue;
            }
            let z = view.depth_m[i];
            let light = view.albedo[i] * (1.0 - view.specular[i]) * view.cos_incidence[i];
            let missing = self.missing(light * inverse * inverse, view.cos_incidence[i], view.specular[i]);
            if missing > 0.0 && unit(rng.next_u32()) < missing {
                continue;
            }
            let mut z = if self.edge[i] {
                let Some(z) = self.at_edge(row, column, z, rng) else { continue };
                z
            } else if column > 0 && column + 1 < width && row > 0 && row < last_row {
                let [left, right] = [self.inverse[i - 1], self.inverse[i + 1]];
                let [upper, lower] = [self.inverse[i - width], self.inverse[i + width]];
                let bits = rng.next_u64();
                let (du, dv) = (unit(bits as u32) - 0.5, unit((bits >> 32) as u32) - 0.5);
                let shift = self.blur * (left + right + upper + lower - 4.0 * inverse)
                    + self.jitter * 0.5 * (du * (right - left) + dv * (lower - upper));
                z / (1.0 + z * shift).max(0.5)
            } else {
                z
            };
            let [floor, linear, quadratic, cap] = self.axial;
            let squared = z * z;
            let sigma = (floor + (linear + quadratic * squared) * squared / light.max(1e-6)).sqrt().min(cap);
            z += self.systematic.at(z) + sigma * rng.sample::<f32, _>(StandardNormal);
            if let Some([per_quantum, quantum]) = self.quantum {
                // Rounding by adding and cutting off: depths are positive, and far below two to the 31.
                z = (z * per_quantum + 0.5) as i32 as f32 * quantum;
            }
            if z > 0.0 && z >= self.range[0] && z <= self.range[1] {
                out[column] = z;
            }
        }
    }

    /// Probability that a surface does not return.
    fn missing(&self, amplitude: f32, cos: f32, specular: f32) -> f32 {
        let [none, all, ceiling] = self.amplitude;
        let [end, start] = self.grazing_cos;
        if amplitude >= all && amplitude <= ceiling && cos >= start && specular == 0.0 {
            return 0.0;
        }
        let ramp = |x: f32, none: f32, all: f32| {
            if x >= all {
                1.0
            } else if x <= none {
                0.0
            } else {
                (x - none) / (all - none)
            }
        };
        if amplitude > ceiling {
            return 1.0;
        }
        let shiny = specular * (self.shiny[0] + self.shiny[1] * cos.powi(8));
        1.0 - ramp(amplitude, none, all) * ramp(cos, end, start) * (1.0 - shiny.clamp(0.0, 1.0))
    }

    /// What a pixel at an edge returns: a depth between fore- and background, or nothing.
    fn at_edge(&self, row: usize, column: usize, own: f32, rng: &mut Xoshiro256PlusPlus) -> Option<f32> {
        let reach = self.sensor.edges.reach_px.min(MAX_REACH_PX);
        if reach == 0 {
            return Some(own);
        }
        let bits = rng.next_u64();
        if f64::from(unit(bits as u32)) < self.sensor.edges.drop {
            return None;
        }
        let (width, height) = (self.view.lens.width, self.view.lens.height);
        let (mut fore, mut back) = (own, own);
        for v in row.saturating_sub(reach)..=(row + reach).min(height - 1) {
            let from = v * width + column.saturating_sub(reach);
            let to = v * width + (column + reach).min(width - 1);
            for (&inverse, &z) in self.inverse[from..=to].iter().zip(&self.view.depth_m[from..=to]) {
                if inverse > 0.0 {
                    (fore, back) = (fore.min(z), back.max(z));
                }
            }
        }
        Some(fore + unit((bits >> 32) as u32) * (back - fore))
    }
}

/// Pixels within `reach` of a jump in depth of more than `step_m`.
///
/// The second difference of the inverse depth is zero along planes, however slanted, and large on both sides of a
/// jump.
fn edges(inverse: &[f32], lens: &crate::camera::Pinhole, step_m: f32, reach: usize) -> Vec<bool> {
    let (width, height) = (lens.width, lens.height);
    let mut edge = vec![false; inverse.len()];
    if width < 3 || height < 3 {
        return edge;
    }
    // A jump of s at depth z changes the inverse depth by s / (z (z + s)), seen from either side.
    let jumps = |change: f32, here: f32| change > step_m * here * here / (1.0 + step_m * here);
    for row in 0..height {
        let above = row.max(1) - 1;
        let below = (row + 1).min(height - 1);
        // The first and the last row have no neighbours to differ from twice.
        let slice = |row: usize| &inverse[row * width..(row + 1) * width];
        let (upper, here, lower) = (slice(above), slice(row), slice(below));
        let out = &mut edge[row * width..(row + 1) * width];
        for ((out, here), (upper, lower)) in
            out[1..].iter_mut().zip(here.windows(3)).zip(upper[1..].iter().zip(&lower[1..]))
        {
            let [left, here, right] = *here else { continue };
            let across = (left + right - 2.0 * here).abs();
            let along = if above == row || below == row { 0.0 } else { (upper + lower - 2.0 * here).abs() };
            *out = here > 0.0 && jumps(across.max(along), here);
        }
    }
    for _ in 1..reach.min(MAX_REACH_PX) {
        let narrow = edge.clone();
        for i in (0..edge.len()).filter(|i| narrow[*i]) {
            let (row, column) = (i / width, i % width);
            edge[row * width + column.saturating_sub(1)] = true;
            edge[row * width + (column + 1).min(width - 1)] = true;
            edge[row.saturating_sub(1) * width + column] = true;
            edge[(row + 1).min(height - 1) * width + column] = true;
        }
    }
    edge
}

/// First and one past the last lit column of a row.
fn lit(polygon: &[[f64; 2]], lens: &crate::camera::Pinhole, row: usize) -> (usize, usize) {
    if polygon.is_empty() {
        return (0, lens.width);
    }
    let y = (row as f64 - lens.cy_px) / lens.fy_px;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        if (a[1] <= y) != (b[1] <= y) {
            let x = a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]);
            (low, high) = (low.min(x), high.max(x));
        }
    }
    let column = |x: f64| ((x * lens.fx_px + lens.cx_px).ceil().max(0.0) as usize).min(lens.width);
    if low <= high { (column(low), column(high)) } else { (0, 0) }
}

/// The repeated error of one device, tabulated over depth.
struct Systematic {
    per_metre: f32,
    table: Vec<f32>,
}

impl Systematic {
    const STEPS: usize = 1024;

    fn new(sensor: &Sensor) -> Self {
        let config = &sensor.systematic;
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(mix(config.device ^ 0x6465_7669_6365));
        let [offset, scale, phase] = [(); 3].map(|()| rng.random::<f64>() * 2.0 - 1.0);
        // A period of nothing is no wiggle.
        let turns = if config.wiggle_period_m > 0.0 { 1.0 / config.wiggle_period_m } else { 0.0 };
        let span = sensor.range.farthest_m.clamp(0.1, 100.0);
        let table = (0..=Self::STEPS + 1)
            .map(|i| {
                let z = span * i as f64 / Self::STEPS as f64;
                let angle = std::f64::consts::TAU * (z * turns + 0.5 * phase);
                (config.offset_m * offset + config.scale * scale * z + config.wiggle_m * angle.sin()) as f32
            })
            .collect();
        Self { per_metre: (Self::STEPS as f64 / span) as f32, table }
    }

    fn at(&self, z: f32) -> f32 {
        let x = (z * self.per_metre).clamp(0.0, Self::STEPS as f32);
        let i = x as usize;
        match self.table.get(i..i + 2) {
            Some(&[a, b]) => a + (b - a) * (x - i as f32),
            _ => 0.0,
        }
    }
}
