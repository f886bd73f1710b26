//! What is wrong with a camera, and what to do about it.

use graspd_adapters_core::check::Finding;
use graspd_adapters_core::{DepthFrame, DeviceError};

use crate::recording::Recording;
use crate::sdk;
use crate::settings::{DeviceSettings, KinectSettings, RecordingSettings, Source};

/// Everything that can be checked without a frame. Blocking.
pub(crate) fn still(settings: &KinectSettings) -> Vec<Finding> {
    match &settings.source {
        Source::Device(device) => library(device),
        Source::Recording(recording) => file(recording),
    }
}

fn library(settings: &DeviceSettings) -> Vec<Finding> {
    let (sdk, place) = match sdk::load(settings.library.as_deref()) {
        Ok(loaded) => loaded,
        Err(missing) => return vec![Finding::of_missing(&missing)],
    };
    let mut found = vec![Finding::good("library libk4a", place.display().to_string())];
    found.push(match sdk.try_images() {
        Ok(()) => Finding::good("images of the library", "as this adapter expects them"),
        Err(error) => {
            Finding::bad("images of the library", error.to_string(), "install version 1.4 of the library")
        }
    });
    found.push(match sdk.installed() {
        0 => Finding::bad(
            "devices",
            "none",
            "connect power and a USB 3 cable; install the udev rule (vendor 045e, products 097a to 097e)",
        ),
        count => Finding::good("devices", count.to_string()),
    });
    found
}

fn file(settings: &RecordingSettings) -> Vec<Finding> {
    let mut recording = match Recording::open(&settings.path) {
        Ok(recording) => recording,
        Err(error) => {
            let advice = "name a recording of k4arecorder that has depth";
            return vec![Finding::bad("recording", error.to_string(), advice)];
        }
    };
    let about = format!(
        "{}, {:.1} frames a second, device {}",
        recording.mode().label(),
        1.0 / recording.period().as_secs_f64(),
        recording.serial().unwrap_or("unknown"),
    );
    let mut found = vec![Finding::good("recording", about)];
    found.push(match recording.lens().to_frame() {
        Ok(lens) => Finding::good("calibration", format!("f {:.1}, {:.1} px", lens.fx_px, lens.fy_px)),
        Err(error) => Finding::bad("calibration", error.to_string(), "record with a device that was sold"),
    });
    let mut frames = 0u64;
    let outcome = loop {
        match recording.next_depth() {
            Ok(Some(_)) => frames += 1,
            Ok(None) => break None,
            Err(error) => break Some(error.to_string()),
        }
    };
    let cut = if recording.is_cut() { ", cut off" } else { "" };
    found.push(match outcome {
        None if frames > 0 => Finding::good("depth frames", format!("{frames}{cut}")),
        None => Finding::bad("depth frames", format!("none{cut}"), "record again"),
        Some(error) => Finding::bad(
            "depth frames",
            format!("{frames}, then {error}"),
            "record again, or play up to there",
        ),
    });
    found
}

/// A frame, or why none came.
pub(crate) fn frame(outcome: &Result<DepthFrame, DeviceError>) -> Finding {
    let blind = "take the cover off, point it at something 0.5 to 3 m away";
    Finding::of_frame(outcome, blind, "see the findings above, then check again")
}
