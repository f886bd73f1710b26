//! Motions: refused or bounded before they begin, given to the control script, stopped when nobody waits any more.

use std::time::Duration;

use graspd_adapters_core::{DeviceError, FaultKind, Limits, Reached};
use nalgebra::{Isometry3, Vector3};
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use super::{Call, UrArm};
use crate::kinematics::{Joints, joint_distance};
use crate::plan::{Allowed, Pace, Refusal, joint_motion, joint_pace, line_motion};
use crate::script::{Command, CommandKind, result};
use crate::session::{Order, Status};
use crate::state::{RobotState, pose_to};

/// A command that the script does not take within this time will not be taken.
const TAKEN: Duration = Duration::from_secs(2);
/// An arm that is pressed on with so many times `limits.force_n` may only give way.
const PRESSED: f64 = 1.5;
/// An arm whose joints went farther than this since a motion was planned has moved, radians.
const MOVED_RAD: f64 = 0.01;
/// Added to the time of braking: what messages need on their way.
const GRACE: Duration = Duration::from_millis(150);

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

impl UrArm {
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
        // What the controller calls done may still settle for a moment.
        let arrival = self.config().arrival;
        let until = call.until.min(Instant::now() + Duration::from_secs_f64(arrival.settle_s));
        let off = |state: &RobotState| {
            goal.map_or((0.0, 0.0), |goal| {
                let found = self.flange(state);
                let way = (found.translation.vector - goal.translation.vector).norm();
                (way, found.rotation.angle_to(&goal.rotation))
            })
        };
        let there = |state: &RobotState| {
            let (way, angle) = off(state);
            state.is_standing() && way <= arrival.position_m && angle <= arrival.angle_rad
        };
        match self.wait_for(call, until, there).await {
            Ok(_) => return Ok(()),
            Err(DeviceError::Timeout { .. }) => {}
            Err(error) => return Err(error),
        }
        let (way, angle) = off(&*self.fresh(call).await?);
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
    pub(super) fn in_base(&self, world_from_flange: &Isometry3<f64>) -> Result<Isometry3<f64>, DeviceError> {
        let (t, r) = (world_from_flange.translation.vector, world_from_flange.rotation.coords);
        if !t.iter().chain(r.iter()).all(|v| v.is_finite()) {
            return Err(self.out_of_range("world_from_flange", world_from_flange, "finite numbers"));
        }
        Ok(self.base_from_flange(world_from_flange))
    }

    /// Plans a motion from where the arm is, makes sure that the control script runs, and plans it again where the arm
    /// has moved meanwhile (an upload takes a while, in which a person may push it): what begins has been looked at from
    /// where it begins. What is refused is refused before anything is uploaded.
    async fn planned(
        &self,
        call: Call,
        plan: impl Fn(&RobotState) -> Result<Command, Refusal>,
    ) -> Result<Command, DeviceError> {
        let before = self.fresh(call).await?;
        self.admit(&before)?;
        let command = plan(&before).map_err(|r| self.refused(r))?;
        self.control(call).await?;
        let state = self.fresh(call).await?;
        self.admit(&state)?;
        if joint_distance(&before.joints, &state.joints) <= MOVED_RAD {
            return Ok(command);
        }
        plan(&state).map_err(|r| self.refused(r))
    }

    /// An arm that presses hard already may only move away from what presses on it.
    pub(crate) fn refuse_pressing(
        &self,
        state: &RobotState,
        base_from_goal: Option<&Isometry3<f64>>,
    ) -> Result<(), Refusal> {
        let [x, y, z, ..] = state.wrench;
        let force = Vector3::new(x, y, z);
        let most = PRESSED * self.config().limits.force_n;
        let way = base_from_goal.map(|goal| goal.translation.vector - self.flange(state).translation.vector);
        if force.norm() <= most || way.is_some_and(|way| way.dot(&force) >= 0.0) {
            return Ok(());
        }
        let found = format!("{:.0} N at the flange before it begins", force.norm());
        let expected = format!("at most {most:.0} N, or a motion away from what presses");
        Err(Refusal { field: "force", found, expected })
    }

    /// Takes joints to joints, all at the same time.
    ///
    /// # Errors
    /// As [`graspd_adapters_core::Arm::move_to`].
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
        let goal = self.kinematics.forward(to);
        let plan = |state: &RobotState| {
            self.refuse_pressing(state, Some(&goal))?;
            let pace = joint_pace(&self.kinematics, &self.world_from_base, &state.joints, to, allowed)?;
            Ok(self.paced(CommandKind::Joints, pace, *to))
        };
        let command = self.planned(call, plan).await?;
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

    pub(super) async fn line(
        &self,
        call: Call,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        force_n: Option<f64>,
    ) -> Result<Reached, DeviceError> {
        let allowed = self.check_limits(limits)?;
        let goal = self.in_base(world_from_flange)?;
        let kind = if force_n.is_some() { CommandKind::Contact } else { CommandKind::Line };
        let plan = |state: &RobotState| {
            self.refuse_pressing(state, Some(&goal))?;
            let from = (&self.flange(state), &state.joints);
            let (_, pace) = line_motion(&self.kinematics, &self.world_from_base, from, &goal, allowed)?;
            let command = self.paced(kind, pace, pose_to(&goal));
            Ok(Command { force_n: force_n.unwrap_or(command.force_n), ..command })
        };
        let command = self.planned(call, plan).await?;
        self.carry_out(call, limits, command, Some(&goal)).await
    }

    /// A joint motion to a pose.
    pub(super) async fn travel(
        &self,
        call: Call,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
    ) -> Result<(), DeviceError> {
        let allowed = self.check_limits(limits)?;
        let goal = self.in_base(world_from_flange)?;
        let plan = |state: &RobotState| {
            self.refuse_pressing(state, Some(&goal))?;
            let (arm, base) = (&self.kinematics, &self.world_from_base);
            let (near, pace) = joint_motion(arm, base, &state.joints, &goal, allowed)?;
            Ok(Command { near, ..self.paced(CommandKind::Pose, pace, pose_to(&goal)) })
        };
        let command = self.planned(call, plan).await?;
        self.carry_out(call, limits, command, Some(&goal)).await.map(|_| ())
    }
}
