//! Structures as the library lays them out in memory.

use std::ffi::{c_int, c_longlong};

/// A point as the library has it: 20 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub(super) struct DepthPoint {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) z: f32,
    pub(super) noise: f32,
    pub(super) gray_value: u16,
    pub(super) depth_confidence: u8,
}

/// Depth of one exposure as the library has it.
#[repr(C)]
pub(super) struct DepthData {
    pub(super) version: c_int,
    pub(super) timestamp: c_longlong,
    pub(super) stream_id: u16,
    pub(super) width: u16,
    pub(super) height: u16,
    pub(super) exposure_times: *const u32,
    pub(super) nr_exposure_times: u32,
    pub(super) points: *const DepthPoint,
    pub(super) nr_points: u32,
}

/// Lens as the library has it.
#[repr(C)]
pub(super) struct LensParameters {
    pub(super) principal_point: [f32; 2],
    pub(super) focal_length: [f32; 2],
    pub(super) tangential: [f32; 2],
    pub(super) radial: *mut f32,
    pub(super) nr_radial: u32,
}

const _: () = assert!(size_of::<DepthPoint>() == 20);
#[cfg(target_pointer_width = "64")]
const _: () = assert!(size_of::<DepthData>() == 56 && size_of::<LensParameters>() == 40);

/// The callback that takes depth data.
pub(super) type Listener = extern "C" fn(*const DepthData);
