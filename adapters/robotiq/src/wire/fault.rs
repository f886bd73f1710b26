//! Faults by name: what the device's manual calls them, who can release them.

use graspd_adapters_core::FaultKind;

use crate::settings::Model;

/// A fault of a gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fault {
    code: u8,
    three: bool,
}

impl Fault {
    /// The fault of a code; `None` for 0.
    pub fn new(code: u8, model: Model) -> Option<Self> {
        (code != 0).then_some(Self { code, three: model == Model::ThreeFinger })
    }

    /// Its code.
    pub fn code(self) -> u8 {
        self.code
    }

    /// What it is.
    pub fn name(self) -> &'static str {
        match (self.code, self.three) {
            (0x05, _) => "action delayed, the activation must be completed first",
            (0x06, true) => "action delayed, the change of mode must be completed first",
            (0x07, _) => "the activation bit must be set before an action",
            (0x08, false) => "over-temperature, let it cool",
            (0x09, false) => "nobody has talked to it for a second",
            (0x09, true) => "the communication chip is not ready",
            (0x0A, false) => "under-voltage",
            (0x0A, true) => "interference of the scissor, for less than 20 s",
            (0x0B, _) => "automatic release in progress",
            (0x0C, false) => "internal fault",
            (0x0D, _) => "activation fault: something was in the way",
            (0x0E, false) => "over-current",
            (0x0E, true) => "interference of the scissor, for more than 20 s",
            (0x0F, _) => "automatic release completed",
            _ => "a fault that its manual does not name",
        }
    }

    /// Who can release it.
    pub fn kind(self) -> FaultKind {
        match (self.code, self.three) {
            (0x08 | 0x0E, false) | (0x0A | 0x0E, true) => FaultKind::Overload,
            (0x0C, _) => FaultKind::Other,
            // All others end with an activation.
            _ => FaultKind::NotActivated,
        }
    }

    /// False for what goes away by itself as the gripper goes on: no motion fails for it.
    pub fn stops(self) -> bool {
        !matches!((self.code, self.three), (0x05 | 0x06, _) | (0x09, false))
    }

    /// True when an automatic release is done.
    pub fn is_released(self) -> bool {
        self.code == 0x0F
    }

    /// True for what only a new activation ends. A 3-Finger whose scissor was in the way, or that releases, is not there
    /// yet.
    pub fn is_major(self) -> bool {
        self.code >= if self.three { 0x0D } else { 0x0A }
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "fault {:#04x}: {}", self.code, self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_have_names_and_say_who_can_release_them() {
        let fault = |code| Fault::new(code, Model::TwoFinger85).unwrap();
        assert_eq!(fault(0x0E).to_string(), "fault 0x0e: over-current");
        assert_eq!(fault(0x0E).kind(), FaultKind::Overload);
        assert_eq!(fault(0x0F).kind(), FaultKind::NotActivated);
        assert!(fault(0x0B).is_major() && fault(0x0B).stops());
        assert!(!fault(0x09).stops() && !fault(0x05).stops() && fault(0x07).stops());
        assert!(Fault::new(0, Model::TwoFinger85).is_none());
        let three = Fault::new(0x0A, Model::ThreeFinger).unwrap();
        assert!(three.name().contains("scissor") && !three.is_major());
        assert!(Fault::new(0x0E, Model::ThreeFinger).unwrap().is_major() && fault(0x0A).is_major());
    }
}
