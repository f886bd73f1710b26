//! The gripper as its callers see it.

use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, Hand, HandInfo, HandState};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout_at;

use crate::calibration::{Actuators, Calibration};
use crate::driver::{Driver, Order, Patience, Reply, Together};
use crate::report::{Finding, GripperReport};
use crate::settings::{RobotiqSettings, SettingsError};
use crate::wire::Mode;

/// A planner's answer may lie on a limit, give or take a rounding.
const ROUNDING: f64 = 1e-6;
/// Orders that wait for the task at most.
const ORDERS: usize = 32;

/// A Robotiq gripper. Its task ends, and a motion that runs stops, when this is dropped; a grip is kept.
///
/// A second motion while one runs is refused as busy. Nothing moves before motion is armed; a gripper that is not
/// activated says so ([`graspd_adapters_core::FaultKind::NotActivated`]) until [`Hand::clear_fault`] has activated it,
/// which opens and closes its fingers once.
#[derive(Debug)]
pub struct RobotiqHand {
    info: HandInfo,
    /// Least and largest value of each actuator.
    limits: Vec<(f64, f64)>,
    orders: mpsc::Sender<Order>,
    /// Opening of a 2F that is wide open.
    open_mm: f64,
    /// True when its settings allow less than the whole stroke.
    narrowed: bool,
}

impl RobotiqHand {
    /// A gripper on its link. The link is opened by the first call that needs it. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// [`SettingsError`] with the first setting that is wrong.
    pub fn new(settings: RobotiqSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let actuators = Actuators::new(settings.model, settings.calibration(), settings.openings());
        let info = HandInfo {
            name: settings.name.clone(),
            hand_id: settings.hand_id(),
            actuators: actuators.list.iter().map(|(name, ..)| (*name).to_owned()).collect(),
            feels_contact: true,
        };
        let limits = actuators.list.iter().map(|(_, least, most)| (*least, *most)).collect();
        let (orders, received) = mpsc::channel(ORDERS);
        let open_mm = settings.calibration().open_mm;
        let narrowed = settings.openings() != [0.0, open_mm];
        tokio::spawn(Driver::new(settings, actuators).run(received));
        Ok(Self { info, limits, orders, open_mm, narrowed })
    }

    /// Allows motion, or forbids it: then fingers stop; they keep their grip.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn arm(&self, armed: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("arm", timeout, |reply| Order::Arm(armed, reply)).await
    }

    /// Stops the fingers where they are. A motion that runs ends with [`DeviceError::Stopped`].
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("stop", timeout, Order::Stop).await
    }

    /// Moves all fingers of a 3-Finger as one, in one of its modes; changes the mode first, which takes seconds. In mode
    /// [`Mode::Scissor`] it is the scissor that moves. `closed` is a share of the way, 0 open to 1 closed; ends as
    /// [`Hand::grip`] does. `Hand::grip` and `Hand::close` move each finger alone, whatever the mode.
    ///
    /// # Errors
    /// [`DeviceError::Unsupported`] for a 2F, [`DeviceError::OutOfRange`]; else as [`Hand::grip`].
    pub async fn grip_in_mode(
        &self,
        mode: Mode,
        closed: f64,
        speed: f64,
        force: f64,
        timeout: Duration,
    ) -> Result<HandState, DeviceError> {
        if self.limits.len() == 1 {
            return Err(DeviceError::Unsupported {
                device: self.info.name.clone(),
                operation: "grip_in_mode",
            });
        }
        for (field, share) in [("closed", closed), ("speed", speed), ("force", force)] {
            self.check_share(field, share)?;
        }
        let together = Together { mode, closed, speed, force };
        self.ask("grip_in_mode", timeout, |reply| Order::Together(together, Patience::of(timeout), reply))
            .await
    }

    /// Opens and closes a 2F with nothing between its fingers, gently, and says at which counts it was open and closed:
    /// for `calibration` of its settings.
    ///
    /// # Errors
    /// [`DeviceError::Unsupported`] for a 3-Finger, or where its settings allow less than the whole stroke;
    /// [`DeviceError::Protocol`] when it met something; else as [`Hand::grip`].
    pub async fn calibrate(&self, timeout: Duration) -> Result<Calibration, DeviceError> {
        let device = || self.info.name.clone();
        if self.limits.len() != 1 || self.narrowed {
            return Err(DeviceError::Unsupported { device: device(), operation: "calibrate" });
        }
        let patience = Patience::of(timeout);
        let mut counts = [0; 2];
        for (count, end) in counts.iter_mut().zip([0, 255]) {
            let left = patience.until.saturating_duration_since(tokio::time::Instant::now());
            let state = self.ask("calibrate", left, |reply| Order::Count(end, patience, reply)).await?;
            if state.feels_object() {
                let detail = format!("calibration: something held the fingers on their way to count {end}");
                return Err(DeviceError::Protocol { device: device(), detail });
            }
            let left = patience.until.saturating_duration_since(tokio::time::Instant::now());
            let report = self.report(left).await?;
            *count = report.axes.first().map_or(0, |axis| axis.count);
        }
        let [open, closed] = counts.map(f64::from);
        Ok(Calibration { open_count: open, closed_count: closed, open_mm: self.open_mm })
    }

    /// Lets go in an emergency: fingers open (or close) slowly and at once, whatever else was asked. The gripper must be
    /// activated anew afterwards.
    ///
    /// # Errors
    /// As [`Hand::clear_fault`].
    pub async fn release(&self, opens: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("release", timeout, |reply| Order::Release(opens, Patience::of(timeout), reply)).await
    }

    /// Phase, fault, and of each motor position, count, current and what it does.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`], [`DeviceError::Protocol`].
    pub async fn report(&self, timeout: Duration) -> Result<GripperReport, DeviceError> {
        self.ask("report", timeout, Order::Report).await
    }

    /// What is wrong with the gripper and what to do about it. Nothing moves.
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
        let ended = |()| DeviceError::Disconnected { device: device(), detail: "its task has ended".into() };
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
        for ((value, (least, most)), name) in values.iter().zip(&self.limits).zip(&self.info.actuators) {
            if !(*value >= least - ROUNDING && *value <= most + ROUNDING) {
                return refuse(format!("{field}.{name}"), value.to_string(), format!("{least} to {most}"));
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
impl Hand for RobotiqHand {
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

    /// The gripper itself stops at what it meets, with its force: the fingers go to where contact is expected at such
    /// speeds that they arrive together, then on to `farthest` until they are held.
    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        command.check(&self.info)?;
        self.check_list("contact", &command.contact)?;
        self.check_list("squeezed", &command.squeezed)?;
        self.check_list("farthest", &command.farthest)?;
        self.ask("close", timeout, |reply| Order::Close(command.clone(), Patience::of(timeout), reply)).await
    }

    /// Activates the gripper, where it is not ready: its fingers open and close once. Needs motion to be armed.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.ask("clear_fault", timeout, |reply| Order::Clear(Patience::of(timeout), reply)).await
    }
}
