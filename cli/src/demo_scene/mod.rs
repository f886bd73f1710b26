//! The demo frame: a cluttered table that this project made up, seen by a simulated depth camera.
//!
//! [`objects`] says what stands on the table, [`shape`] what each thing looks like as a signed distance
//! function, [`camera`] casts the rays, [`sensor`] spoils the exact depth the way a depth camera does. The
//! bundled files in `assets/` are the output of [`clutter`]; a test compares them, and
//! `graspd demo --regenerate DIR` writes them anew.

pub(crate) mod camera;
pub(crate) mod objects;
pub(crate) mod sensor;
pub(crate) mod shape;

use crate::input::depth::RawDepth;
use crate::input::intrinsics::FrameFile;
use camera::Camera;
use objects::Placed;

/// Seed of the bundled frame's noise.
pub(crate) const SEED: u64 = 20_240_611;

/// The bundled depth image: 16-bit PNG, millimetres, 0 where there was no return.
pub(crate) const DEPTH_PNG: &[u8] = include_bytes!("../../assets/demo_depth.png");

/// The bundled intrinsics and camera pose.
pub(crate) const FRAME_JSON: &[u8] = include_bytes!("../../assets/demo_frame.json");

/// A simulated depth frame: millimetres, row major, 0 where there is no return.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DepthFrame {
    /// The camera that took it.
    pub(crate) camera: Camera,
    /// `width * height` values.
    pub(crate) depth_mm: Vec<u16>,
}

/// The demo scene: household objects in clutter.
pub(crate) fn clutter(seed: u64) -> DepthFrame {
    observe(&objects::clutter(), seed)
}

/// The same table with nothing on it.
#[cfg(test)]
pub(crate) fn empty_table(seed: u64) -> DepthFrame {
    observe(&[], seed)
}

fn observe(objects: &[Placed], seed: u64) -> DepthFrame {
    let camera = Camera::above_table();
    let exact = camera.cast(objects, seed);
    let depth_mm = sensor::observe(&camera, &exact, seed);
    DepthFrame { camera, depth_mm }
}

impl DepthFrame {
    /// The image as a 16-bit grey PNG.
    pub(crate) fn to_png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.camera.width as u32, self.camera.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(png::Filter::Adaptive);
        let mut writer = encoder.write_header()?;
        let data: Vec<u8> = self.depth_mm.iter().flat_map(|d| d.to_be_bytes()).collect();
        writer.write_image_data(&data)?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Intrinsics and camera pose in the format of `--intrinsics`.
    pub(crate) fn to_json(&self) -> String {
        let c = &self.camera;
        let m = c.world_from_camera.to_homogeneous();
        let rows: Vec<Vec<f64>> = (0..4).map(|r| (0..4).map(|k| round(m[(r, k)])).collect()).collect();
        let value = serde_json::json!({
            "name": "graspd_demo",
            "width": c.width, "height": c.height,
            "fx": c.focal_px, "fy": c.focal_px, "cx": c.cx_px, "cy": c.cy_px,
            "depth_scale": 0.001,
            "camera_to_world": rows,
            "note": "simulated: world origin in the middle of the table top, z up; camera x right, y down, z forward",
        });
        format!("{value:#}\n")
    }
}

/// Nine decimals: a nanometre, and no platform's last bit in the bundled file.
fn round(x: f64) -> f64 {
    let r = (x * 1e9).round() / 1e9;
    if r == 0.0 { 0.0 } else { r }
}

/// The bundled frame, decoded by the same code that reads a user's files.
///
/// # Errors
/// None for the bundled files; the type is that of the readers.
pub(crate) fn bundled() -> anyhow::Result<(RawDepth, FrameFile)> {
    let depth = RawDepth::from_png("demo_depth.png", DEPTH_PNG)?;
    let frame = FrameFile::parse("demo_frame.json", FRAME_JSON)?;
    Ok((depth, frame))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bundled_files_are_the_generators_output() {
        let frame = clutter(SEED);
        let bundled = RawDepth::from_png("demo_depth.png", DEPTH_PNG).unwrap();
        assert_eq!((bundled.width, bundled.height), (640, 480));
        let values = bundled.as_u16().unwrap();
        // Square roots and products are the same everywhere; sines may differ in their last bit.
        let differing = values.iter().zip(&frame.depth_mm).filter(|(a, b)| a != b).count();
        assert!(differing < values.len() / 1000, "{differing} pixels differ");
        let written: serde_json::Value = serde_json::from_str(&frame.to_json()).unwrap();
        let shipped: serde_json::Value = serde_json::from_slice(FRAME_JSON).unwrap();
        assert_eq!(written["fx"], shipped["fx"]);
        assert_eq!(written["camera_to_world"], shipped["camera_to_world"]);
    }

    #[test]
    fn empty_table_is_a_plane() {
        let frame = empty_table(3);
        let camera = &frame.camera;
        let (mut seen, mut far) = (0usize, 0usize);
        for v in (0..camera.height).step_by(4) {
            for u in (0..camera.width).step_by(4) {
                let z = f64::from(frame.depth_mm[v * camera.width + u]) * 0.001;
                if z > 0.0 && z < 1.0 {
                    let p = camera.world_from_camera
                        * nalgebra::Point3::from(camera.direction(u as f64, v as f64) * z);
                    seen += 1;
                    far += usize::from(p.z.abs() > 0.012);
                }
            }
        }
        assert!(seen > 10_000, "{seen}");
        assert!(far * 200 < seen, "{far} of {seen} points off the table");
    }
}
