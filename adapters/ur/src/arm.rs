//! The arm: what a cell asks of it, bounded, and stopped when nobody waits any more.

use std::sync::Arc;
use std::time::Duration;

use graspd_adapters_core::{
    Arm, ArmInfo, ArmMode, ArmState, DeviceError, FaultKind, Limits, Reached, async_trait,
};
use nalgebra::Isometry3;
use tokio::sync::{Mutex, broadcast, mpsc, oneshot};
use tokio::task::AbortHandle;
use tokio::time::Instant;

use crate::config::{ConfigError, UrConfig};
use crate::dashboard::Dashboard;
use crate::events::UrEvent;
use crate::kinematics::{Joints, Kinematics};
use crate::plan::{Allowed, Pace, Refusal, joint_motion, joint_pace, line_pace};
use crate::script::{Command, CommandKind, result};
use crate::session::{Order, Shared, Status, run};
use crate::state::{RobotMode, RobotState, pose_to};
use crate::upload::Uploaded;

/// A command that the script does not take within this time will not be taken.
const TAKEN: Duration = Duration::from_secs(1);
/// Added to the time of braking: what messages need on their way.
const GRACE: Duration = Duration::from_millis(150);

/// An arm by Universal Robots. Its link is looked after by a task, which ends when this is dropped.
#[derive(Debug)]
pub struct UrArm {
    pub(crate) shared: Arc<Shared>,
    pub(crate) orders: mpsc::UnboundedSender<Order>,
    pub(crate) kinematics: Kinematics,
    pub(crate) world_from_base: Isometry3<f64>,
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

/// Stops a motion whose caller has gone.
pub(crate) struct StopOnDrop {
    pub(crate) orders: mpsc::UnboundedSender<Order>,
    pub(crate) number: Option<i32>,
}

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        if let Some(number) = self.number {
            // The task is gone only with the arm.
            let _gone = self.orders.send(Order::Stop { only: Some(number), written: None });
        }
    }
}

/// A call under way: its name and when it must have ended.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Call {
    pub(crate) operation: &'static str,
    pub(crate) timeout: Duration,
    pub(crate) until: Instant,
}

impl Call {
    pub(crate) fn new(operation: &'static str, timeout: Duration) -> Self {
        Self { operation, timeout, until: Instant::now() + timeout }
    }
}

impl UrArm {
    /// Checks settings and begins to connect. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn new(config: UrConfig) -> Result<Self, ConfigError> {
        config.check()?;
        let kinematics = Kinematics::new(config.model);
        let world_from_base = config.world_from_base();
        let connect = Duration::from_secs_f64(config.connect_timeout_s);
        let dashboard = Dashboard::new(config.host.clone(), config.ports.dashboard, connect);
        let shared = Arc::new(Shared::new(config));
        let (orders, received) = mpsc::unbounded_channel();
        let task = tokio::spawn(run(shared.clone(), received)).abort_handle();
        let uploaded = Mutex::new(Uploaded::default());
        Ok(Self { shared, orders, kinematics, world_from_base, dashboard, uploaded, task })
    }

    /// Its settings.
    pub fn config(&self) -> &UrConfig {
        &self.shared.config
    }

    /// Its nominal kinematics, to drop unreachable grasps before anything moves.
    pub fn kinematics(&self) -> &Kinematics {
        &self.kinematics
    }

    /// True when some posture takes the flange to a pose inside the workspace.
    pub fn reaches(&self, world_from_flange: &Isometry3<f64>) -> bool {
        let inside = self.config().limits.workspace.contains(&world_from_flange.translation.vector);
        inside && self.kinematics.reaches(&(self.world_from_base.inverse() * world_from_flange))
    }

    /// The controller's dashboard.
    pub fn dashboard(&self) -> &Dashboard {
        &self.dashboard
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

    /// Makes sure that the control script runs.
    async fn control(&self, call: Call) -> Result<(), DeviceError> {
        let mut uploaded = tokio::time::timeout_at(call.until, self.uploaded.lock())
            .await
            .map_err(|_| self.timed_out(call))?;
        let state = self.fresh(call).await?;
        if uploaded.runs(&state) {
            return Ok(());
        }
        match tokio::time::timeout_at(call.until, self.dashboard.is_remote()).await {
            Ok(Ok(Some(false))) => {
                let detail = "the controller is not in remote control; expected: a person chooses Remote Control at \
                              the top right of the pendant";
                return Err(self.fault(FaultKind::Other, detail));
            }
            Ok(Ok(_)) => {}
            // The dashboard is asked for a clear message only: it may be switched off on the pendant.
            Ok(Err(error)) => tracing::warn!(%error, "cannot ask who is in control"),
            Err(_) => return Err(self.timed_out(call)),
        }
        self.shared.words().clear();
        uploaded.upload(&self.shared, call.until).await.map_err(|e| self.disconnected(e))?;
        let started = Instant::now() + Duration::from_secs(3);
        let waited = self.wait_for(call, call.until.min(started), |state| uploaded.runs(state)).await;
        match waited {
            Ok(state) => {
                self.shared.begin_after(state.mailbox.accepted);
                Ok(())
            }
            Err(DeviceError::Timeout { .. }) => {
                let words: Vec<String> = self.shared.words().iter().take(3).cloned().collect();
                let words = if words.is_empty() { "nothing".into() } else { words.join("; ") };
                let detail = format!(
                    "control script: found output_int_register_28 without its token, expected it running; the \
                     controller said {words}"
                );
                if let Some(error) = self.fresh(call).await.ok().and_then(|s| self.stopped(&s)) {
                    return Err(error);
                }
                Err(DeviceError::Protocol { device: self.name(), detail })
            }
            Err(error) => Err(error),
        }
    }

    /// Gives a command to the script; the motion stops when the guard is dropped.
    pub(crate) async fn give(&self, call: Call, command: Command) -> Result<StopOnDrop, DeviceError> {
        self.control(call).await?;
        let number = self.shared.next_number();
        let guard = StopOnDrop { orders: self.orders.clone(), number: Some(number) };
        let (written, heard) = oneshot::channel();
        let order = Order::Command { number, command, written };
        self.orders.send(order).map_err(|_| self.disconnected("the link's task ended"))?;
        match tokio::time::timeout_at(call.until, heard).await {
            Ok(Ok(())) => Ok(guard),
            Ok(Err(_)) if self.shared.newest() != number => Err(self.replaced(call)),
            Ok(Err(_)) => Err(self.disconnected("the link broke before the command was sent")),
            Err(_) => Err(self.timed_out(call)),
        }
    }

    fn replaced(&self, call: Call) -> DeviceError {
        DeviceError::Stopped { device: self.name(), operation: call.operation }
    }

    /// Waits for the end of a command.
    pub(crate) async fn outcome(&self, call: Call, number: i32, until: Instant) -> Result<i32, DeviceError> {
        let mut status = self.shared.status.subscribe();
        let given = Instant::now();
        let mut taken = false;
        loop {
            let state = match &*status.borrow_and_update() {
                Status::Up(state) => state.clone(),
                Status::Down(why) => return Err(self.disconnected(why.clone())),
            };
            let mailbox = state.mailbox;
            if mailbox.accepted == number {
                taken = true;
                if mailbox.done == number {
                    return Ok(mailbox.result);
                }
            } else if taken || self.shared.newest() != number {
                return Err(self.replaced(call));
            }
            if let Some(error) = self.stopped(&state) {
                return Err(error);
            }
            if mailbox.ended == 1 {
                return Err(
                    self.disconnected("the control script stopped the arm: no heartbeat came in time")
                );
            }
            if taken && !state.program_running {
                let words = self.shared.words().back().cloned().unwrap_or_else(|| "nothing".into());
                let detail =
                    format!("the control script ended in the middle of a motion; last words: {words}");
                return Err(self.fault(FaultKind::Other, detail));
            }
            if !taken && given.elapsed() > TAKEN {
                let detail = format!(
                    "output_int_register_25: found {}, expected {number} within {TAKEN:?}",
                    mailbox.accepted
                );
                return Err(DeviceError::Protocol { device: self.name(), detail });
            }
            let next = until.min(Instant::now() + Duration::from_millis(200));
            match tokio::time::timeout_at(next, status.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return Err(self.disconnected("the link's task ended")),
                Err(_) if Instant::now() >= until => return Err(self.timed_out(call)),
                Err(_) => {}
            }
        }
    }

    /// Time that braking takes at most, with what messages need.
    fn braking(&self, limits: Limits) -> Duration {
        let ours = &self.config().limits;
        let seconds = (limits.speed_m_s / ours.stop_m_s2).max(ours.joint_speed_rad_s / ours.stop_rad_s2);
        Duration::from_secs_f64(seconds) + GRACE
    }

    /// Runs a command to its end.
    async fn carry_out(
        &self,
        call: Call,
        limits: Limits,
        command: Command,
        goal: Option<&Isometry3<f64>>,
    ) -> Result<Reached, DeviceError> {
        let mut guard = self.give(call, command).await?;
        let Some(number) = guard.number else { return Err(self.replaced(call)) };
        // Braked so early that the answer comes in time.
        let brake_at = call.until - self.braking(limits).min(call.timeout / 2);
        let outcome = self.outcome(call, number, brake_at).await;
        match outcome {
            Ok(result::GOAL) => {
                guard.number = None;
                self.arrived(call, goal).await.map(|()| Reached::Goal)
            }
            Ok(result::CONTACT) => {
                guard.number = None;
                Ok(Reached::Contact)
            }
            Ok(result::FORCE) => {
                guard.number = None;
                let detail = format!(
                    "a force of more than limits.force_n = {} N stopped {}",
                    self.config().limits.force_n,
                    call.operation
                );
                Err(self.fault(FaultKind::Overload, detail))
            }
            Ok(result::STOPPED) => {
                guard.number = None;
                Err(self.replaced(call))
            }
            Ok(other) => {
                let detail = format!("output_int_register_26: found {other}, expected a result of a motion");
                Err(DeviceError::Protocol { device: self.name(), detail })
            }
            Err(DeviceError::Timeout { .. }) => {
                drop(guard);
                // It brakes now; the answer waits until it stands, as far as there is time.
                let _stood = self.wait_for(call, call.until, RobotState::is_standing).await;
                Err(self.timed_out(call))
            }
            Err(error) => Err(error),
        }
    }

    /// What the controller calls done is compared with where the arm is.
    async fn arrived(&self, call: Call, goal: Option<&Isometry3<f64>>) -> Result<(), DeviceError> {
        let settle = Instant::now() + Duration::from_millis(500);
        let until = call.until.min(settle);
        let state = match self.wait_for(call, until, RobotState::is_standing).await {
            Err(DeviceError::Timeout { .. }) => self.fresh(call).await?,
            state => state?,
        };
        let Some(goal) = goal else { return Ok(()) };
        let found = self.flange(&state);
        let way = (found.translation.vector - goal.translation.vector).norm();
        let angle = found.rotation.angle_to(&goal.rotation);
        let arrival = self.config().arrival;
        if way <= arrival.position_m && angle <= arrival.angle_rad {
            return Ok(());
        }
        let detail = format!(
            "actual_TCP_pose after {}: found {:.1} mm and {:.4} rad from the goal, expected at most {:.1} mm and {} rad",
            call.operation,
            1000.0 * way,
            angle,
            1000.0 * arrival.position_m,
            arrival.angle_rad
        );
        Err(DeviceError::Protocol { device: self.name(), detail })
    }

    /// Pose of the flange, base frame, as the controller (which knows its calibration) says.
    pub(crate) fn flange(&self, state: &RobotState) -> Isometry3<f64> {
        match &state.flange_from_tcp {
            Some(flange_from_tcp) => state.base_from_tcp * flange_from_tcp.inverse(),
            None => self.kinematics.forward(&state.joints),
        }
    }

    /// What is refused before anything moves.
    pub(crate) fn check_limits<'s>(&'s self, limits: Limits) -> Result<Allowed<'s>, DeviceError> {
        let ours = &self.config().limits;
        for (field, value, most) in [
            ("speed_m_s", limits.speed_m_s, ours.speed_m_s),
            ("acceleration_m_s2", limits.acceleration_m_s2, ours.acceleration_m_s2),
        ] {
            if !(value > 0.0 && value <= most) {
                return Err(self.out_of_range(field, value, &format!("above 0, at most {most}")));
            }
        }
        let (speed_m_s, acceleration_m_s2) = (limits.speed_m_s, limits.acceleration_m_s2);
        Ok(Allowed { speed_m_s, acceleration_m_s2, limits: ours })
    }

    /// The goal in the base frame.
    fn in_base(&self, world_from_flange: &Isometry3<f64>) -> Result<Isometry3<f64>, DeviceError> {
        let (t, r) = (world_from_flange.translation.vector, world_from_flange.rotation.coords);
        if !t.iter().chain(r.iter()).all(|v| v.is_finite()) {
            return Err(self.out_of_range("world_from_flange", world_from_flange, "finite numbers"));
        }
        Ok(self.world_from_base.inverse() * world_from_flange)
    }

    /// Takes joints to joints, all at the same time.
    ///
    /// # Errors
    /// As [`Arm::move_to`].
    pub async fn move_joints(
        &self,
        to: &Joints,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let call = Call::new("move_joints", timeout);
        let allowed = self.check_limits(limits)?;
        if let Some(joint) = self.kinematics.limits().first_outside(to) {
            let limits = self.kinematics.limits();
            let expected = format!("joint {joint} from {} to {}", limits.lower[joint], limits.upper[joint]);
            return Err(self.out_of_range("joints", to[joint], &expected));
        }
        let state = self.fresh(call).await?;
        self.admit(&state)?;
        let pace = joint_pace(&self.kinematics, &self.world_from_base, &state.joints, to, allowed)
            .map_err(|r| self.refused(r))?;
        let command = self.paced(CommandKind::Joints, pace, *to);
        self.carry_out(call, limits, command, None).await.map(|_| ())
    }

    fn paced(&self, kind: CommandKind, pace: Pace, target: [f64; 6]) -> Command {
        Command {
            target,
            speed: pace.speed,
            acceleration: pace.acceleration,
            time_s: pace.time_s,
            force_n: self.config().limits.force_n,
            ..Command::new(kind)
        }
    }

    async fn line(
        &self,
        call: Call,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        force_n: Option<f64>,
    ) -> Result<Reached, DeviceError> {
        let allowed = self.check_limits(limits)?;
        let goal = self.in_base(world_from_flange)?;
        let state = self.fresh(call).await?;
        self.admit(&state)?;
        let from = (&self.flange(&state), &state.joints);
        let pace = line_pace(&self.kinematics, &self.world_from_base, from, &goal, allowed)
            .map_err(|r| self.refused(r))?;
        let kind = if force_n.is_some() { CommandKind::Contact } else { CommandKind::Line };
        let mut command = self.paced(kind, pace, pose_to(&goal));
        if let Some(force_n) = force_n {
            command.force_n = force_n;
        }
        self.carry_out(call, limits, command, Some(&goal)).await
    }

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
        if !self.config().unlock_protective_stop {
            let detail = "protective stop: a person inspects the cause and unlocks it on the pendant (or \
                          unlock_protective_stop is set to let software do it)";
            return Err(self.fault(FaultKind::Other, detail));
        }
        loop {
            let asked = async {
                self.dashboard.close_safety_popup().await?;
                self.dashboard.unlock_protective_stop().await
            };
            match tokio::time::timeout_at(call.until, asked).await {
                Err(_) => return Err(self.timed_out(call)),
                Ok(Err(crate::dashboard::DashboardError::TooEarly(why))) => {
                    tracing::info!(why, "waiting to unlock");
                    let wait = Instant::now() + Duration::from_millis(250);
                    if wait >= call.until {
                        return Err(self.timed_out(call));
                    }
                    tokio::time::sleep_until(wait).await;
                }
                Ok(Err(error)) => return Err(self.fault(FaultKind::ProtectiveStop, error.to_string())),
                Ok(Ok(())) => {
                    return self.wait_for(call, call.until, |s| s.safety.allows_motion()).await.map(|_| ());
                }
            }
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
        let world_from_flange = self.world_from_base * self.flange(&state);
        Ok(ArmState { mode, world_from_flange, joints: state.joints.to_vec() })
    }

    async fn move_to(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let call = Call::new("move_to", timeout);
        let allowed = self.check_limits(limits)?;
        let goal = self.in_base(world_from_flange)?;
        let state = self.fresh(call).await?;
        self.admit(&state)?;
        let planned = joint_motion(&self.kinematics, &self.world_from_base, &state.joints, &goal, allowed);
        let (near, pace) = planned.map_err(|r| self.refused(r))?;
        let mut command = self.paced(CommandKind::Pose, pace, pose_to(&goal));
        command.near = near;
        self.carry_out(call, limits, command, Some(&goal)).await.map(|_| ())
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
        let call = Call::new("clear_fault", timeout);
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
