//! What is looked at before a device is used: its settings, and what `graspd device check` prints of the device itself.

use crate::library::LibraryMissing;
use crate::{DepthFrame, DeviceError};

/// Why settings are not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct SettingsError {
    /// The field, with dots between tables, for example `limits.speed_m_s`.
    pub field: String,
    /// Found value.
    pub found: String,
    /// What is expected.
    pub expected: String,
}

/// Refuses a setting unless it is `ok`.
///
/// # Errors
/// [`SettingsError`] with the field, what was found and what is expected.
pub fn require(
    field: &str,
    found: impl ToString,
    ok: bool,
    expected: impl Into<String>,
) -> Result<(), SettingsError> {
    if ok {
        return Ok(());
    }
    Err(SettingsError { field: field.to_owned(), found: found.to_string(), expected: expected.into() })
}

/// Refuses a number that does not lie from `least` to `most`; NaN never does.
///
/// # Errors
/// As [`require`].
pub fn require_within(field: &str, value: f64, least: f64, most: f64) -> Result<(), SettingsError> {
    require(field, value, (least..=most).contains(&value), format!("{least} to {most}"))
}

/// One thing that was looked at, and what to do about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at, for example `motor 7 (middle_dip)`.
    pub subject: String,
    /// True when it is as it must be for the device to do its work.
    pub ok: bool,
    /// What was found.
    pub found: String,
    /// What to do about it; empty where nothing is.
    pub advice: String,
}

impl Finding {
    /// It is as it should be.
    pub fn good(subject: impl Into<String>, found: impl Into<String>) -> Self {
        Self { subject: subject.into(), ok: true, found: found.into(), advice: String::new() }
    }

    /// It is not; `advice` says what to do.
    pub fn bad(subject: impl Into<String>, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { subject: subject.into(), ok: false, found: found.into(), advice: advice.into() }
    }

    /// Settings that were refused.
    pub fn of_settings(error: &SettingsError) -> Self {
        let advice = format!("set `{}` in its settings to: {}", error.field, error.expected);
        Self::bad("settings", error.to_string(), advice)
    }

    /// A vendor's library that is not there.
    pub fn of_missing(missing: &LibraryMissing) -> Self {
        let tried: Vec<String> =
            missing.tried.iter().map(|(place, why)| format!("{}: {why}", place.display())).collect();
        Self::bad(format!("library {}", missing.library), tried.join("; "), &missing.remedy)
    }

    /// A frame of a depth camera, or why none came; `blind` says what to do about one without depth, `silent` about none.
    pub fn of_frame(outcome: &Result<DepthFrame, DeviceError>, blind: &str, silent: &str) -> Self {
        const SUBJECT: &str = "frame";
        let frame = match outcome {
            Ok(frame) => frame,
            Err(error) => return Self::bad(SUBJECT, error.to_string(), silent),
        };
        let valid = frame.depth_m.iter().filter(|d| **d > 0.0).count();
        let share = 100.0 * valid as f64 / frame.depth_m.len().max(1) as f64;
        let age_ms = frame.age.as_secs_f64() * 1e3;
        let (width, height) = (frame.width, frame.height);
        let about = format!("{width} x {height}, {share:.0} % with depth, {age_ms:.0} ms old");
        if valid == 0 { Self::bad(SUBJECT, about, blind) } else { Self::good(SUBJECT, about) }
    }

    /// Whether motion is armed.
    pub fn of_arming(armed: bool) -> Self {
        if armed {
            return Self::good("motion", "armed");
        }
        Self::bad("motion", "not armed", "set `armed = true` in the settings when nobody is in reach")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_without_depth_and_a_library_without_a_place_are_findings() {
        let lens = crate::Lens { fx_px: 5.0, fy_px: 5.0, cx_px: 1.5, cy_px: 1.0, distortion: [0.0; 8] };
        let frame = |depth_m: [f32; 4]| DepthFrame {
            width: 2,
            height: 2,
            depth_m: std::sync::Arc::from(depth_m.to_vec()),
            lens,
            world_from_camera: None,
            sequence: 1,
            stamp: std::time::Duration::ZERO,
            age: std::time::Duration::from_millis(20),
        };
        let good = Finding::of_frame(&Ok(frame([0.5, 0.0, 0.5, 0.5])), "uncover it", "plug it in");
        assert!(good.ok && good.found == "2 x 2, 75 % with depth, 20 ms old", "{good:?}");
        let blind = Finding::of_frame(&Ok(frame([0.0; 4])), "uncover it", "plug it in");
        assert!(!blind.ok && blind.advice == "uncover it", "{blind:?}");
        let error = DeviceError::Unsupported { device: "camera".into(), operation: "capture" };
        let silent = Finding::of_frame(&Err(error), "uncover it", "plug it in");
        assert!(!silent.ok && silent.advice == "plug it in", "{silent:?}");
        let missing = LibraryMissing {
            library: "libx",
            tried: vec![("/a".into(), "not there".into())],
            remedy: "install it".into(),
        };
        let found = Finding::of_missing(&missing);
        assert_eq!((found.subject.as_str(), found.found.as_str()), ("library libx", "/a: not there"));
    }

    #[test]
    fn what_is_wrong_says_what_was_found_and_what_to_do() {
        assert_eq!(require_within("speed", 0.5, 0.0, 1.0), Ok(()));
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.1] {
            let error = require_within("speed", value, 0.0, 1.0).unwrap_err();
            assert_eq!(error.to_string(), format!("speed: found {value}, expected 0 to 1"));
            let finding = Finding::of_settings(&error);
            assert!(!finding.ok && finding.advice == "set `speed` in its settings to: 0 to 1", "{finding:?}");
        }
        assert!(Finding::of_arming(true).ok && Finding::of_arming(true).advice.is_empty());
        assert!(!Finding::of_arming(false).ok && !Finding::of_arming(false).advice.is_empty());
    }
}
