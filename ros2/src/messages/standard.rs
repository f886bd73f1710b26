//! `builtin_interfaces`, `std_msgs`, `std_srvs`.

use serde::{Deserialize, Serialize};

/// `builtin_interfaces/Time`: since 1970, or since the start of a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Stamp {
    /// Whole seconds.
    pub sec: i32,
    /// And nanoseconds, less than a second.
    pub nanosec: u32,
}

impl Stamp {
    /// The time between two stamps, whichever is earlier.
    pub fn distance(self, other: Self) -> std::time::Duration {
        let nanos = |s: Self| i64::from(s.sec) * 1_000_000_000 + i64::from(s.nanosec);
        std::time::Duration::from_nanos(nanos(self).abs_diff(nanos(other)))
    }

    /// The system's clock.
    pub fn now() -> Self {
        let since = std::time::UNIX_EPOCH.elapsed().unwrap_or_default();
        Self { sec: i32::try_from(since.as_secs()).unwrap_or(i32::MAX), nanosec: since.subsec_nanos() }
    }
}

impl std::fmt::Display for Stamp {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{:09}", self.sec, self.nanosec)
    }
}

/// `builtin_interfaces/Duration`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Duration {
    /// Whole seconds.
    pub sec: i32,
    /// And nanoseconds, less than a second.
    pub nanosec: u32,
}

impl From<std::time::Duration> for Duration {
    fn from(time: std::time::Duration) -> Self {
        Self { sec: i32::try_from(time.as_secs()).unwrap_or(i32::MAX), nanosec: time.subsec_nanos() }
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Header {
    /// Time of exposure.
    pub stamp: Stamp,
    /// Frame of reference.
    pub frame_id: String,
}

/// `std_msgs/String`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Text {
    /// The text.
    pub data: String,
}

/// `std_srvs/Trigger_Request`: nothing, which takes a byte on the wire.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TriggerRequest {
    structure_needs_at_least_one_member: u8,
}

/// `std_srvs/Trigger_Response`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// There is a grasp.
    pub success: bool,
    /// The result as JSON.
    pub message: String,
}
