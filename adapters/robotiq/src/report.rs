//! What people are told about a gripper.

use crate::wire::{Fault, Mode, Motion, Phase};

/// A motor, as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisReport {
    /// Name of the actuator.
    pub actuator: String,
    /// Its position, metres or radians.
    pub position: f64,
    /// Its position, counts.
    pub count: u8,
    /// Its current, milliamperes; 0 where the link does not say.
    pub current_ma: f64,
    /// What it does.
    pub motion: Motion,
}

/// A gripper, as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct GripperReport {
    /// Whether it is ready.
    pub phase: Phase,
    /// Fault, if any.
    pub fault: Option<Fault>,
    /// Mode of a 3-Finger.
    pub mode: Mode,
    /// Opening of a 2F, millimetres.
    pub opening_mm: Option<f64>,
    /// Motors in the order of the actuators.
    pub axes: Vec<AxisReport>,
}

/// One thing that was checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub subject: String,
    /// True when it is as it should be.
    pub ok: bool,
    /// What was found.
    pub found: String,
    /// What to do about it; empty when it is as it should be.
    pub advice: String,
}

impl Finding {
    pub(crate) fn good(subject: impl Into<String>, found: impl Into<String>) -> Self {
        Self { subject: subject.into(), ok: true, found: found.into(), advice: String::new() }
    }

    pub(crate) fn bad(
        subject: impl Into<String>,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self { subject: subject.into(), ok: false, found: found.into(), advice: advice.into() }
    }
}
