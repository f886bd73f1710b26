//! What is wrong with a camera, and what to do about it.

use graspd_adapters_core::check::Finding;
use graspd_adapters_core::{DepthFrame, DeviceError};

use crate::royale;
use crate::settings::{FlexxSettings, Source};

/// Everything that can be checked without a frame. Blocking.
pub(crate) fn still(settings: &FlexxSettings) -> Vec<Finding> {
    let Source::Royale(source) = &settings.source else { return Vec::new() };
    match royale::load(source.library.as_deref()) {
        Ok((library, place)) => {
            let [major, minor, patch] = library.version();
            let about = format!("{} {major}.{minor}.{patch}", place.display());
            vec![Finding::good("library libroyaleCAPI", about)]
        }
        Err(missing) => {
            let tried: Vec<String> =
                missing.tried.iter().map(|(place, why)| format!("{}: {why}", place.display())).collect();
            vec![Finding::bad("library libroyaleCAPI", tried.join("; "), &missing.remedy)]
        }
    }
}

/// A frame, or why none came.
pub(crate) fn frame(settings: &FlexxSettings, outcome: &Result<DepthFrame, DeviceError>) -> Finding {
    const SUBJECT: &str = "frame";
    match outcome {
        Ok(frame) => {
            let valid = frame.depth_m.iter().filter(|d| **d > 0.0).count();
            let share = 100.0 * valid as f64 / frame.depth_m.len().max(1) as f64;
            let age_ms = frame.age.as_secs_f64() * 1e3;
            let about =
                format!("{} x {}, {share:.0} % with depth, {age_ms:.0} ms old", frame.width, frame.height);
            if valid == 0 {
                return Finding::bad(
                    SUBJECT,
                    about,
                    "point it at something 0.1 to 4 m away; raise max_noise_m",
                );
            }
            Finding::good(SUBJECT, about)
        }
        Err(error) => {
            let advice = match &settings.source {
                Source::Royale(_) => {
                    "plug the camera in; open all cameras in one process; check the udev rule of the SDK (vendor 1c28)"
                }
                Source::Rosbridge(_) => {
                    "start driver and rosbridge_server; compare the topics with `ros2 topic list` (or `rostopic list`)"
                }
            };
            Finding::bad(SUBJECT, error.to_string(), advice)
        }
    }
}
