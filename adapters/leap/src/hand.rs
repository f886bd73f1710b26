//! The hand as its callers see it.

use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, Hand, HandInfo, HandState};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout_at;

use crate::driver::{Driver, Order, Patience, Reply};
use crate::report::{Finding, JointReport};
use crate::settings::{LeapSettings, SettingsError};

/// A planner's answer may lie on a limit, give or take a rounding.
const ROUNDING: f64 = 1e-6;
/// Orders that wait for the task at most.
const ORDERS: usize = 32;

/// A LEAP Hand, or another hand of Dynamixel motors. Its task ends, and the fingers stop, when this is dropped.
///
/// A second motion while one runs is refused as busy. Nothing moves, and no motor holds, before motion is armed.
#[derive(Debug)]
pub struct LeapHand {
    info: HandInfo,
    /// Lower and upper limit of each actuator.
    limits: Vec<(f64, f64)>,
    orders: mpsc::Sender<Order>,
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
        let (orders, received) = mpsc::channel(ORDERS);
        tokio::spawn(Driver::new(settings).run(received));
        Ok(Self { info, limits, orders })
    }

    /// Allows motion, or forbids it: then fingers stop and lose their torque.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn arm(&self, armed: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("arm", timeout, |reply| Order::Arm(armed, reply)).await
    }

    /// Stops the fingers where they are; they hold there. A motion that runs ends with [`DeviceError::Stopped`].
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("stop", timeout, Order::Stop).await
    }

    /// Every joint with its motor's position, current, temperature, voltage and errors.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn joints(&self, timeout: Duration) -> Result<Vec<JointReport>, DeviceError> {
        self.ask("joints", timeout, Order::Joints).await
    }

    /// What is wrong with the hand and what to do about it. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`]; what is found is no error.
    pub async fn check(&self, timeout: Duration) -> Result<Vec<Finding>, DeviceError> {
        let (reply, answer) = oneshot::channel();
        self.bounded("check", timeout, Order::Check(reply), answer).await
    }

    async fn ask<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        order: impl FnOnce(Reply<T>) -> Order,
    ) -> Result<T, DeviceError> {
        let (reply, answer) = oneshot::channel();
        self.bounded(operation, timeout, order(reply), answer).await?
    }

    /// Gives an order and waits for its answer, no longer than `timeout`.
    async fn bounded<T>(
        &self,
        operation: &'static str,
        timeout: Duration,
        order: Order,
        answer: oneshot::Receiver<T>,
    ) -> Result<T, DeviceError> {
        let device = || self.info.name.clone();
        let ended = |_| DeviceError::Disconnected { device: device(), detail: "its task has ended".into() };
        let exchange = async {
            self.orders.send(order).await.map_err(|_| ended(()))?;
            answer.await.map_err(|_| ended(()))
        };
        match timeout_at(tokio::time::Instant::now() + timeout, exchange).await {
            Ok(answer) => answer,
            Err(_) => Err(DeviceError::Timeout { device: device(), operation, after: timeout }),
        }
    }

    fn check_list(&self, field: &str, values: &[f64]) -> Result<(), DeviceError> {
        let refuse = |field: String, found: String, expected: String| {
            let device = self.info.name.clone();
            Err(DeviceError::OutOfRange { device, field, found, expected })
        };
        if values.len() != self.limits.len() {
            let (found, expected) = (format!("{} values", values.len()), self.limits.len().to_string());
            return refuse(field.to_owned(), found, expected);
        }
        for ((value, (lower, upper)), name) in values.iter().zip(&self.limits).zip(&self.info.actuators) {
            if !(*value >= lower - ROUNDING && *value <= upper + ROUNDING) {
                return refuse(format!("{field}.{name}"), value.to_string(), format!("{lower} to {upper}"));
            }
        }
        Ok(())
    }

    fn check_share(&self, field: &str, share: f64) -> Result<(), DeviceError> {
        if (0.0..=1.0).contains(&share) {
            return Ok(());
        }
        let (device, field) = (self.info.name.clone(), field.to_owned());
        let (found, expected) = (share.to_string(), "a share from 0 to 1".to_owned());
        Err(DeviceError::OutOfRange { device, field, found, expected })
    }
}

#[async_trait]
impl Hand for LeapHand {
    fn info(&self) -> HandInfo {
        self.info.clone()
    }

    async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError> {
        self.ask("state", timeout, Order::State).await
    }

    async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.check_list("actuators", &command.actuators)?;
        self.check_share("speed", command.speed)?;
        self.check_share("force", command.force)?;
        self.ask("grip", timeout, |reply| Order::Grip(command.clone(), Patience::of(timeout), reply)).await
    }

    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        command.check(&self.info)?;
        self.check_list("contact", &command.contact)?;
        self.check_list("squeezed", &command.squeezed)?;
        self.check_list("farthest", &command.farthest)?;
        self.ask("close", timeout, |reply| Order::Close(command.clone(), Patience::of(timeout), reply)).await
    }

    /// Reboots motors with hardware errors and, where motion is armed, makes all hold where they are.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("clear_fault", timeout, Order::Clear).await
    }
}
