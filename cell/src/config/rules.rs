//! Sections of when things take too long, when the run ends, and what is kept.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// `[timeouts]`, seconds for one call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TimeoutConfig {
    /// One frame.
    pub capture_s: f64,
    /// One plan, the client's own retries included.
    pub plan_s: f64,
    /// One motion of the arm.
    pub move_s: f64,
    /// One motion of the fingers.
    pub grip_s: f64,
    /// One question to a device about its state.
    pub state_s: f64,
    /// Stopping, or clearing a fault.
    pub clear_s: f64,
    /// A device must end its calls within their timeouts itself. One that is silent for so many times the timeout is
    /// taken as not answering. More than 1, since devices may count on a clock of their own (a simulation's, say).
    pub patience: f64,
}

impl Default for TimeoutConfig {
    fn default() -> Self {
        Self {
            capture_s: 2.0,
            plan_s: 30.0,
            move_s: 30.0,
            grip_s: 10.0,
            state_s: 2.0,
            clear_s: 5.0,
            patience: 10.0,
        }
    }
}

/// `[recovery]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecoveryConfig {
    /// How often a step is tried again (retry, clear and retry) before the table's last word.
    pub tries: u32,
    /// First wait before trying again, seconds; it doubles.
    pub backoff_s: f64,
    /// Longest wait, seconds.
    pub longest_backoff_s: f64,
    /// Frames in a row in which the planner sees nothing before the tray is called empty, at least 2: only
    /// from the second on the planner is told the true floor in any case.
    pub empty_frames: u32,
    /// Frames in a row for which the planner has no grasp before the run ends with its reasons.
    pub no_grasp_frames: u32,
    /// Failed attempts in a row before the run ends.
    pub failures_in_a_row: u32,
}

impl Default for RecoveryConfig {
    fn default() -> Self {
        Self {
            tries: 4,
            backoff_s: 0.2,
            longest_backoff_s: 5.0,
            empty_frames: 2,
            no_grasp_frames: 12,
            failures_in_a_row: 20,
        }
    }
}

impl RecoveryConfig {
    /// The wait before trying again for the `before`-th time.
    pub fn backoff(&self, before: u32) -> Duration {
        crate::recovery::backoff(before, seconds(self.backoff_s), seconds(self.longest_backoff_s))
    }
}

/// `[run]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunConfig {
    /// Grasp trials at most.
    pub trials: u32,
    /// The run begins no further attempt after this, seconds; what is in the hand is still delivered.
    pub time_limit_s: f64,
    /// Seed of the first plan; each further plan takes the next.
    pub seed: u64,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self { trials: 60, time_limit_s: 3600.0, seed: 0 }
    }
}

/// `[recording]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// Folder for the run; must not exist yet, or be empty. Left out: nothing is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
}

/// A checked number of seconds as a duration.
pub(crate) fn seconds(s: f64) -> Duration {
    Duration::try_from_secs_f64(s).unwrap_or_default()
}
