//! Streams of targets: the dynamic servo.
//!
//! A target that is farther than the allowed speed takes one is refused here. What joints do on their way to it is bounded
//! by the control script: their speed and acceleration, and those of the flange.

use std::time::Duration;

use graspd_adapters_core::{DeviceError, Limits};
use nalgebra::Isometry3;
use tokio::time::Instant;

use crate::arm::{Call, StopOnDrop, UrArm};
use crate::kinematics::{Joints, joint_distance};
use crate::plan::Refusal;
use crate::script::{Command, CommandKind, result};
use crate::session::{Order, Status};
use crate::state::pose_to;

/// How the controller follows a stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoSettings {
    /// Time over which targets are smoothed, 0.03 to 0.2 s.
    pub lookahead_s: f64,
    /// Stiffness of following, 100 to 2000.
    pub gain: f64,
}

impl Default for ServoSettings {
    fn default() -> Self {
        Self { lookahead_s: 0.1, gain: 300.0 }
    }
}

/// A stream of targets. The arm stops when no target comes for `heartbeat.stream_s`, and when this is dropped.
#[must_use = "the arm stops when the stream is dropped"]
pub struct ServoStream<'a> {
    arm: &'a UrArm,
    call: Call,
    guard: StopOnDrop,
    number: i32,
    limits: Limits,
    joints: Joints,
    flange: Isometry3<f64>,
    sent: Instant,
    /// Time that is saved up for the next targets, seconds.
    saved_s: f64,
}

impl std::fmt::Debug for ServoStream<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServoStream").field("number", &self.number).finish_non_exhaustive()
    }
}

/// Time that targets may be ahead of their speed: they come unevenly, and the controller smooths them. A stream that
/// waited longer has saved up no more than this, so that the arm does not jump after.
const MOST_AHEAD_S: f64 = 0.05;
/// The same at the start, for the first target.
const FIRST_AHEAD_S: f64 = 0.02;

impl UrArm {
    /// Begins a stream of joint targets.
    ///
    /// # Errors
    /// As [`graspd_adapters_core::Arm::move_to`].
    pub async fn servo_joints(
        &self,
        settings: ServoSettings,
        limits: Limits,
        timeout: Duration,
    ) -> Result<ServoStream<'_>, DeviceError> {
        self.servo(CommandKind::ServoJoints, "servo_joints", settings, limits, timeout).await
    }

    /// Begins a stream of poses of the hand.
    ///
    /// # Errors
    /// As [`graspd_adapters_core::Arm::move_to`].
    pub async fn servo_pose(
        &self,
        settings: ServoSettings,
        limits: Limits,
        timeout: Duration,
    ) -> Result<ServoStream<'_>, DeviceError> {
        self.servo(CommandKind::ServoPose, "servo_pose", settings, limits, timeout).await
    }

    async fn servo(
        &self,
        kind: CommandKind,
        operation: &'static str,
        settings: ServoSettings,
        limits: Limits,
        timeout: Duration,
    ) -> Result<ServoStream<'_>, DeviceError> {
        let call = Call::new(operation, timeout);
        for (field, value, (least, most)) in
            [("lookahead_s", settings.lookahead_s, (0.03, 0.2)), ("gain", settings.gain, (100.0, 2000.0))]
        {
            if !(value >= least && value <= most) {
                return Err(self.out_of_range(field, value, &format!("{least} to {most}")));
            }
        }
        self.check_limits(limits)?;
        let state = self.robot_state(timeout).await?;
        self.admit(&state)?;
        self.refuse_pressing(&state, None).map_err(|r| self.refused(r))?;
        let command = Command {
            speed: limits.speed_m_s,
            acceleration: limits.acceleration_m_s2,
            force_n: self.config().limits.force_n,
            lookahead_s: settings.lookahead_s,
            gain: settings.gain,
            ..Command::new(kind)
        };
        let guard = self.give(call, command).await?;
        let number = guard.number.unwrap_or(0);
        // Targets count from where the arm is now: uploading the script may have taken a while.
        let state = self.robot_state(timeout).await?;
        let flange = self.flange(&state);
        let sent = Instant::now();
        Ok(ServoStream {
            arm: self,
            call,
            guard,
            number,
            limits,
            joints: state.joints,
            flange,
            sent,
            saved_s: FIRST_AHEAD_S,
        })
    }
}

impl ServoStream<'_> {
    /// Where the last target has the hand, world frame.
    pub(crate) fn at(&self) -> Isometry3<f64> {
        self.arm.world_from_base * self.flange * self.arm.flange_from_hand
    }

    /// Takes the time that a target needs at its allowed speeds; each is what, how far, how fast at most.
    fn spend(&mut self, field: &'static str, ways: &[(&str, f64, f64)]) -> Result<(), DeviceError> {
        let saved = (self.saved_s + self.sent.elapsed().as_secs_f64()).min(MOST_AHEAD_S);
        let mut most: f64 = 0.0;
        for (what, way, speed) in ways {
            let needed = way / speed;
            if needed.is_nan() || needed > saved {
                let found = format!("{way:.4} {what} within {saved:.3} s");
                let expected = format!("at most {speed} {what} a second");
                return Err(self.arm.out_of_range(field, found, &expected));
            }
            most = most.max(needed);
        }
        self.saved_s = saved - most;
        self.sent = Instant::now();
        Ok(())
    }

    /// Why the stream has ended, if it has.
    fn ended(&self) -> Option<DeviceError> {
        let state = match &*self.arm.shared.status.borrow() {
            Status::Up(state) => state.clone(),
            Status::Down(why) => {
                let (device, detail) = (self.arm.name(), why.clone());
                return Some(DeviceError::Disconnected { device, detail });
            }
        };
        if let Err(error) = self.arm.admit(&state) {
            return Some(error);
        }
        let mailbox = state.mailbox;
        let device = self.arm.name();
        if self.arm.shared.newest() != self.number {
            return Some(DeviceError::Stopped { device, operation: self.call.operation });
        }
        if mailbox.accepted == self.number && mailbox.done == self.number {
            return Some(match mailbox.result {
                result::STALE => DeviceError::Timeout {
                    device,
                    operation: "the next target of a stream",
                    after: Duration::from_secs_f64(self.arm.config().heartbeat.stream_s),
                },
                result::FORCE => DeviceError::Fault {
                    device,
                    kind: graspd_adapters_core::FaultKind::Overload,
                    detail: format!("more than limits.force_n = {} N", self.arm.config().limits.force_n),
                },
                _ => DeviceError::Stopped { device, operation: self.call.operation },
            });
        }
        None
    }

    /// Sends joints. Call at up to 500 Hz, and at least every `heartbeat.stream_s`.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] for a target that is too far from the last one for the allowed speed, or outside
    /// limits (the stream goes on with the last one); others when the stream has ended.
    pub fn send_joints(&mut self, target: &Joints) -> Result<(), DeviceError> {
        if let Some(error) = self.ended() {
            return Err(error);
        }
        let limits = self.arm.config().limits;
        if let Some(joint) = self.arm.kinematics.limits().first_outside(target) {
            return Err(self.arm.out_of_range("joints", target[joint], "within the joint's limits"));
        }
        let flange = self.arm.kinematics.forward(target);
        self.inside(&flange)?;
        let way = (flange.translation.vector - self.flange.translation.vector).norm();
        let ways = [
            ("rad of a joint", joint_distance(target, &self.joints), limits.joint_speed_rad_s),
            ("m", way, self.limits.speed_m_s),
        ];
        self.spend("joints", &ways)?;
        (self.joints, self.flange) = (*target, flange);
        self.emit(*target)
    }

    /// Sends a pose of the hand, world frame. Call at up to 500 Hz, and at least every `heartbeat.stream_s`.
    ///
    /// # Errors
    /// As [`ServoStream::send_joints`].
    pub fn send_pose(&mut self, world_from_flange: &Isometry3<f64>) -> Result<(), DeviceError> {
        if let Some(error) = self.ended() {
            return Err(error);
        }
        let limits = self.arm.config().limits;
        let target = self.arm.base_from_flange(world_from_flange);
        let Some(joints) = self.arm.kinematics.closest(&target, &self.joints) else {
            return Err(self.arm.out_of_range("world_from_flange", target, "a pose that the arm reaches"));
        };
        self.inside(&target)?;
        let way = (target.translation.vector - self.flange.translation.vector).norm();
        let ways = [
            ("m", way, self.limits.speed_m_s),
            ("rad of the flange", target.rotation.angle_to(&self.flange.rotation), limits.turn_rad_s),
            ("rad of a joint", joint_distance(&joints, &self.joints), limits.joint_speed_rad_s),
        ];
        self.spend("world_from_flange", &ways)?;
        (self.joints, self.flange) = (joints, target);
        self.emit(pose_to(&target))
    }

    fn inside(&self, base_from_flange: &Isometry3<f64>) -> Result<(), DeviceError> {
        let world = self.arm.world_from_base * base_from_flange;
        let at = world.translation.vector;
        if self.arm.config().limits.workspace.contains(&at) {
            return Ok(());
        }
        let (found, expected) = (format!("{:.3?} m", at.as_slice()), "inside limits.workspace".into());
        Err(self.arm.refused(Refusal { field: "workspace", found, expected }))
    }

    fn emit(&mut self, target: [f64; 6]) -> Result<(), DeviceError> {
        let order = Order::Target { number: self.number, target };
        self.arm.orders.send(order).map_err(|_| DeviceError::Disconnected {
            device: self.arm.name(),
            detail: "the link's task ended".into(),
        })
    }

    /// Ends the stream: the arm brakes and stands.
    ///
    /// # Errors
    /// As [`graspd_adapters_core::Arm::stop`].
    pub async fn finish(mut self, timeout: Duration) -> Result<(), DeviceError> {
        let stopped = graspd_adapters_core::Arm::stop(self.arm, timeout).await;
        if stopped.is_ok() {
            self.guard.number = None;
        }
        stopped
    }
}
