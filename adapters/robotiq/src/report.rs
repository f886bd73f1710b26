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
