//! The factory calibration of a device: the JSON text that the device and its recordings carry.
//!
//! Its numbers are normalized to the sensor's size and count from the sensor's corner; a mode bins and crops the sensor.

use serde::Deserialize;

use crate::lens::{KinectLens, LensModel};
use crate::mode::{ColorResolution, DepthMode};

/// Longest text that is read: a device's is about 8 KB.
pub const MAX_BYTES: usize = 1 << 20;
/// Metric radius of a camera whose own is 0, as the SDK has it.
const DEFAULT_METRIC_RADIUS: f64 = 1.7;

/// Why a calibration is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("calibration: {field}: found {found}, expected {expected}")]
pub struct CalibrationError {
    /// The offending field.
    pub field: String,
    /// Found value.
    pub found: String,
    /// What is expected.
    pub expected: String,
}

fn refuse<T>(field: &str, found: impl ToString, expected: &str) -> Result<T, CalibrationError> {
    Err(CalibrationError { field: field.into(), found: found.to_string(), expected: expected.into() })
}

/// One camera, for all its modes.
#[derive(Debug, Clone, PartialEq)]
struct Camera {
    model: LensModel,
    /// cx, cy, fx, fy, k1 to k6, codx, cody, p2, p1.
    parameters: [f64; 14],
    metric_radius: f64,
    /// Row major; takes points of the depth camera's frame into this one.
    rotation: [f64; 9],
    translation_m: [f64; 3],
}

/// The calibration of a device.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    depth: Camera,
    color: Option<Camera>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct File {
    calibration_information: Information,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Information {
    cameras: Vec<FileCamera>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct FileCamera {
    location: String,
    intrinsics: FileIntrinsics,
    #[serde(default)]
    metric_radius: f64,
    rt: FileRt,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct FileIntrinsics {
    model_type: String,
    model_parameters: Vec<f64>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct FileRt {
    rotation: Vec<f64>,
    translation: Vec<f64>,
}

impl Calibration {
    /// Reads the text; a byte order mark and zeros at the end are usual.
    ///
    /// # Errors
    /// [`CalibrationError`] with the first field that is wrong.
    pub fn from_json(bytes: &[u8]) -> Result<Self, CalibrationError> {
        if bytes.len() > MAX_BYTES {
            return refuse("text", format!("{} bytes", bytes.len()), "at most 1 MiB");
        }
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let end = bytes.iter().rposition(|&b| b != 0).map_or(0, |last| last + 1);
        let file: File = match serde_json::from_slice(&bytes[..end]) {
            Ok(file) => file,
            Err(error) => return refuse("text", error, "the JSON text that a device carries"),
        };
        let cameras = file.calibration_information.cameras;
        let find = |location: &str| cameras.iter().find(|c| c.location == location);
        let Some(depth) = find("CALIBRATION_CameraLocationD0") else {
            return refuse("Cameras", format!("{} cameras", cameras.len()), "one at CameraLocationD0");
        };
        Ok(Self {
            depth: Camera::read("D0", depth)?,
            color: find("CALIBRATION_CameraLocationPV0").map(|c| Camera::read("PV0", c)).transpose()?,
        })
    }

    /// The depth camera's lens in a mode.
    pub fn depth_lens(&self, mode: DepthMode) -> KinectLens {
        let (binned, crop) = mode.binning();
        self.depth.lens(binned, crop, mode.size())
    }

    /// The colour camera's lens; `None` where the calibration has none.
    pub fn color_lens(&self, resolution: ColorResolution) -> Option<KinectLens> {
        let (binned, crop) = resolution.binning();
        Some(self.color.as_ref()?.lens(binned, crop, resolution.size()))
    }

    /// A point of the depth camera's frame in the colour camera's, metres; `None` where the calibration has none.
    pub fn color_from_depth(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 3]> {
        let Camera { rotation: r, translation_m: t, .. } = self.color.as_ref()?;
        // Both cameras' poses are told against one origin; that of the depth camera is the identity in every device.
        let row = |i: usize| r[3 * i] * x + r[3 * i + 1] * y + r[3 * i + 2] * z + t[i];
        Some([row(0), row(1), row(2)])
    }
}

impl Camera {
    fn read(name: &str, file: &FileCamera) -> Result<Self, CalibrationError> {
        let field = |what: &str| format!("{name}.{what}");
        let model = match file.intrinsics.model_type.as_str() {
            "CALIBRATION_LensDistortionModelBrownConrady" => LensModel::BrownConrady,
            "CALIBRATION_LensDistortionModelRational6KT" => LensModel::Rational6Kt,
            other => return refuse(&field("Intrinsics.ModelType"), other, "BrownConrady or Rational6KT"),
        };
        let given = &file.intrinsics.model_parameters;
        let Some(Ok(parameters)) = given.get(..14).map(<[f64; 14]>::try_from) else {
            let found = format!("{} values", given.len());
            return refuse(&field("Intrinsics.ModelParameters"), found, "14 values");
        };
        let focal = parameters[2] > 1e-3 && parameters[3] > 1e-3;
        if !focal || parameters.iter().any(|v| v.abs() > 1e6) {
            let expected = "focal lengths above 0.001, all within a million";
            return refuse(&field("Intrinsics.ModelParameters"), format!("{parameters:?}"), expected);
        }
        let metric_radius = match file.metric_radius {
            radius if radius > 1e-4 && radius < 1e6 => radius,
            0.0 => DEFAULT_METRIC_RADIUS,
            other => return refuse(&field("MetricRadius"), other, "a positive number, or 0"),
        };
        let Ok(rotation) = <[f64; 9]>::try_from(file.rt.rotation.as_slice()) else {
            return refuse(&field("Rt.Rotation"), file.rt.rotation.len(), "9 values");
        };
        let Ok(translation_m) = <[f64; 3]>::try_from(file.rt.translation.as_slice()) else {
            return refuse(&field("Rt.Translation"), file.rt.translation.len(), "3 values");
        };
        for i in 0..3 {
            for j in 0..3 {
                let dot: f64 = (0..3).map(|k| rotation[3 * i + k] * rotation[3 * j + k]).sum();
                let expected = if i == j { 1.0 } else { 0.0 };
                let orthonormal = (dot - expected).abs() < 1e-3;
                if !orthonormal {
                    return refuse(&field("Rt.Rotation"), format!("{rotation:?}"), "a rotation");
                }
            }
        }
        if translation_m.iter().any(|t| t.abs() > 1.0) {
            return refuse(
                &field("Rt.Translation"),
                format!("{translation_m:?}"),
                "metres within the device",
            );
        }
        Ok(Self { model, parameters, metric_radius, rotation, translation_m })
    }

    fn lens(&self, binned: [f64; 2], crop: [f64; 2], size: (usize, usize)) -> KinectLens {
        let [cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1] = self.parameters;
        KinectLens {
            model: self.model,
            size,
            f: [fx * binned[0], fy * binned[1]],
            c: [cx * binned[0] - crop[0] - 0.5, cy * binned[1] - crop[1] - 0.5],
            k: [k1, k2, k3, k4, k5, k6],
            p: [p1, p2],
            center: [codx, cody],
            metric_radius: self.metric_radius,
        }
    }
}

/// A calibration in the text's form, for tests and for made-up recordings. The depth camera's numbers are those of a real
/// device, rounded.
pub const EXAMPLE: &str = include_str!("example_calibration.json");

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_modes_lens_is_the_sensors_binned_and_cropped() {
        let calibration = Calibration::from_json(EXAMPLE.as_bytes()).unwrap();
        let lens = calibration.depth_lens(DepthMode::NfovUnbinned);
        // As the manufacturer's SDK gives them for these numbers.
        for (found, expected) in
            [(lens.f[0], 504.607), (lens.f[1], 504.732), (lens.c[0], 332.781), (lens.c[1], 348.830)]
        {
            assert!((found - expected).abs() < 1e-2, "{found} {expected}");
        }
        assert!((lens.metric_radius - 1.74).abs() < 1e-6);
        let binned = calibration.depth_lens(DepthMode::Nfov2x2binned);
        assert!((binned.f[0] - lens.f[0] / 2.0).abs() < 1e-9);
        // The corner of a binned pixel is that of four pixels.
        assert!((binned.c[0] - ((lens.c[0] + 0.5) / 2.0 - 0.5)).abs() < 1e-9);
        let color = calibration.color_lens(ColorResolution::P720).unwrap();
        assert_eq!((color.size, color.metric_radius), ((1280, 720), DEFAULT_METRIC_RADIUS));
    }

    #[test]
    fn a_byte_order_mark_and_zeros_are_no_harm() {
        let mut text = b"\xef\xbb\xbf".to_vec();
        text.extend(EXAMPLE.as_bytes());
        text.extend([0; 3]);
        assert_eq!(Calibration::from_json(&text), Calibration::from_json(EXAMPLE.as_bytes()));
    }

    #[test]
    fn wrong_texts_are_refused_with_their_field() {
        for (from, to, field) in [
            ("CALIBRATION_CameraLocationD0", "elsewhere", "Cameras"),
            ("ModelBrownConrady", "ModelFisheye", "D0.Intrinsics.ModelType"),
            ("0.49278", "-0.49278", "D0.Intrinsics.ModelParameters"),
            ("\"MetricRadius\": 1.74", "\"MetricRadius\": -1", "D0.MetricRadius"),
            ("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[1, 0, 0, 0, 2, 0, 0, 0, 1]", "D0.Rt.Rotation"),
            ("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[1]", "D0.Rt.Rotation"),
            ("[-0.03208, -0.00221, 0.00388]", "[-32.08, -2.21, 3.88]", "PV0.Rt.Translation"),
            ("{", "", "text"),
        ] {
            let text = EXAMPLE.replacen(from, to, 1);
            assert_ne!(text, EXAMPLE, "{from}");
            let error = Calibration::from_json(text.as_bytes()).unwrap_err();
            assert_eq!(error.field, field, "{error}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_texts_end_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _refused = Calibration::from_json(&bytes);
        }

        #[test]
        fn garbled_texts_end_without_panic(at in 0usize..1500, byte in any::<u8>()) {
            let mut text = EXAMPLE.as_bytes().to_vec();
            let at = at % text.len();
            text[at] = byte;
            if let Ok(calibration) = Calibration::from_json(&text) {
                let _ray = calibration.depth_lens(DepthMode::NfovUnbinned).unproject([3.0, 4.0]);
            }
        }
    }
}
