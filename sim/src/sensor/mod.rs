//! From a perfect view to what a real depth camera would deliver.

use crate::camera::Pinhole;
use crate::render::View;

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

/// A depth camera: its lens, and its faults.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// The lens.
    pub lens: Pinhole,
}

impl Sensor {
    /// Azure Kinect, NFOV unbinned, 640 x 576.
    pub fn azure_kinect() -> Self {
        unimplemented!()
    }

    /// Pico Flexx, 224 x 172.
    pub fn pico_flexx() -> Self {
        unimplemented!()
    }

    /// One exposure. The seed decides the noise; the same seed gives the same image.
    pub fn observe(&self, view: &View, seed: u64) -> DepthImage {
        unimplemented!("{view:?} {seed}")
    }
}
