//! The gripper as its callers see it.

use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::{Finding, SettingsError};
use graspd_adapters_core::task::HandOrders;
use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, Hand, HandInfo, HandState};

use crate::calibration::{Actuators, Calibration};
use crate::driver::{Driver, Own, Together};
use crate::report::GripperReport;
use crate::settings::RobotiqSettings;
use crate::wire::Mode;

/// A motion ends so much before its caller's time is up, so that the answer comes in time.
const AHEAD: Duration = Duration::from_millis(50);

/// A Robotiq gripper. Its task ends, and a motion that runs stops, when this is dropped; a grip is kept.
///
/// A second motion while one runs is refused as busy. Nothing moves before motion is armed; a gripper that is not
/// activated says so ([`graspd_adapters_core::FaultKind::NotActivated`]) until [`Hand::clear_fault`] has activated it,
/// which opens and closes its fingers once.
#[derive(Debug)]
pub struct RobotiqHand {
    orders: HandOrders<Own>,
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
        let (orders, received) = HandOrders::new(info, limits, AHEAD);
        let open_mm = settings.calibration().open_mm;
        let narrowed = settings.openings() != [0.0, open_mm];
        tokio::spawn(Driver::new(settings, actuators).run(received));
        Ok(Self { orders, open_mm, narrowed })
    }

    /// Allows motion, or forbids it: then fingers stop; they keep their grip.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn arm(&self, armed: bool, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.arm(armed, timeout).await
    }

    /// Stops the fingers where they are. A motion that runs ends with [`DeviceError::Stopped`].
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`].
    pub async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.stop(timeout).await
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
        if self.orders.info().actuators.len() == 1 {
            return Err(DeviceError::Unsupported {
                device: self.orders.info().name.clone(),
                operation: "grip_in_mode",
            });
        }
        for (field, share) in [("closed", closed), ("speed", speed), ("force", force)] {
            self.orders.check_share(field, share)?;
        }
        let together = Together { mode, closed, speed, force };
        let patience = self.orders.patience(timeout);
        self.orders.own("grip_in_mode", timeout, |reply| Own::Together(together, patience, reply)).await
    }

    /// Opens and closes a 2F with nothing between its fingers, gently, and says at which counts it was open and closed:
    /// for `calibration` of its settings.
    ///
    /// # Errors
    /// [`DeviceError::Unsupported`] for a 3-Finger, or where its settings allow less than the whole stroke;
    /// [`DeviceError::Protocol`] when it met something; else as [`Hand::grip`].
    pub async fn calibrate(&self, timeout: Duration) -> Result<Calibration, DeviceError> {
        let device = || self.orders.info().name.clone();
        if self.orders.info().actuators.len() != 1 || self.narrowed {
            return Err(DeviceError::Unsupported { device: device(), operation: "calibrate" });
        }
        let patience = self.orders.patience(timeout);
        let mut counts = [0; 2];
        for (count, end) in counts.iter_mut().zip([0, 255]) {
            let left = patience.left();
            let state = self.orders.own("calibrate", left, |reply| Own::Count(end, patience, reply)).await?;
            if state.feels_object() {
                let detail = format!("calibration: something held the fingers on their way to count {end}");
                return Err(DeviceError::Protocol { device: device(), detail });
            }
            let report = self.report(patience.left()).await?;
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
        let patience = self.orders.patience(timeout);
        self.orders.own("release", timeout, |reply| Own::Release(opens, patience, reply)).await
    }

    /// Phase, fault, and of each motor position, count, current and what it does.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`], [`DeviceError::Timeout`], [`DeviceError::Protocol`].
    pub async fn report(&self, timeout: Duration) -> Result<GripperReport, DeviceError> {
        self.orders.own("report", timeout, Own::Report).await
    }

    /// What is wrong with the gripper and what to do about it. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`]; what is found is no error.
    pub async fn check(&self, timeout: Duration) -> Result<Vec<Finding>, DeviceError> {
        self.orders.check(timeout).await
    }
}

#[async_trait]
impl Hand for RobotiqHand {
    fn info(&self) -> HandInfo {
        self.orders.info().clone()
    }

    async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.state(timeout).await
    }

    async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.grip(command, timeout).await
    }

    /// The gripper itself stops at what it meets, with its force: the fingers go to where contact is expected at such
    /// speeds that they arrive together, then on to `farthest` until they are held.
    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        self.orders.close(command, timeout).await
    }

    /// Activates the gripper, where it is not ready: its fingers open and close once. Needs motion to be armed.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.orders.clear_fault(timeout).await
    }
}
