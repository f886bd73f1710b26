//! Wire ↔ domain: parse, don't validate. Behind this module nobody sees a wire type or a bad quaternion.
//!
//! Every fault names the path of the field, what was found and what was expected. Out of range is an
//! error, never clamped in silence; unset takes the documented default.

mod assignment;
mod frame;
mod geometry;
mod grasp;
mod hand;
mod hand_geometry;
mod options;
mod request;
mod scene;
mod servo;

pub(crate) use assignment::AssignmentJob;
pub(crate) use frame::EncodedFrame;
pub(crate) use grasp::{PlanContext, out_of_time_response, plan_response};
pub(crate) use hand::{hand_id, hand_message, hand_name};
pub(crate) use hand_geometry::geometry_message;
pub(crate) use request::{
    HandJob, HandJobs, Parsed, SceneRequest, multi_hand, plan_grasps, read_scene, report_outcome,
};
pub(crate) use scene::{SceneContext, scene_response};
pub(crate) use servo::{EncodedServoFrame, ServoWords, servo_answer, servo_config};

use std::fmt::Display;
use std::time::Duration;

use crate::error::FieldError;

/// A number in `[low, high]`, where unset (0 for plain fields) means `default`.
fn number_within(
    value: Option<f64>,
    default: f64,
    (low, high): (f64, f64),
    path: &str,
) -> Result<f64, FieldError> {
    match value {
        None => Ok(default),
        Some(v) if v.is_finite() && (low..=high).contains(&v) => Ok(v),
        Some(v) => Err(FieldError::value(path, v, format!("{low} to {high}"))),
    }
}

/// A finite number above 0 and at most `high`, where unset means `default`.
fn positive_up_to(value: Option<f64>, default: f64, high: f64, path: &str) -> Result<f64, FieldError> {
    match value {
        None => Ok(default),
        Some(v) if v.is_finite() && v > 0.0 && v <= high => Ok(v),
        Some(v) => Err(FieldError::value(path, v, format!("more than 0, at most {high}"))),
    }
}

/// A count in `1..=high`, where 0 means `default`.
fn count(value: i32, default: usize, high: i32, path: &str) -> Result<usize, FieldError> {
    match usize::try_from(value) {
        Ok(0) => Ok(default),
        Ok(v) if value <= high => Ok(v),
        _ => Err(FieldError::value(path, value, format!("1 to {high}, or 0 for {default}"))),
    }
}

/// The enum value with that number, if there is one.
fn known_enum<E: TryFrom<i32>>(value: i32, path: &str) -> Result<E, FieldError> {
    E::try_from(value).map_err(|_| FieldError::value(path, value, "a value of the enum"))
}

/// Text from a caller as it may appear in an error: quoted, and not longer than a line.
pub(crate) fn quoted(text: &str) -> String {
    let head = shortened(text);
    if head.len() == text.len() {
        return format!("{text:?}");
    }
    format!("{head:?} and {} more bytes", text.len() - head.len())
}

/// The beginning of a text from a caller, not longer than a line.
pub(crate) fn shortened(text: &str) -> String {
    const LONGEST: usize = 80;
    text.chars().take(LONGEST).collect()
}

/// A duration on the wire.
pub(crate) fn duration_message(duration: Duration) -> prost_types::Duration {
    prost_types::Duration {
        seconds: i64::try_from(duration.as_secs()).unwrap_or(i64::MAX),
        nanos: i32::try_from(duration.subsec_nanos()).unwrap_or(0),
    }
}

/// A count on the wire.
pub(crate) fn count_message(count: usize) -> i32 {
    i32::try_from(count).unwrap_or(i32::MAX)
}

/// `path.name`.
fn join(path: &str, name: impl Display) -> String {
    if path.is_empty() { name.to_string() } else { format!("{path}.{name}") }
}

#[cfg(test)]
mod tests;
