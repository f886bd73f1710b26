//! What happens at an arm without being asked for.

use crate::rtde::Version;
use crate::state::{RobotMode, SafetyStatus};

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum UrEvent {
    /// The link came up.
    Connected {
        /// The controller's software.
        version: Version,
    },
    /// The link broke; it is set up again by itself.
    Disconnected {
        /// Why.
        why: String,
    },
    /// The safety system changed its state.
    Safety {
        /// From; `None` when it was not known.
        from: Option<SafetyStatus>,
        /// To.
        to: SafetyStatus,
    },
    /// The robot changed its mode.
    RobotMode {
        /// From; `None` when it was not known.
        from: Option<RobotMode>,
        /// To.
        to: RobotMode,
    },
    /// A program started or ended, ours or another.
    Program {
        /// True when it runs now.
        running: bool,
    },
    /// The controller says something over RTDE.
    Text {
        /// What.
        text: String,
    },
}
