//! The steps of clearing a tray, in their order, and what can go wrong in them.

use std::fmt;

use graspd_adapters_core::{DeviceError, FaultKind};
use serde::{Deserialize, Serialize};

/// One step of the loop (Supplementary Note 7, Task 1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// The arm goes out of the camera's view.
    ClearView,
    /// The camera takes a depth frame.
    Capture,
    /// The planner answers with ranked grasps.
    Plan,
    /// The hand opens as the chosen grasp asks.
    Open,
    /// The arm goes above the pre-grasp and down to it.
    Pregrasp,
    /// With a camera in the palm: the hand follows the grasp that every frame refines (Supplementary Note 7, Task 2).
    Follow,
    /// The arm goes straight to the grasp.
    Approach,
    /// All fingers close until they gain stable contact.
    Close,
    /// Does the hand feel the object?
    CheckContact,
    /// The arm lifts straight up.
    Lift,
    /// Does the hand still feel it?
    CheckHeld,
    /// The arm carries it to the drop pose.
    Carry,
    /// Does the hand feel it at the drop pose? This decides success.
    CheckDelivered,
    /// The hand opens.
    Release,
    /// After a failure: stop, clear the fault, open, straight back along the approach, up.
    Retreat,
}

impl Step {
    /// Every step, in order.
    pub const ALL: [Self; 15] = [
        Self::ClearView,
        Self::Capture,
        Self::Plan,
        Self::Open,
        Self::Pregrasp,
        Self::Follow,
        Self::Approach,
        Self::Close,
        Self::CheckContact,
        Self::Lift,
        Self::CheckHeld,
        Self::Carry,
        Self::CheckDelivered,
        Self::Release,
        Self::Retreat,
    ];

    /// The step's name in records and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClearView => "clear_view",
            Self::Capture => "capture",
            Self::Plan => "plan",
            Self::Open => "open",
            Self::Pregrasp => "pregrasp",
            Self::Follow => "follow",
            Self::Approach => "approach",
            Self::Close => "close",
            Self::CheckContact => "check_contact",
            Self::Lift => "lift",
            Self::CheckHeld => "check_held",
            Self::Carry => "carry",
            Self::CheckDelivered => "check_delivered",
            Self::Release => "release",
            Self::Retreat => "retreat",
        }
    }

    /// True from the moment that something may be in the hand until it has opened again.
    pub fn may_hold(self) -> bool {
        matches!(
            self,
            Self::Close
                | Self::CheckContact
                | Self::Lift
                | Self::CheckHeld
                | Self::Carry
                | Self::CheckDelivered
                | Self::Release
                | Self::Retreat
        )
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// What kind of trouble a step met; decides, with the step, what is done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trouble {
    /// No answer in time, no connection, busy, stale: the same call may succeed a moment later.
    NoAnswer,
    /// A protective stop, an overload, a lost activation: software may release it.
    Stop,
    /// The device cannot do what is asked: a pose out of reach, a target beyond a limit.
    OutOfReach,
    /// Software cannot mend it: an unknown fault, a broken protocol, something unsupported.
    Broken,
    /// An emergency stop: a person is needed.
    Emergency,
    /// The planner is not there, or has no room.
    PlannerAway,
    /// The planner is there and failed, or answered too late.
    PlannerFailed,
    /// The planner refuses the request: it would refuse it again.
    PlannerRefused,
    /// The planner has no grasp for what it sees.
    NoGrasp,
    /// What is followed has gone, is hidden, or is not come near to.
    TargetLost,
    /// The hand feels nothing where it should feel an object.
    NothingHeld,
}

impl Trouble {
    /// The trouble's name in records and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoAnswer => "no answer",
            Self::Stop => "stop",
            Self::OutOfReach => "out of reach",
            Self::Broken => "broken",
            Self::Emergency => "emergency stop",
            Self::PlannerAway => "planner away",
            Self::PlannerFailed => "planner failed",
            Self::PlannerRefused => "planner refused",
            Self::NoGrasp => "no grasp",
            Self::TargetLost => "target lost",
            Self::NothingHeld => "nothing held",
        }
    }
}

impl From<&DeviceError> for Trouble {
    fn from(error: &DeviceError) -> Self {
        match error {
            DeviceError::Fault { kind: FaultKind::EmergencyStop, .. } => Self::Emergency,
            e if e.is_clearable() => Self::Stop,
            // Somebody else stopped the motion: the same call may succeed a moment later.
            DeviceError::Stopped { .. } => Self::NoAnswer,
            e if e.is_transient() => Self::NoAnswer,
            DeviceError::OutOfRange { .. } => Self::OutOfReach,
            _ => Self::Broken,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn names_are_those_of_the_records() {
        for step in Step::ALL {
            assert_eq!(serde_json::to_value(step).unwrap(), step.name());
        }
    }

    #[test]
    fn device_errors_are_sorted_by_what_can_be_done() {
        let device = || "arm".to_owned();
        let fault =
            |kind| Trouble::from(&DeviceError::Fault { device: device(), kind, detail: String::new() });
        assert_eq!(fault(FaultKind::ProtectiveStop), Trouble::Stop);
        assert_eq!(fault(FaultKind::EmergencyStop), Trouble::Emergency);
        assert_eq!(fault(FaultKind::Other), Trouble::Broken);
        let late =
            DeviceError::Timeout { device: device(), operation: "state", after: Duration::from_secs(1) };
        assert_eq!(Trouble::from(&late), Trouble::NoAnswer);
    }
}
