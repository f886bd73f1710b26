//! One exposure: a perfect view goes in, a depth image with a sensor's faults comes out.
//!
//! Each row has its own stream of random numbers, derived from the seed and the row: an image depends on nothing
//! but its view, its sensor and its seed.

use std::ops::Range;

use rand::{Rng, RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{DepthImage, Sensor};
use crate::render::{View, refill};

impl Sensor {
    /// One exposure. The seed decides the noise; the same seed gives the same image.
    ///
    /// The view decides the size of the image and the rays; it is normally rendered with this sensor's lens. A view
    /// whose lists do not have one value per pixel gives an image without returns.
    pub fn observe(&self, view: &View, seed: u64) -> DepthImage {
        let mut image = DepthImage { width: 0, height: 0, depth_m: Vec::new() };
        self.observe_into(view, seed, &mut Buffers::default(), &mut image);
        image
    }

    /// As [`Sensor::observe`], in the memory of an image that was taken before.
    pub(super) fn observe_into(&self, view: &View, seed: u64, buffers: &mut Buffers, image: &mut DepthImage) {
        let (width, height) = (view.lens.width, view.lens.height);
        let pixels = width.saturating_mul(height);
        let lengths = [view.depth_m.len(), view.cos_incidence.len(), view.albedo.len(), view.specular.len()];
        (image.width, image.height) = (width, height);
        if pixels == 0 || lengths != [pixels; 4] {
            refill(&mut image.depth_m, pixels.min(view.depth_m.len()), 0.0);
            return;
        }
        image.depth_m.resize(pixels, 0.0);
        let Buffers { inverse, edge, narrow, known } = buffers;
        let exposure = Exposure::new(self, view, inverse, edge, narrow);
        known.resize(width);
        for (row, out) in image.depth_m.chunks_exact_mut(width).enumerate() {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(mix(mix(seed) ^ row as u64));
            out.fill(0.0);
            let (first, last) = lit(&self.illumination, &view.lens, row);
            known.prepare(&exposure, row, first..last.max(first));
            exposure.row(row, first..last, known, out, &mut rng);
        }
    }
}

/// Memory that an exposure needs besides its image.
#[derive(Debug, Clone, Default)]
pub(super) struct Buffers {
    inverse: Vec<f32>,
    edge: Vec<bool>,
    narrow: Vec<bool>,
    known: Known,
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
    inverse: &'a [f32],
    /// Where depth jumps.
    edge: &'a [bool],
    systematic: Systematic,
    blur: f32,
    jitter: f32,
}

impl<'a> Exposure<'a> {
    fn new(
        sensor: &'a Sensor,
        view: &'a View,
        inverse: &'a mut Vec<f32>,
        edge: &'a mut Vec<bool>,
        narrow: &mut Vec<bool>,
    ) -> Self {
        inverse.clear();
        inverse.extend(view.depth_m.iter().map(|&z| if z > 0.0 && z < f32::MAX { 1.0 / z } else { 0.0 }));
        edges(inverse, &view.lens, sensor.edges.step_m as f32, sensor.edges.reach_px, edge, narrow);
        // The standard deviation of a uniform number is its range over the square root of 12.
        let jitter = (sensor.lateral.jitter_px * 12f64.sqrt()) as f32;
        let systematic = Systematic::new(&sensor.systematic);
        Self { view, sensor, inverse, edge, systematic, blur: sensor.lateral.blur as f32, jitter }
    }

    /// One row of the image, its lit columns; `out` begins as zeros.
    fn row(
        &self,
        row: usize,
        columns: Range<usize>,
        known: &Known,
        out: &mut [f32],
        rng: &mut Xoshiro256PlusPlus,
    ) {
        let width = self.view.lens.width;
        let start = row * width;
        let depth = &self.view.depth_m[start..start + width];
        let edge = &self.edge[start..start + width];
        let inner = row > 0 && row + 1 < self.view.lens.height;
        for (column, out) in out.iter_mut().enumerate().take(columns.end).skip(columns.start) {
            let returns = known.returns[column];
            // Also where the share is not a number.
            if !(returns >= 1.0 || (returns > 0.0 && unit(rng.next_u32()) < returns)) {
                continue;
            }
            let z = depth[column];
            let z = if edge[column] {
                let Some(z) = self.at_edge(row, column, z, rng) else { continue };
                z
            } else if inner && column > 0 && column + 1 < width {
                z / (1.0 + z * self.lateral(start + column, width, rng)).max(0.5)
            } else {
                z
            };
            *out = z + known.bias[column] + known.sigma[column] * rng.sample::<f32, _>(StandardNormal);
        }
        self.deliver(out);
    }

    /// How much the inverse depth changes by what a pixel sees of its neighbours.
    fn lateral(&self, i: usize, width: usize, rng: &mut Xoshiro256PlusPlus) -> f32 {
        let here = self.inverse[i];
        let [left, right] = [self.inverse[i - 1], self.inverse[i + 1]];
        let [upper, lower] = [self.inverse[i - width], self.inverse[i + width]];
        let bits = rng.next_u64();
        let (du, dv) = (unit(bits as u32) - 0.5, unit((bits >> 32) as u32) - 0.5);
        self.blur * (left + right + upper + lower - 4.0 * here)
            + self.jitter * 0.5 * (du * (right - left) + dv * (lower - upper))
    }

    /// Whole steps, within the range.
    fn deliver(&self, row: &mut [f32]) {
        /// Adding and subtracting it leaves a whole number, for numbers below half of its bits.
        const WHOLE: f32 = 12_582_912.0;
        let (near, far) = (self.sensor.range.nearest_m as f32, self.sensor.range.farthest_m as f32);
        let quantum = self.sensor.quantum_m as f32;
        let per_quantum = if quantum > 0.0 { 1.0 / quantum } else { 0.0 };
        for out in row {
            let steps = *out * per_quantum;
            let whole = (steps + WHOLE) - WHOLE;
            let z = if per_quantum > 0.0 && steps < 4_194_304.0 { whole * quantum } else { *out };
            *out = if z > 0.0 && z >= near && z <= far { z } else { 0.0 };
        }
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
/// jump. `narrow` is memory for the band as it was.
fn edges(
    inverse: &[f32],
    lens: &crate::camera::Pinhole,
    step_m: f32,
    reach: usize,
    edge: &mut Vec<bool>,
    narrow: &mut Vec<bool>,
) {
    let (width, height) = (lens.width, lens.height);
    refill(edge, inverse.len(), false);
    if width < 3 || height < 3 {
        return;
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
        narrow.clone_from(edge);
        for i in (0..edge.len()).filter(|i| narrow[*i]) {
            let (row, column) = (i / width, i % width);
            edge[row * width + column.saturating_sub(1)] = true;
            edge[row * width + (column + 1).min(width - 1)] = true;
            edge[row.saturating_sub(1) * width + column] = true;
            edge[(row + 1).min(height - 1) * width + column] = true;
        }
    }
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

/// What is known of each pixel of a row before any chance comes in.
#[derive(Debug, Clone, Default)]
struct Known {
    /// Probability of a return.
    returns: Vec<f32>,
    /// Standard deviation along the axis, metres.
    sigma: Vec<f32>,
    /// Error that the device repeats, metres.
    bias: Vec<f32>,
}

impl Known {
    fn resize(&mut self, width: usize) {
        for list in [&mut self.returns, &mut self.sigma, &mut self.bias] {
            list.resize(width, 0.0);
        }
    }

    /// What is known of some columns of a row; what is left of another row stays elsewhere.
    fn prepare(&mut self, exposure: &Exposure<'_>, row: usize, columns: Range<usize>) {
        let (sensor, view, start) = (exposure.sensor, exposure.view, row * self.returns.len());
        let row = start + columns.start..start + columns.end;
        let (depth, inverse) = (&view.depth_m[row.clone()], &exposure.inverse[row.clone()]);
        let (cos, albedo) = (&view.cos_incidence[row.clone()], &view.albedo[row.clone()]);
        let specular = &view.specular[row];
        let floor = &sensor.amplitude;
        let by_amplitude = Ramp::new(floor.floor * (1.0 - floor.fade), floor.floor * (1.0 + floor.fade));
        let cosine = |degrees: f64| if degrees < 90.0 { degrees.to_radians().cos() } else { 0.0 };
        let by_angle = Ramp::new(cosine(sensor.grazing.end_deg), cosine(sensor.grazing.start_deg));
        let ceiling = if floor.ceiling > 0.0 { floor.ceiling as f32 } else { f32::INFINITY };
        let (anywhere, facing) = (sensor.shiny.anywhere as f32, sensor.shiny.facing as f32);
        let square = |x: f64| (x * x) as f32;
        let axial = &sensor.axial;
        let (constant, linear, quadratic) =
            (square(axial.floor_m), square(axial.linear), square(axial.quadratic));
        let cap = axial.cap_m as f32;
        let (returns, sigma) = (&mut self.returns[columns.clone()], &mut self.sigma[columns.clone()]);
        for i in 0..depth.len() {
            let (z, inverse, cos, specular) = (depth[i], inverse[i], cos[i], specular[i]);
            let light = albedo[i] * (1.0 - specular) * cos;
            let amplitude = light * inverse * inverse;
            let fourth = (cos * cos) * (cos * cos);
            let shiny = (specular * (anywhere + facing * fourth * fourth)).clamp(0.0, 1.0);
            let share = by_amplitude.at(amplitude) * by_angle.at(cos) * (1.0 - shiny);
            returns[i] = if inverse > 0.0 && amplitude <= ceiling { share } else { 0.0 };
            let squared = z * z;
            let noise = (linear + quadratic * squared) * squared / light.max(1e-6);
            sigma[i] = (constant + noise).sqrt().min(cap);
        }
        exposure.systematic.fill(depth, &mut self.bias[columns]);
    }
}

/// From 0 to 1 between two values; 1 everywhere from 0 on when both are 0 or less.
struct Ramp {
    from: f32,
    per: f32,
}

impl Ramp {
    fn new(from: f64, to: f64) -> Self {
        let from = if to > 0.0 { from } else { -1.0 };
        Self { from: from as f32, per: (1.0 / (to - from).max(1e-9)) as f32 }
    }

    fn at(&self, x: f32) -> f32 {
        ((x - self.from) * self.per).clamp(0.0, 1.0)
    }
}

/// The repeated error of one device.
struct Systematic {
    offset: f32,
    scale: f32,
    wiggle: f32,
    per_metre: f32,
    phase: f32,
}

impl Systematic {
    fn new(config: &super::Systematic) -> Self {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(mix(config.device ^ 0x6465_7669_6365));
        let [offset, scale, phase] = [(); 3].map(|()| rng.random::<f64>() * 2.0 - 1.0);
        // A period of nothing is no wiggle.
        let per_metre = if config.wiggle_period_m > 0.0 { 1.0 / config.wiggle_period_m } else { 0.0 };
        Self {
            offset: (config.offset_m * offset) as f32,
            scale: (config.scale * scale) as f32,
            wiggle: config.wiggle_m as f32,
            per_metre: per_metre as f32,
            phase: (0.5 * phase) as f32,
        }
    }

    fn fill(&self, depth: &[f32], bias: &mut [f32]) {
        for (bias, &z) in bias.iter_mut().zip(depth) {
            // Turns around the nearest whole one, and the sine of them within a thousandth.
            let turns = z * self.per_metre + self.phase;
            let turns = turns - ((turns + 12_582_912.0) - 12_582_912.0);
            let arc = turns * (8.0 - 16.0 * turns.abs());
            *bias = self.offset + self.scale * z + self.wiggle * arc * (0.775 + 0.225 * arc.abs());
        }
    }
}
