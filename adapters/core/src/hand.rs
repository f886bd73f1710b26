//! Robotic hands.

use std::time::Duration;

use async_trait::async_trait;

use crate::DeviceError;
use crate::closing::close_in_grips;

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

/// Closing the fingers on an object. All lists are in the order of [`HandInfo::actuators`], radians or metres.
#[derive(Debug, Clone, PartialEq)]
pub struct CloseCommand {
    /// Where each actuator is expected to meet the object.
    pub contact: Vec<f64>,
    /// Where each is told to go then: a servo presses with what it lacks of this way.
    pub squeezed: Vec<f64>,
    /// Where an actuator goes at most that nothing holds: the end of its range in the direction of closing; where it
    /// is told to go anyway for one that does not close.
    pub farthest: Vec<f64>,
    /// Time in which all fingers go from where they are to `contact`, to arrive there together. A hand whose fastest
    /// is slower takes longer, together as well.
    pub meet: Duration,
    /// Share of the speed after that, 0 to 1.
    pub speed: f64,
    /// Share of the force, 0 to 1, all the time.
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

    /// Closes the fingers on an object, as the paper's Task 1 does (Supplementary Note 7): all fingers at the same time,
    /// until they hold.
    ///
    /// An implementor brings all actuators from where they are to [`CloseCommand::contact`] in step with each other,
    /// each at the same share of its way at any moment: a finger that comes first pushes the object away before the
    /// others hold against it. One that is beyond contact already stays there meanwhile. Then it goes to [`CloseCommand::squeezed`], and fingers that nothing holds yet go on in
    /// the same direction, all joints of a finger in proportion, up to [`CloseCommand::farthest`]. It ends when every
    /// finger is held or at its end, with the state reached; the force stays on until the next command. What was met
    /// earlier than expected is no error, nor is meeting nothing: [`HandState::feels_object`] tells.
    ///
    /// A hand whose controller takes trajectories, or targets many times a second, should do this itself. One that
    /// only goes to a position and reports back leaves this method as it is: it grips in a few steps on the way to
    /// contact, all actuators by the same share, and squeeze by squeeze after that.
    ///
    /// # Errors
    /// As [`Hand::grip`]; [`DeviceError::OutOfRange`] also for lists of the wrong length.
    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        close_in_grips(self, command, timeout).await
    }

    /// Makes the hand ready after power-up or a fault (activation, homing). Does nothing to a ready hand.
    ///
    /// # Errors
    /// [`DeviceError::Fault`] when a person is needed.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError>;
}
