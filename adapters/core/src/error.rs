//! The one error of all devices.

use std::time::Duration;

/// What stopped a device, where it stopped itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FaultKind {
    /// A protective stop: released by [`crate::Arm::clear_fault`], from where the arm stands.
    ProtectiveStop,
    /// An emergency stop: a person must release it.
    EmergencyStop,
    /// A joint or motor reports over-current, over-temperature or overload.
    Overload,
    /// The device needs its activation or calibration again.
    NotActivated,
    /// Anything else; the detail says what.
    Other,
}

/// Why a device did not do what it was asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// No answer in time. The device may or may not have done it.
    #[error("{device}: {operation} did not end within {after:?}")]
    Timeout {
        /// Name of the device.
        device: String,
        /// What was asked, for example `capture`.
        operation: &'static str,
        /// The time that was allowed.
        after: Duration,
    },
    /// Nobody listens, or the link broke. Calls made later try to connect again.
    #[error("{device}: not connected: {detail}")]
    Disconnected {
        /// Name of the device.
        device: String,
        /// What the link said.
        detail: String,
    },
    /// The device is doing something else.
    #[error("{device}: busy with {with}")]
    Busy {
        /// Name of the device.
        device: String,
        /// What it is doing.
        with: String,
    },
    /// The device stopped itself; see the kind for who can release it.
    #[error("{device}: {kind:?}: {detail}")]
    Fault {
        /// Name of the device.
        device: String,
        /// What kind of stop.
        kind: FaultKind,
        /// The device's own words or code.
        detail: String,
    },
    /// A frame or state is older than the caller allows.
    #[error("{device}: newest data is {age:?} old, expected at most {limit:?}")]
    Stale {
        /// Name of the device.
        device: String,
        /// Found age.
        age: Duration,
        /// Allowed age.
        limit: Duration,
    },
    /// The motion was stopped, by [`crate::Arm::stop`] or a newer motion, before its end.
    #[error("{device}: {operation} was stopped before its end")]
    Stopped {
        /// Name of the device.
        device: String,
        /// What was stopped.
        operation: &'static str,
    },
    /// What was asked is outside what the device can do.
    #[error("{device}: {field}: found {found}, expected {expected}")]
    OutOfRange {
        /// Name of the device.
        device: String,
        /// The offending value's name.
        field: String,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// The device cannot do this at all.
    #[error("{device}: {operation} is not supported")]
    Unsupported {
        /// Name of the device.
        device: String,
        /// What was asked.
        operation: &'static str,
    },
    /// The device answered something that its protocol does not allow.
    #[error("{device}: {detail}")]
    Protocol {
        /// Name of the device.
        device: String,
        /// Register or field, what was found, what was expected.
        detail: String,
    },
}

impl DeviceError {
    /// True when the same call may succeed a moment later without anybody doing anything.
    pub fn is_transient(&self) -> bool {
        matches!(
            self,
            Self::Timeout { .. } | Self::Disconnected { .. } | Self::Busy { .. } | Self::Stale { .. }
        )
    }

    /// True when `clear_fault` may release the device.
    pub fn is_clearable(&self) -> bool {
        matches!(
            self,
            Self::Fault {
                kind: FaultKind::ProtectiveStop | FaultKind::Overload | FaultKind::NotActivated,
                ..
            }
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_what_can_be_done_about_them() {
        let device = || "arm".to_owned();
        let timeout =
            DeviceError::Timeout { device: device(), operation: "capture", after: Duration::from_secs(1) };
        assert!(timeout.is_transient() && !timeout.is_clearable());
        let stop =
            DeviceError::Fault { device: device(), kind: FaultKind::ProtectiveStop, detail: "C153A0".into() };
        assert!(stop.is_clearable() && !stop.is_transient());
        let person =
            DeviceError::Fault { device: device(), kind: FaultKind::EmergencyStop, detail: String::new() };
        assert!(!person.is_clearable());
        assert_eq!(timeout.to_string(), "arm: capture did not end within 1s");
    }
}
