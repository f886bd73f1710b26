//! Depth frames from pixels.

use graspd_proto::v1::{CameraIntrinsics, DepthEncoding, DepthFrame};

/// A frame of 16-bit pixels (0 is no return), row major, `scale_m` metres for one unit.
///
/// Set `camera_pose` on the result where the camera's pose is known.
pub fn depth_frame_u16(
    width_px: i32,
    height_px: i32,
    scale_m: f64,
    pixels: &[u16],
    intrinsics: CameraIntrinsics,
) -> DepthFrame {
    let data: Vec<u8> = pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
    DepthFrame {
        width_px,
        height_px,
        encoding: DepthEncoding::RawU16.into(),
        depth_scale_m: scale_m,
        data: data.into(),
        intrinsics: Some(intrinsics),
        ..DepthFrame::default()
    }
}

/// A frame of float pixels in metres (NaN or 0 is no return), row major.
pub fn depth_frame_f32(
    width_px: i32,
    height_px: i32,
    depth_m: &[f32],
    intrinsics: CameraIntrinsics,
) -> DepthFrame {
    let data: Vec<u8> = depth_m.iter().flat_map(|p| p.to_le_bytes()).collect();
    DepthFrame {
        width_px,
        height_px,
        encoding: DepthEncoding::RawF32.into(),
        data: data.into(),
        intrinsics: Some(intrinsics),
        ..DepthFrame::default()
    }
}
