//! What is wrong with a camera, and what to do about it.

use std::time::Duration;

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
        Err(missing) => {
            let tried: Vec<String> =
                missing.tried.iter().map(|(place, why)| format!("{}: {why}", place.display())).collect();
            return vec![Finding::bad("library libk4a", tried.join("; "), &missing.remedy)];
        }
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
    const SUBJECT: &str = "frame";
    match outcome {
        Ok(frame) => {
            let valid = frame.depth_m.iter().filter(|d| **d > 0.0).count();
            let share = 100.0 * valid as f64 / frame.depth_m.len().max(1) as f64;
            let (width, height) = (frame.width, frame.height);
            let about = format!("{width} x {height}, {share:.0} % with depth, {}", aged(frame.age));
            if valid == 0 {
                return Finding::bad(
                    SUBJECT,
                    about,
                    "take the cover off, point it at something 0.5 to 3 m away",
                );
            }
            Finding::good(SUBJECT, about)
        }
        Err(error) => Finding::bad(SUBJECT, error.to_string(), "see the findings above, then check again"),
    }
}

fn aged(age: Duration) -> String {
    format!("{:.0} ms old", age.as_secs_f64() * 1e3)
}
