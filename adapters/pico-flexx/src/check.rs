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
        Err(missing) => vec![Finding::of_missing(&missing)],
    }
}

/// A frame, or why none came.
pub(crate) fn frame(settings: &FlexxSettings, outcome: &Result<DepthFrame, DeviceError>) -> Finding {
    let silent = match &settings.source {
        Source::Royale(_) => {
            "plug the camera in; open all cameras in one process; check the udev rule of the SDK (vendor 1c28)"
        }
        Source::Rosbridge(_) => {
            "start driver and rosbridge_server; compare the topics with `ros2 topic list` (or `rostopic list`)"
        }
    };
    Finding::of_frame(outcome, "point it at something 0.1 to 4 m away; raise max_noise_m", silent)
}
