//! Power, brakes, unlocking, and giving the arm back: what goes through the dashboard or ends the control script.

use std::time::Duration;

use graspd_adapters_core::{DeviceError, FaultKind};
use tokio::sync::oneshot;
use tokio::time::Instant;

use super::{Call, UrArm};
use crate::dashboard::DashboardError;
use crate::script::{Command, CommandKind};
use crate::session::Order;
use crate::state::RobotMode;

/// An arm that does not stay unlocked for so long stops itself again.
const RELEASED: Duration = Duration::from_secs(2);

impl UrArm {
    /// Switches power on and releases the brakes, and waits until the arm can be moved.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] unless `armed` and `power_up` are set; [`DeviceError::Fault`] with what the
    /// dashboard says; [`DeviceError::Timeout`].
    pub async fn power_up(&self, timeout: Duration) -> Result<(), DeviceError> {
        let call = Call::new("power_up", timeout);
        if !(self.config().armed && self.config().power_up) {
            return Err(self.out_of_range("power_up", false, "`armed` and `power_up` set on purpose"));
        }
        loop {
            let state = self.fresh(call).await?;
            if let Some(kind) = state.safety.fault() {
                return Err(self.fault(kind, format!("safety status {:?}", state.safety)));
            }
            if state.robot_mode == RobotMode::Running {
                return Ok(());
            }
            let asked = async {
                match state.robot_mode {
                    RobotMode::PowerOff => self.dashboard.power_on().await,
                    RobotMode::Idle => self.dashboard.release_brakes().await,
                    _ => Ok(()),
                }
            };
            match tokio::time::timeout_at(call.until, asked).await {
                Ok(asked) => asked.map_err(|e| self.fault(FaultKind::Other, e.to_string()))?,
                Err(_) => return Err(self.timed_out(call)),
            }
            let mode = state.robot_mode;
            let again = call.until.min(Instant::now() + Duration::from_secs(2));
            match self.wait_for(call, again, |s| s.robot_mode != mode).await {
                Err(DeviceError::Timeout { .. }) if Instant::now() >= call.until => {
                    return Err(self.timed_out(call));
                }
                // Asked again.
                Ok(_) | Err(DeviceError::Timeout { .. }) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Ends the control script, if it runs: the arm is left as it stands, with the tool centre point that was set
    /// before. The next motion uploads it again.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`], [`DeviceError::Disconnected`].
    pub async fn release(&self, timeout: Duration) -> Result<(), DeviceError> {
        let call = Call::new("release", timeout);
        let uploaded = tokio::time::timeout_at(call.until, self.uploaded.lock());
        let uploaded = uploaded.await.map_err(|_| self.timed_out(call))?;
        let state = self.fresh(call).await?;
        if !uploaded.runs(&state) {
            return Ok(());
        }
        let (written, heard) = oneshot::channel();
        let number = self.shared.next_number();
        let order = Order::Command { number, command: Command::new(CommandKind::End), written };
        self.orders.send(order).map_err(|_| self.disconnected("the link's task ended"))?;
        match tokio::time::timeout_at(call.until, heard).await {
            Ok(Ok(())) => self.wait_for(call, call.until, |s| !s.program_running).await.map(|_| ()),
            Ok(Err(_)) => Err(self.disconnected("the link broke before the command was sent")),
            Err(_) => Err(self.timed_out(call)),
        }
    }

    async fn unlock(&self, call: Call) -> Result<(), DeviceError> {
        if !(self.config().armed && self.config().unlock_protective_stop) {
            let detail = "protective stop: a person inspects the cause and unlocks it on the pendant (or \
                          unlock_protective_stop is set, on an arm that is armed, to let software do it)";
            return Err(self.fault(FaultKind::Other, detail));
        }
        let mut why: Option<String> = None;
        loop {
            let asked = async {
                self.dashboard.close_safety_popup().await?;
                self.dashboard.unlock_protective_stop().await
            };
            // What is told at the end of the time says why, while there is a why.
            let late = || match &why {
                Some(why) => {
                    self.fault(FaultKind::ProtectiveStop, format!("{why}, within {:?}", call.timeout))
                }
                None => self.timed_out(call),
            };
            match tokio::time::timeout_at(call.until, asked).await {
                Err(_) => return Err(late()),
                Ok(Err(DashboardError::TooEarly(too_early))) => {
                    tracing::info!(too_early, "waiting to unlock");
                    let wait = Instant::now() + Duration::from_millis(250);
                    if wait >= call.until {
                        return Err(late());
                    }
                    tokio::time::sleep_until(wait).await;
                }
                Ok(Err(error)) => return Err(self.fault(FaultKind::ProtectiveStop, error.to_string())),
                Ok(Ok(())) => {
                    let soon = call.until.min(Instant::now() + RELEASED);
                    match self.wait_for(call, soon, |s| s.safety.allows_motion()).await {
                        Ok(_) => return Ok(()),
                        Err(DeviceError::Timeout { .. }) if Instant::now() >= call.until => {
                            return Err(late());
                        }
                        Err(DeviceError::Timeout { .. }) => {
                            let words =
                                self.shared.words().back().map_or(String::new(), |w| format!(" ({w})"));
                            why = Some(format!(
                                "it stops itself again whenever it is unlocked{words}: something presses on it"
                            ));
                        }
                        Err(error) => return Err(error),
                    }
                }
            }
        }
    }

    /// Releases what software may release.
    pub(super) async fn recover(&self, call: Call) -> Result<(), DeviceError> {
        let state = self.fresh(call).await?;
        match state.safety.fault() {
            Some(FaultKind::ProtectiveStop) => self.unlock(call).await?,
            Some(FaultKind::EmergencyStop) => {
                let detail = "emergency stop: a person releases the button and switches power on".to_string();
                return Err(self.fault(FaultKind::EmergencyStop, detail));
            }
            Some(kind) => {
                let detail = format!("safety status {:?}: a person clears it on the pendant", state.safety);
                return Err(self.fault(kind, detail));
            }
            None => {}
        }
        let state = self.fresh(call).await?;
        if state.robot_mode == RobotMode::Running {
            return Ok(());
        }
        if self.config().armed && self.config().power_up {
            return self.power_up(call.until.saturating_duration_since(Instant::now())).await;
        }
        let detail = format!(
            "robot mode: found {:?}, expected Running; a person switches power on and releases the brakes (or \
             power_up is set to let software do it)",
            state.robot_mode
        );
        Err(self.fault(FaultKind::Other, detail))
    }
}
