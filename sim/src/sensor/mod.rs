//! From a perfect view to what a real depth camera would deliver.
//!
//! A time-of-flight camera measures with light of its own, so most of its faults follow from how much of it
//! comes back. The *amplitude* here is `albedo * (1 - specular) * cos(incidence) / distance²`, distance along the
//! optical axis in metres: 1 for a white matt surface that faces the camera at one metre.
//!
//! Not modelled: lens distortion (images are rectified), multipath between surfaces, scatter in the lens, drift
//! while the device warms up, motion during the exposure.

mod config;
mod device;
mod observe;
mod presets;

pub use config::{Amplitude, Axial, Edges, Grazing, Lateral, Range, Sensor, SensorError, Shiny, Systematic};
pub use device::{DepthCamera, Shot};

/// A depth image as a driver delivers it.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Distance along the optical axis, metres, row major; 0 where there was no return.
    pub depth_m: Vec<f32>,
}

#[cfg(test)]
mod tests;
