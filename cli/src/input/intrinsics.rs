//! The JSON file that goes with a depth image: lens, scale and, where known, the camera's pose.
//!
//! ```json
//! {"fx": 585.0, "fy": 585.0, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480,
//!  "depth_scale": 0.001, "camera_to_world": [[…4], …4 rows], "distortion": [k1, k2, p1, p2, k3, …]}
//! ```
//! `width`, `height`, `depth_scale` (default 0.001: millimetres), `camera_to_world` and `distortion` (4, 5 or
//! 8 values in OpenCV's order) may be left out; other keys are ignored.

use std::path::Path;

use graspd_planner::frame::{Frame, Intrinsics};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Map, Value};

use super::InputError;
use super::depth::RawDepth;

/// The parsed file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FrameFile {
    /// The file's name, for messages.
    pub(crate) file: String,
    /// The lens.
    pub(crate) intrinsics: Intrinsics,
    /// Image size that the intrinsics are for, where the file says so.
    pub(crate) size: Option<(usize, usize)>,
    /// Metres per unit of an integer image.
    pub(crate) depth_scale: f64,
    /// Pose of the camera, where the file says so.
    pub(crate) world_from_camera: Option<Isometry3<f64>>,
}

impl FrameFile {
    /// Reads and checks the file.
    ///
    /// # Errors
    /// Naming the key that is missing or wrong.
    pub(crate) fn open(path: &Path) -> Result<Self, InputError> {
        Self::parse(&path.display().to_string(), &super::read(path)?)
    }

    /// Checks the contents of a file.
    ///
    /// # Errors
    /// Naming the key that is missing or wrong.
    pub(crate) fn parse(file: &str, bytes: &[u8]) -> Result<Self, InputError> {
        let value: Value =
            serde_json::from_slice(bytes).map_err(|e| InputError::wrong(file, "JSON", e, "a JSON object"))?;
        let Value::Object(object) = value else {
            return Err(InputError::wrong(file, "JSON", kind(&value), "an object with fx, fy, cx, cy"));
        };
        let keys = Keys { file, object: &object };
        let intrinsics = Intrinsics {
            fx_px: keys.positive("fx")?,
            fy_px: keys.positive("fy")?,
            cx_px: keys.number("cx")?,
            cy_px: keys.number("cy")?,
            distortion: keys.distortion()?,
        };
        let size = match (keys.size("width")?, keys.size("height")?) {
            (Some(width), Some(height)) => Some((width, height)),
            _ => None,
        };
        let depth_scale = if keys.has("depth_scale") { keys.positive("depth_scale")? } else { 0.001 };
        let world_from_camera = keys.pose("camera_to_world")?;
        Ok(Self { file: file.into(), intrinsics, size, depth_scale, world_from_camera })
    }

    /// Puts image and lens together.
    ///
    /// # Errors
    /// If the intrinsics are for an image of another size.
    pub(crate) fn frame(&self, depth: &RawDepth, labels: Option<Vec<u8>>) -> Result<Frame, InputError> {
        if let Some((width, height)) = self.size
            && (width, height) != (depth.width, depth.height)
        {
            let expected = format!("{} x {}, the size of {}", depth.width, depth.height, depth.file);
            return Err(InputError::wrong(
                &self.file,
                "width, height",
                format!("{width} x {height}"),
                expected,
            ));
        }
        Ok(Frame {
            image: depth.in_metres(self.depth_scale),
            intrinsics: self.intrinsics,
            world_from_camera: self.world_from_camera,
            labels,
        })
    }
}

struct Keys<'a> {
    file: &'a str,
    object: &'a Map<String, Value>,
}

impl Keys<'_> {
    fn has(&self, key: &str) -> bool {
        self.object.get(key).is_some_and(|v| !v.is_null())
    }

    fn wrong(&self, key: &str, found: impl ToString, expected: &str) -> InputError {
        InputError::wrong(self.file, key, found, expected)
    }

    fn number(&self, key: &str) -> Result<f64, InputError> {
        match self.object.get(key) {
            None => Err(self.wrong(key, "nothing", "a number of pixels")),
            Some(v) => v
                .as_f64()
                .filter(|x| x.is_finite())
                .ok_or_else(|| self.wrong(key, kind(v), "a finite number")),
        }
    }

    fn positive(&self, key: &str) -> Result<f64, InputError> {
        let x = self.number(key)?;
        if x > 0.0 { Ok(x) } else { Err(self.wrong(key, x, "a number above 0")) }
    }

    fn size(&self, key: &str) -> Result<Option<usize>, InputError> {
        if !self.has(key) {
            return Ok(None);
        }
        let value = &self.object[key];
        match value.as_u64().filter(|&x| x > 0) {
            Some(x) => Ok(Some(x as usize)),
            None => Err(self.wrong(key, value, "a whole number of pixels above 0")),
        }
    }

    fn numbers(&self, key: &str, value: &Value, expected: &str) -> Result<Vec<f64>, InputError> {
        value
            .as_array()
            .and_then(|list| list.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>())
            .ok_or_else(|| self.wrong(key, kind(value), expected))
    }

    fn distortion(&self) -> Result<[f64; 8], InputError> {
        let mut all = [0.0; 8];
        if self.has("distortion") {
            let expected = "0, 4, 5 or 8 numbers: k1, k2, p1, p2, k3, k4, k5, k6";
            let values = self.numbers("distortion", &self.object["distortion"], expected)?;
            if ![0, 4, 5, 8].contains(&values.len()) {
                return Err(self.wrong("distortion", format!("{} numbers", values.len()), expected));
            }
            all[..values.len()].copy_from_slice(&values);
        }
        Ok(all)
    }

    fn pose(&self, key: &str) -> Result<Option<Isometry3<f64>>, InputError> {
        if !self.has(key) {
            return Ok(None);
        }
        let expected = "4 rows of 4 numbers, the last 0 0 0 1";
        let value = &self.object[key];
        let rows = value.as_array().ok_or_else(|| self.wrong(key, kind(value), expected))?;
        let rows: Vec<Vec<f64>> =
            rows.iter().map(|row| self.numbers(key, row, expected)).collect::<Result<_, _>>()?;
        if rows.len() != 4 || rows.iter().any(|row| row.len() != 4) {
            let found = format!("{} rows of {:?}", rows.len(), rows.iter().map(Vec::len).collect::<Vec<_>>());
            return Err(self.wrong(key, found, expected));
        }
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.wrong(key, format!("last row {:?}", rows[3]), expected));
        }
        let m = Matrix3::from_fn(|r, c| rows[r][c]);
        if (m * m.transpose() - Matrix3::identity()).norm() > 1e-3 || (m.determinant() - 1.0).abs() > 1e-3 {
            let found = format!("a matrix with determinant {:.4}", m.determinant());
            return Err(self.wrong(key, found, "a rotation (orthonormal, right-handed)"));
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&m));
        let translation = Translation3::from(Vector3::new(rows[0][3], rows[1][3], rows[2][3]));
        Ok(Some(Isometry3::from_parts(translation, rotation)))
    }
}

/// A value as people call it.
fn kind(value: &Value) -> String {
    match value {
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "an object".into(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(json: &str) -> String {
        FrameFile::parse("f.json", json.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn defaults_and_ignored_keys() {
        let json = r#"{"fx": 500, "fy": 501.5, "cx": 320, "cy": 240, "sensor": "any"}"#;
        let frame = FrameFile::parse("f.json", json.as_bytes()).unwrap();
        assert_eq!(frame.depth_scale, 0.001);
        assert_eq!((frame.size, frame.world_from_camera), (None, None));
        assert_eq!(frame.intrinsics.fy_px, 501.5);
    }

    #[test]
    fn errors_name_the_key() {
        assert_eq!(
            error(r#"{"fx": 5, "cx": 1, "cy": 1}"#),
            "f.json: fy: found nothing, expected a number of pixels"
        );
        assert_eq!(
            error(r#"{"fx": -5, "fy": 5, "cx": 1, "cy": 1}"#),
            "f.json: fx: found -5, expected a number above 0"
        );
        let lens = r#""fx": 5, "fy": 5, "cx": 1, "cy": 1"#;
        assert_eq!(
            error(&format!("{{{lens}, \"distortion\": [1, 2]}}")),
            "f.json: distortion: found 2 numbers, expected 0, 4, 5 or 8 numbers: k1, k2, p1, p2, k3, k4, k5, k6"
        );
        assert!(error(&format!("{{{lens}, \"camera_to_world\": [[1,0,0,0]]}}")).contains("1 rows of [4]"));
        let mirrored = "[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]";
        assert!(error(&format!("{{{lens}, \"camera_to_world\": {mirrored}}}")).contains("right-handed"));
        assert!(error("[1]").contains("found a list of 1"));
        assert!(error("{").starts_with("f.json: JSON: found EOF"));
    }

    #[test]
    fn another_image_size_is_refused() {
        let json = r#"{"fx": 5, "fy": 5, "cx": 1, "cy": 1, "width": 4, "height": 2}"#;
        let frame = FrameFile::parse("f.json", json.as_bytes()).unwrap();
        let depth = RawDepth {
            file: "d.png".into(),
            width: 2,
            height: 2,
            values: super::super::depth::DepthValues::U16(vec![0; 4]),
        };
        assert_eq!(
            frame.frame(&depth, None).unwrap_err().to_string(),
            "f.json: width, height: found 4 x 2, expected 2 x 2, the size of d.png"
        );
    }
}
