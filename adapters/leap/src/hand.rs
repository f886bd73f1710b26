//! The hand as its callers see it.

use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::{Finding, SettingsError};
use graspd_adapters_core::task::HandOrders;
use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, Hand, HandInfo, HandState};

use crate::driver::{Driver, Joints};
use crate::report::JointReport;
use crate::settings::LeapSettings;

/// A motion ends so much before its caller's time is up, so that the answer comes in time.
const AHEAD: Duration = Duration::from_millis(25);

/// A LEAP Hand, or another hand of Dynamixel motors. Its task ends, and the fingers stop, when this is dropped.
///
/// A second motion while one runs is refused as busy. Nothing moves, and no motor holds, before motion is armed.
#[derive(Debug)]
pub struct LeapHand {
    orders: HandOrders<Joints>,
}

impl LeapHand {
    /// A hand on its serial port. The port is opened by the first call that needs it. Must be called within a tokio
    /// runtime.
    ///
    /// # Errors
    /// [`SettingsError`] with the first setting that is wrong.
    pub fn new(settings: LeapSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let info = HandInfo {
            name: settings.name.clone(),
            hand_id: settings.hand_id.clone(),
            actuators: settings.joints.iter().map(|j| j.actuator.clone()).collect(),
            feels_contact: true,
        };
        let limits = settings.joints.iter().map(|j| (j.lower_rad, j.upper_rad)).collect();
        let (orders, received) = HandOrders::new(info, limits, AHEAD);
        tokio::spawn(Driver::new(settings).run(received));
        Ok(Self { orders })
    }

    /// Allows motion, or forbids it: then fingers stop and lose their torque.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn arm(&self, armed: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.arm(armed, timeout).await
    }

    /// Stops the fingers where they are; they hold there. A motion that runs ends with [`DeviceError::Stopped`].
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.stop(timeout).await
    }

    /// Every joint with its motor's position, current, temperature, voltage and errors.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn joints(&self, timeout: Duration) -> Result<Vec<JointReport>, DeviceError> {
        self.orders.own("joints", timeout, Joints).await
    }

    /// What is wrong with the hand and what to do about it. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`]; what is found is no error.
    pub async fn check(&self, timeout: Duration) -> Result<Vec<Finding>, DeviceError> {
        self.orders.check(timeout).await
    }
}

#[async_trait]
impl Hand for LeapHand {
    fn info(&self) -> HandInfo {
        self.orders.info().clone()
    }

    async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.state(timeout).await
    }

    async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.grip(command, timeout).await
    }

    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.close(command, timeout).await
    }

    /// Reboots motors with hardware errors and, where motion is armed, makes all hold where they are.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.clear_fault(timeout).await
    }
}
