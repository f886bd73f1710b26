//! The arm: what a cell asks of it, bounded, and stopped when nobody waits any more.

mod motion;
mod reach;
mod recover;

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::check::SettingsError;
use graspd_adapters_core::follow::Goals;
use graspd_adapters_core::{
    Arm, ArmInfo, ArmMode, ArmState, DeviceError, FaultKind, Leg, Limits, Reach, Reached, async_trait,
};
use nalgebra::Isometry3;
use tokio::sync::{Mutex, broadcast, mpsc, oneshot};
use tokio::task::AbortHandle;
use tokio::time::Instant;

use crate::config::UrConfig;
use crate::dashboard::Dashboard;
use crate::events::UrEvent;
use crate::kinematics::Kinematics;
use crate::plan::Refusal;
use crate::session::{Order, Shared, Status, run};
use crate::state::{RobotMode, RobotState};
use crate::upload::Uploaded;

pub(crate) use self::motion::StopOnDrop;

/// An arm by Universal Robots. Its link is looked after by a task, which ends when this is dropped.
#[derive(Debug)]
pub struct UrArm {
    pub(crate) shared: Arc<Shared>,
    pub(crate) orders: mpsc::UnboundedSender<Order>,
    pub(crate) kinematics: Kinematics,
    pub(crate) world_from_base: Isometry3<f64>,
    pub(crate) flange_from_hand: Isometry3<f64>,
    dashboard: Dashboard,
    uploaded: Mutex<Uploaded>,
    task: AbortHandle,
}

impl Drop for UrArm {
    fn drop(&mut self) {
        // The heartbeat ends with the task: whatever moves is stopped by the control script.
        self.task.abort();
    }
}

/// A call under way: its name and when it must have ended.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Call {
    pub(crate) operation: &'static str,
    pub(crate) timeout: Duration,
    pub(crate) until: Instant,
}

/// Longer than anybody waits: a caller's time is cut to it, so that no clock overflows.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

impl Call {
    pub(crate) fn new(operation: &'static str, timeout: Duration) -> Self {
        Self { operation, timeout, until: Instant::now() + timeout.min(LONGEST) }
    }
}

impl UrArm {
    /// Checks settings and begins to connect. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn new(config: UrConfig) -> Result<Self, SettingsError> {
        config.check()?;
        let kinematics = Kinematics::new(config.model);
        let world_from_base = config.world_from_base();
        let flange_from_hand = config.flange_from_hand();
        let connect = Duration::from_secs_f64(config.connect_timeout_s);
        let dashboard = Dashboard::new(config.host.clone(), config.ports.dashboard, connect);
        let shared = Arc::new(Shared::new(config));
        let (orders, received) = mpsc::unbounded_channel();
        let task = tokio::spawn(run(shared.clone(), received)).abort_handle();
        let uploaded = Mutex::new(Uploaded::default());
        Ok(Self { shared, orders, kinematics, world_from_base, flange_from_hand, dashboard, uploaded, task })
    }

    /// Its settings.
    pub fn config(&self) -> &UrConfig {
        &self.shared.config
    }

    /// Its nominal kinematics, to drop unreachable grasps before anything moves.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// Where the flange must be for the hand to be at a pose.
    pub(crate) fn base_from_flange(&self, world_from_hand: &Isometry3<f64>) -> Isometry3<f64> {
        self.world_from_base.inverse() * world_from_hand * self.flange_from_hand.inverse()
    }

    /// What happens from now on.
    pub fn events(&self) -> broadcast::Receiver<UrEvent> {
        self.shared.events.subscribe()
    }

    /// The newest frame, waiting for one while there is no link.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`] when there is none in time.
    pub async fn robot_state(&self, timeout: Duration) -> Result<Arc<RobotState>, DeviceError> {
        self.fresh(Call::new("state", timeout)).await
    }

    pub(crate) fn name(&self) -> String {
        self.config().name.clone()
    }

    fn disconnected(&self, detail: impl Into<String>) -> DeviceError {
        DeviceError::Disconnected { device: self.name(), detail: detail.into() }
    }

    fn fault(&self, kind: FaultKind, detail: impl Into<String>) -> DeviceError {
        DeviceError::Fault { device: self.name(), kind, detail: detail.into() }
    }

    fn timed_out(&self, call: Call) -> DeviceError {
        DeviceError::Timeout { device: self.name(), operation: call.operation, after: call.timeout }
    }

    pub(crate) fn refused(&self, refusal: Refusal) -> DeviceError {
        let Refusal { field, found, expected } = refusal;
        DeviceError::OutOfRange { device: self.name(), field: field.into(), found, expected }
    }

    pub(crate) fn out_of_range(
        &self,
        field: &'static str,
        found: impl ToString,
        expected: &str,
    ) -> DeviceError {
        self.refused(Refusal { field, found: found.to_string(), expected: expected.into() })
    }

    /// A frame, as soon as there is one.
    async fn fresh(&self, call: Call) -> Result<Arc<RobotState>, DeviceError> {
        let mut status = self.shared.status.subscribe();
        loop {
            let why = match &*status.borrow_and_update() {
                Status::Up(state) => return Ok(state.clone()),
                Status::Down(why) => why.clone(),
            };
            match tokio::time::timeout_at(call.until, status.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) | Err(_) => return Err(self.disconnected(why)),
            }
        }
    }

    /// Waits until frames satisfy a condition.
    async fn wait_for(
        &self,
        call: Call,
        until: Instant,
        good: impl Fn(&RobotState) -> bool,
    ) -> Result<Arc<RobotState>, DeviceError> {
        let mut status = self.shared.status.subscribe();
        loop {
            match &*status.borrow_and_update() {
                Status::Up(state) if good(state) => return Ok(state.clone()),
                Status::Up(_) => {}
                Status::Down(why) => return Err(self.disconnected(why.clone())),
            }
            match tokio::time::timeout_at(until, status.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return Err(self.disconnected("the link's task ended")),
                Err(_) => return Err(self.timed_out(call)),
            }
        }
    }

    /// Why the arm cannot move, if it cannot.
    fn stopped(&self, state: &RobotState) -> Option<DeviceError> {
        if let Some(kind) = state.safety.fault() {
            let words = self.shared.words().back().map_or(String::new(), |w| format!("; last words: {w}"));
            return Some(self.fault(kind, format!("safety status {:?}{words}", state.safety)));
        }
        if state.robot_mode != RobotMode::Running {
            let detail = format!(
                "robot mode: found {:?}, expected Running; switch power on and release the brakes on the pendant",
                state.robot_mode
            );
            return Some(self.fault(FaultKind::NotActivated, detail));
        }
        None
    }

    pub(crate) fn admit(&self, state: &RobotState) -> Result<(), DeviceError> {
        if !self.config().armed {
            return Err(self.out_of_range(
                "armed",
                false,
                "true, set on purpose in the arm's settings, before anything moves",
            ));
        }
        self.stopped(state).map_or(Ok(()), Err)
    }

    /// Pose of the flange, base frame, as the controller (which knows its calibration) says.
    pub(crate) fn flange(&self, state: &RobotState) -> Isometry3<f64> {
        match &state.flange_from_tcp {
            Some(flange_from_tcp) => state.base_from_tcp * flange_from_tcp.inverse(),
            None => self.kinematics.forward(&state.joints),
        }
    }
}

#[async_trait]
impl Arm for UrArm {
    fn info(&self) -> ArmInfo {
        let model = self.config().model;
        ArmInfo {
            name: self.name(),
            model: model.name().into(),
            reach_m: model.reach_m(),
            replaces_motion: true,
        }
    }

    /// By the nominal kinematics, from the newest frame: each motion as it would be planned from where the one before
    /// leaves the arm. [`Reach::Unknown`] without a link.
    fn reaches(&self, way: &[Leg]) -> Reach {
        match &*self.shared.status.borrow() {
            Status::Up(state) => self.reach_from(state, way),
            Status::Down(_) => Reach::Unknown,
        }
    }

    async fn state(&self, timeout: Duration) -> Result<ArmState, DeviceError> {
        let state = self.fresh(Call::new("state", timeout)).await?;
        let mode = if let Some(kind) = state.safety.fault() {
            ArmMode::Stopped(kind)
        } else if state.robot_mode != RobotMode::Running {
            ArmMode::Off
        } else if state.mailbox.state == 2 && state.program_running || !state.is_standing() {
            ArmMode::Moving
        } else {
            ArmMode::Ready
        };
        let world_from_flange = self.world_from_base * self.flange(&state) * self.flange_from_hand;
        Ok(ArmState { mode, world_from_flange, joints: state.joints.to_vec() })
    }

    async fn move_to(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        self.travel(Call::new("move_to", timeout), world_from_flange, limits).await
    }

    async fn move_linear(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let call = Call::new("move_linear", timeout);
        self.line(call, world_from_flange, limits, None).await.map(|_| ())
    }

    async fn move_until_contact(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        force_n: f64,
        timeout: Duration,
    ) -> Result<Reached, DeviceError> {
        let most = self.config().limits.force_n;
        if !(force_n > 0.0 && force_n <= most) {
            return Err(self.out_of_range("force_n", force_n, &format!("above 0, at most {most}")));
        }
        let call = Call::new("move_until_contact", timeout);
        self.line(call, world_from_flange, limits, Some(force_n)).await
    }

    async fn follow(
        &self,
        goals: Goals,
        limits: Limits,
        silence: Duration,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        self.follow_goals(goals, limits, silence, timeout).await
    }

    async fn stop(&self, timeout: Duration) -> Result<(), DeviceError> {
        let call = Call::new("stop", timeout);
        let state = self.fresh(call).await?;
        let ours = self.uploaded.try_lock().is_ok_and(|uploaded| uploaded.runs(&state));
        if !self.config().armed {
            // Who is not armed has moved nothing, and touches nothing.
            return self.wait_for(call, call.until, RobotState::is_standing).await.map(|_| ());
        }
        let (written, heard) = oneshot::channel();
        let order = Order::Stop { only: None, written: Some(written) };
        self.orders.send(order).map_err(|_| self.disconnected("the link's task ended"))?;
        let number = match tokio::time::timeout_at(call.until, heard).await {
            Ok(Ok(number)) => number,
            Ok(Err(_)) => return Err(self.disconnected("the link broke before the stop was sent")),
            Err(_) => return Err(self.timed_out(call)),
        };
        if !ours && state.program_running {
            // Somebody else's program moves the arm.
            let stopping = tokio::time::timeout_at(call.until, self.dashboard.stop_program()).await;
            match stopping {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::warn!(%error, "cannot stop the program that runs"),
                Err(_) => return Err(self.timed_out(call)),
            }
        }
        let stands = |s: &RobotState| {
            let idle = !s.program_running || s.mailbox.state != 2;
            (!ours || s.mailbox.done == number || !s.program_running) && idle && s.is_standing()
        };
        self.wait_for(call, call.until, stands).await.map(|_| ())
    }

    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        self.recover(Call::new("clear_fault", timeout)).await
    }
}
