//! The coefficients of a depth camera's faults.
//!
//! Sources of the presets' values are given field by field: *AK* is the Azure Kinect DK (NFOV unbinned), *PF* the
//! PMD CamBoard pico flexx. The datasheets bound the errors but publish no coefficients, so values marked
//! *engineering* are chosen to stay within those bounds.

use serde::{Deserialize, Serialize};

use super::observe::MAX_REACH_PX;
use crate::camera::Pinhole;

/// A depth camera: its lens, and its faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// The lens.
    ///
    /// AK: factory calibration of one device. PF: typical values that the device reports.
    pub lens: Pinhole,
    /// Measured depths outside are not returned.
    pub range: Range,
    /// How much light must come back.
    pub amplitude: Amplitude,
    /// Random error along the optical axis, new in each exposure.
    pub axial: Axial,
    /// Error that a device repeats in each exposure.
    pub systematic: Systematic,
    /// Spread across the image.
    pub lateral: Lateral,
    /// What happens where depth jumps.
    pub edges: Edges,
    /// Surfaces seen at a flat angle.
    pub grazing: Grazing,
    /// Surfaces that mirror.
    pub shiny: Shiny,
    /// Corners of the convex region that is lit, in order, as slopes `x / z`, `y / z` of the rays; nothing
    /// outside it is returned. Empty: everything is lit.
    ///
    /// AK: the hexagon outside of which a public NFOV recording (MIT-licensed test asset of `pyk4a`) has no
    /// return; the hardware specification states the hexagonal field. PF: none.
    pub illumination: Vec<[f64; 2]>,
    /// Step of the returned depths, metres; 0 for none.
    ///
    /// AK, PF: depth is delivered in whole millimetres (`DEPTH16` format; 13-bit depth in millimetres).
    pub quantum_m: f64,
}

/// Depths that are returned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Nearest, metres.
    ///
    /// AK: a public NFOV recording has returns from 0.165 m; the specification promises accuracy from 0.5 m.
    /// PF: datasheet.
    pub nearest_m: f64,
    /// Farthest, metres. AK, PF: hardware specification, datasheet.
    pub farthest_m: f64,
}

/// Limits of the amplitude, see the [module](crate::sensor).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Amplitude {
    /// Half of the pixels with this amplitude return.
    ///
    /// AK: the specification's range is stated for 15 % reflectivity: 0.15 / 3.86² = 0.010 must just be seen.
    /// PF: engineering, the same reasoning at 4 m.
    pub floor: f64,
    /// Share of the floor over which the returns fade, around it: from none at `floor * (1 - fade)` to all at
    /// `floor * (1 + fade)`. AK, PF: engineering.
    pub fade: f64,
    /// Above this, pixels saturate and do not return; 0 for never.
    ///
    /// AK: white at 0.17 m, where recordings begin. PF: white at 0.12 m with exposures of 2 ms. Engineering.
    pub ceiling: f64,
}

/// Standard deviation along the axis:
/// `min(cap, sqrt(floor² + ((linear d)² + (quadratic d²)²) / (albedo (1 - specular) cos)))`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axial {
    /// What remains with all light, metres.
    ///
    /// AK: 1.5 times the residual of bright patches in a public NFOV recording, 0.30 mm; 1.5 because the device's
    /// filters hide part of the noise between neighbouring pixels. PF: engineering.
    pub floor_m: f64,
    /// Photon noise, metres per metre.
    ///
    /// AK: 1.5 times the fit to the same recording, 13.5 mm / sqrt(IR) with IR = 1000 times the amplitude. PF: none.
    pub linear: f64,
    /// Noise of the read-out, metres per square metre.
    ///
    /// AK: none. PF: engineering, from the datasheet's 1 % of the distance at 4 m and 5 frames per second; the shape
    /// is that published for its successor (arXiv 2412.15040).
    pub quadratic: f64,
    /// No more than this, metres. AK: specification, 17 mm. PF: the driver's limit of 70 mm.
    pub cap_m: f64,
}

/// Error that a device repeats in each exposure: `offset * a + scale * b * d + wiggle * sin(2π d / period + c)`, with
/// a, b in −1..1 and the phase c drawn by the device's seed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Systematic {
    /// Which device of its kind.
    pub device: u64,
    /// Largest constant offset, metres.
    ///
    /// AK: half the specification's bound of 11 mm, the other half being left to the wiggle. PF: engineering, half
    /// of the drift of 1 cm until it is warm.
    pub offset_m: f64,
    /// Largest share of the distance. AK: specification, 0.1 %. PF: none known.
    pub scale: f64,
    /// Amplitude of the periodic error of phase measurements, metres. AK, PF: engineering.
    pub wiggle_m: f64,
    /// Its period, metres. AK: engineering. PF: a quarter of the ambiguity of 80 MHz.
    pub wiggle_period_m: f64,
}

/// Spread across the image, where the surface is continuous.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lateral {
    /// Weight of each of the four neighbours in a pixel's value, 0 to 0.2; planes are not changed by it.
    ///
    /// AK, PF: engineering (point spread of about half a pixel).
    pub blur: f64,
    /// Standard deviation of where a pixel really looks, pixels, along both image axes; on a slanted surface it adds
    /// `jitter * (depth change per pixel)` to the axial noise.
    ///
    /// PF: engineering, at the lower end of what is published for its successor (arXiv 2412.15040: part of a pixel
    /// to one pixel). AK: engineering, smaller as its optics are better.
    pub jitter_px: f64,
}

/// Flying pixels: where a pixel sees two depths, it returns something in between, or nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Edges {
    /// A jump larger than this is an edge, metres. AK, PF: engineering (3 cm, 5 cm).
    pub step_m: f64,
    /// Pixels affected on each side of an edge; 0 for none. AK, PF: engineering, a band of two in all.
    pub reach_px: usize,
    /// Share of them that return nothing; the others are uniformly between fore- and background.
    ///
    /// AK, PF: engineering (most are recognized and removed by the device).
    pub drop: f64,
}

/// Missing returns at flat angles: none missing below `start`, all above `end`, linear in the cosine between.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grazing {
    /// Incidence where returns begin to fail, degrees. AK, PF: engineering (around 80 and 75 degrees).
    pub start_deg: f64,
    /// Incidence from which nothing returns, degrees, at least `start_deg`.
    pub end_deg: f64,
}

/// Missing returns on surfaces that mirror: with probability `specular * (anywhere + facing * cosⁿ)`, n = 8.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shiny {
    /// At every angle, as the mirrored light goes elsewhere and returns over other surfaces.
    ///
    /// AK, PF: engineering; that polished surfaces drop out is documented, a rate is not.
    pub anywhere: f64,
    /// In addition where the surface faces the camera and dazzles it. AK, PF: engineering.
    pub facing: f64,
}

/// What is wrong with a sensor's configuration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct SensorError {
    /// Path of the field.
    pub field: &'static str,
    /// Found value.
    pub found: f64,
    /// What is expected.
    pub expected: &'static str,
}

impl Sensor {
    /// Whether the coefficients make sense. [`Sensor::observe`] does not need it: it never panics.
    ///
    /// # Errors
    /// The first field out of its range.
    pub fn check(&self) -> Result<(), SensorError> {
        let within = |field, found: f64, low: f64, high: f64, expected| {
            // Also refuses NaN.
            if (low..=high).contains(&found) { Ok(()) } else { Err(SensorError { field, found, expected }) }
        };
        let (metres, share) = ("0 to 100 metres", "0 to 1");
        for (field, found) in [("lens.width", self.lens.width), ("lens.height", self.lens.height)] {
            within(field, found as f64, 0.0, 8192.0, "at most 8192 pixels")?;
        }
        within("edges.reach_px", self.edges.reach_px as f64, 0.0, MAX_REACH_PX as f64, "at most 8 pixels")?;
        for (field, found) in [("lens.fx_px", self.lens.fx_px), ("lens.fy_px", self.lens.fy_px)] {
            within(field, found, 1e-3, 1e6, "0.001 to 1000000 pixels")?;
        }
        for (field, found) in [("lens.cx_px", self.lens.cx_px), ("lens.cy_px", self.lens.cy_px)] {
            within(field, found, -1e6, 1e6, "-1000000 to 1000000 pixels")?;
        }
        for (field, found) in [
            ("range.nearest_m", self.range.nearest_m),
            ("range.farthest_m", self.range.farthest_m),
            ("axial.floor_m", self.axial.floor_m),
            ("axial.cap_m", self.axial.cap_m),
            ("systematic.offset_m", self.systematic.offset_m),
            ("systematic.wiggle_m", self.systematic.wiggle_m),
            ("edges.step_m", self.edges.step_m),
            ("quantum_m", self.quantum_m),
        ] {
            within(field, found, 0.0, 100.0, metres)?;
        }
        within(
            "systematic.wiggle_period_m",
            self.systematic.wiggle_period_m,
            1e-3,
            100.0,
            "0.001 to 100 metres",
        )?;
        for (field, found) in [
            ("amplitude.fade", self.amplitude.fade),
            ("axial.linear", self.axial.linear),
            ("axial.quadratic", self.axial.quadratic),
            ("systematic.scale", self.systematic.scale),
            ("edges.drop", self.edges.drop),
            ("shiny.anywhere", self.shiny.anywhere),
            ("shiny.facing", self.shiny.facing),
        ] {
            within(field, found, 0.0, 1.0, share)?;
        }
        for (field, found) in
            [("amplitude.floor", self.amplitude.floor), ("amplitude.ceiling", self.amplitude.ceiling)]
        {
            within(field, found, 0.0, f64::MAX, "at least 0")?;
        }
        within("lateral.blur", self.lateral.blur, 0.0, 0.2, "0 to 0.2")?;
        within("lateral.jitter_px", self.lateral.jitter_px, 0.0, 2.0, "0 to 2 pixels")?;
        within("grazing.start_deg", self.grazing.start_deg, 0.0, 90.0, "0 to 90 degrees")?;
        within(
            "grazing.end_deg",
            self.grazing.end_deg,
            self.grazing.start_deg,
            90.0,
            "start_deg to 90 degrees",
        )?;
        for slope in self.illumination.iter().flatten() {
            within("illumination", *slope, -1e3, 1e3, "slopes of -1000 to 1000")?;
        }
        Ok(())
    }

    /// Standard deviation of the axial noise of one pixel, metres; `depth_m` along the optical axis, the rest as in
    /// a [`View`](crate::render::View). Without the share of [`Lateral::jitter_px`] on slanted surfaces.
    pub fn sigma_m(&self, depth_m: f64, albedo: f64, specular: f64, cos_incidence: f64) -> f64 {
        let light = (albedo * (1.0 - specular) * cos_incidence).max(1e-6);
        let (linear, quadratic) = (self.axial.linear * depth_m, self.axial.quadratic * depth_m * depth_m);
        (self.axial.floor_m.powi(2) + (linear * linear + quadratic * quadratic) / light)
            .sqrt()
            .min(self.axial.cap_m)
    }
}
