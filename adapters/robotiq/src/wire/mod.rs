//! Requests and status as bytes. Registers hold two bytes each, the first in the high half.
//!
//! Both families of grippers are seen alike: axes (one motor of a 2F; fingers A, B, C and scissor of a 3-Finger), each
//! with a request and a status.

mod fault;
mod three_finger;
mod two_finger;

pub use fault::Fault;

use crate::settings::Model;

/// What one motor is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AxisRequest {
    /// Where to go: 0 open to 255 closed.
    pub position: u8,
    /// 0 slowest to 255 fastest.
    pub speed: u8,
    /// 0 weakest to 255 strongest.
    pub force: u8,
}

/// How the fingers of a 3-Finger stand to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Fingers B and C half apart.
    #[default]
    Basic,
    /// Fingers B and C together.
    Pinch,
    /// Fingers B and C far apart.
    Wide,
    /// Fingers B and C grip sideways against each other.
    Scissor,
}

impl Mode {
    fn bits(self) -> u8 {
        match self {
            Self::Basic => 0,
            Self::Pinch => 1,
            Self::Wide => 2,
            Self::Scissor => 3,
        }
    }

    fn from_bits(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Basic,
            1 => Self::Pinch,
            2 => Self::Wide,
            _ => Self::Scissor,
        }
    }
}

/// What a gripper is asked.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Request {
    /// Be activated. Falls and rises again to activate anew.
    pub activate: bool,
    /// Go to the requested positions; false stops.
    pub go: bool,
    /// Automatic release, for emergencies: true opens, false closes.
    pub release: Option<bool>,
    /// Mode of a 3-Finger, where it is not individual.
    pub mode: Mode,
    /// Each finger and the scissor of a 3-Finger alone; else fingers move as one, by the mode.
    pub individual: bool,
    /// One for each motor.
    pub axes: Vec<AxisRequest>,
}

/// What one motor does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// On its way.
    Moving,
    /// Stopped by something while it opened.
    HeldOpening,
    /// Stopped by something while it closed.
    HeldClosing,
    /// At its request; nothing was met, or it was lost.
    Reached,
}

impl Motion {
    fn from_bits(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Moving,
            1 => Self::HeldOpening,
            2 => Self::HeldClosing,
            _ => Self::Reached,
        }
    }

    /// True when something stopped it.
    pub fn is_held(self) -> bool {
        matches!(self, Self::HeldOpening | Self::HeldClosing)
    }
}

/// How one motor is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisStatus {
    /// Request that it has taken. Until this is what was asked, `motion` is about the request before.
    pub requested: u8,
    /// Where it is, counts.
    pub position: u8,
    /// Its current, counts.
    pub current: u8,
    /// What it does; says nothing while the gripper does not go.
    pub motion: Motion,
}

/// Where a gripper is on its way to being ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Not activated, or released.
    Reset,
    /// Opens and closes to know its range.
    Activating,
    /// A 3-Finger turns its fingers to another mode.
    ChangingMode,
    /// Ready.
    Ready,
}

/// How a gripper is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// The activation bit, as taken.
    pub activated: bool,
    /// It goes to what was requested.
    pub goes: bool,
    /// Whether it is ready.
    pub phase: Phase,
    /// Mode of a 3-Finger, as taken.
    pub mode: Mode,
    /// Fault, if any.
    pub fault: Option<Fault>,
    /// Fault of the controller that a 2F hangs on, by its number there; 0: none, or no such controller.
    pub controller_fault: u8,
    /// One for each motor.
    pub axes: Vec<AxisStatus>,
}

/// Status bytes that are not as the gripper's registers are.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct StatusError {
    /// Which bytes.
    pub field: &'static str,
    /// Found.
    pub found: String,
    /// Expected.
    pub expected: String,
}

impl Model {
    /// Motors.
    pub fn axes(self) -> usize {
        if self == Self::ThreeFinger { 4 } else { 1 }
    }

    /// Bytes of its request and of its status, an even number.
    pub fn bytes(self) -> usize {
        if self == Self::ThreeFinger { 16 } else { 6 }
    }

    /// A request as bytes; motors without a request get zeros.
    pub fn encode(self, request: &Request) -> Vec<u8> {
        if self == Self::ThreeFinger { three_finger::encode(request) } else { two_finger::encode(request) }
    }

    /// Bytes as a status.
    ///
    /// # Errors
    /// [`StatusError`] for a wrong number of bytes or a state that no gripper is in.
    pub fn decode(self, bytes: &[u8]) -> Result<Status, StatusError> {
        if self == Self::ThreeFinger { three_finger::decode(bytes) } else { two_finger::decode(bytes) }
    }
}

fn length(found: usize, expected: usize) -> StatusError {
    StatusError { field: "status bytes", found: found.to_string(), expected: expected.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_status_panics(bytes in proptest::collection::vec(any::<u8>(), 0..20)) {
            for model in [Model::TwoFinger85, Model::TwoFinger140, Model::ThreeFinger] {
                if let Ok(status) = model.decode(&bytes) {
                    prop_assert_eq!(status.axes.len(), model.axes());
                    prop_assert_eq!(bytes.len(), model.bytes());
                }
            }
        }
    }
}
