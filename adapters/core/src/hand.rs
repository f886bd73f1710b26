//! Robotic hands.

use std::time::Duration;

use async_trait::async_trait;

use crate::DeviceError;

/// What a hand is.
#[derive(Debug, Clone, PartialEq)]
pub struct HandInfo {
    /// Name for logs and errors.
    pub name: String,
    /// Resource id of its description in the planner, for example `leap`.
    pub hand_id: String,
    /// Names of its actuators, in the order of every actuator vector: that of the hand's description.
    pub actuators: Vec<String>,
    /// True when it feels contact (a motor that is held before its target).
    pub feels_contact: bool,
}

/// A motion of the fingers.
#[derive(Debug, Clone, PartialEq)]
pub struct GripCommand {
    /// Target of each actuator, in the order of [`HandInfo::actuators`], radians or metres.
    pub actuators: Vec<f64>,
    /// Share of the speed, 0 to 1.
    pub speed: f64,
    /// Share of the force, 0 to 1.
    pub force: f64,
}

/// What a hand reports.
#[derive(Debug, Clone, PartialEq)]
pub struct HandState {
    /// Positions of the actuators, as measured.
    pub actuators: Vec<f64>,
    /// Actuators that something holds before their target; empty where the hand does not feel contact.
    pub held: Vec<bool>,
    /// True when no actuator moves.
    pub settled: bool,
}

impl HandState {
    /// True when the hand feels an object: some actuator is held before its target.
    pub fn feels_object(&self) -> bool {
        self.held.contains(&true)
    }
}

/// A robotic hand.
#[async_trait]
pub trait Hand: Send + Sync + std::fmt::Debug {
    /// What it is. Known without asking the device again.
    fn info(&self) -> HandInfo;

    /// What it reports now.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`], [`DeviceError::Disconnected`].
    async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError>;

    /// Moves the fingers, all at once. Ends when every actuator is at its target or held by something, with the
    /// state reached; the force stays on until the next command.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] for a wrong number of actuators or a target outside its limits, before anything
    /// moves; [`DeviceError::Fault`], [`DeviceError::Timeout`], [`DeviceError::Disconnected`].
    async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError>;

    /// Makes the hand ready after power-up or a fault (activation, homing). Does nothing to a ready hand.
    ///
    /// # Errors
    /// [`DeviceError::Fault`] when a person is needed.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError>;
}
