//! Depth images as frames of a cell, whatever their source.

use std::time::Duration;

use graspd_adapters_core::{DepthFrame, Lens};

/// A frame of millimetres, row major; 0 stays 0.
pub(crate) fn frame(
    size: (usize, usize),
    mm: &[u16],
    lens: Lens,
    sequence: u64,
    stamp: Duration,
) -> DepthFrame {
    DepthFrame {
        width: size.0,
        height: size.1,
        depth_m: mm.iter().map(|mm| f32::from(*mm) * 1e-3).collect(),
        lens,
        world_from_camera: None,
        sequence,
        stamp,
        age: Duration::ZERO,
    }
}
