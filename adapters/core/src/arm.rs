//! Robot arms.

use std::time::Duration;

use async_trait::async_trait;
use nalgebra::Isometry3;

use crate::follow::Goals;
use crate::{DeviceError, FaultKind};

/// What an arm is.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmInfo {
    /// Name for logs and errors.
    pub name: String,
    /// Model, for example `UR5e`.
    pub model: String,
    /// Farthest distance of the flange from the base, metres.
    pub reach_m: f64,
    /// True when a newer motion replaces the one that runs; else it is refused with [`DeviceError::Busy`].
    pub replaces_motion: bool,
}

/// How fast a motion may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Speed of the flange, metres per second.
    pub speed_m_s: f64,
    /// Acceleration of the flange, metres per second squared.
    pub acceleration_m_s2: f64,
}

/// How a guarded motion ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reached {
    /// At the pose.
    Goal,
    /// Before it: the hand met something.
    Contact,
}

/// One motion of a way that is thought of, not yet gone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// Where it ends, world frame.
    pub world_from_flange: Isometry3<f64>,
    /// True for a straight line ([`Arm::move_linear`], [`Arm::move_until_contact`]), false for any path ([`Arm::move_to`]).
    pub straight: bool,
    /// How fast it will be asked for.
    pub limits: Limits,
}

/// What an arm says of a way before it goes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reach {
    /// It cannot tell: it does not know its kinematics, or not where it stands.
    Unknown,
    /// It would refuse none of these motions.
    Reaches,
    /// It would refuse one.
    Beyond {
        /// Which one, counted from 0.
        leg: usize,
        /// Why: field, what was found, what is expected.
        why: String,
    },
}

/// Whether the arm can be moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArmMode {
    /// Powered, brakes released, nothing runs.
    Ready,
    /// A motion runs.
    Moving,
    /// It stopped itself or was stopped by a person.
    Stopped(FaultKind),
    /// Not powered, or brakes on.
    Off,
}

/// What an arm reports.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmState {
    /// Whether it can be moved.
    pub mode: ArmMode,
    /// Pose of the flange (where the hand's root link is mounted), world frame.
    pub world_from_flange: Isometry3<f64>,
    /// Joint positions, radians; empty where the arm does not say.
    pub joints: Vec<f64>,
}

/// A robot arm that carries a hand on its flange.
#[async_trait]
pub trait Arm: Send + Sync + std::fmt::Debug {
    /// What it is. Known without asking the device again.
    fn info(&self) -> ArmInfo;

    /// Whether it could go a way from where it stands, one motion after the other. Asks nothing of the device and moves
    /// nothing; what may stand in the way is not looked at. An arm that knows nothing of its kinematics says
    /// [`Reach::Unknown`], as this default does.
    fn reaches(&self, way: &[Leg]) -> Reach {
        let _ = way;
        Reach::Unknown
    }

    /// What it reports now.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`], [`DeviceError::Disconnected`].
    async fn state(&self, timeout: Duration) -> Result<ArmState, DeviceError>;

    /// Takes the flange to a pose on any path (through the air, not past objects). Ends when it is there.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] for a pose out of reach, before anything moves; [`DeviceError::Fault`] when the
    /// arm stops itself on the way; [`DeviceError::Timeout`] after having stopped the motion.
    async fn move_to(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError>;

    /// Takes the flange to a pose on a straight line. Ends when it is there.
    ///
    /// # Errors
    /// As [`Arm::move_to`].
    async fn move_linear(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError>;

    /// Takes the flange to a pose on a straight line, and stops where something presses on the hand with more than
    /// `force_n` newtons (a guarded motion). An arm that feels no force goes on to the pose, as this default does.
    ///
    /// # Errors
    /// As [`Arm::move_to`].
    async fn move_until_contact(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        force_n: f64,
        timeout: Duration,
    ) -> Result<Reached, DeviceError> {
        let _ = force_n;
        self.move_linear(world_from_flange, limits, timeout).await.map(|()| Reached::Goal)
    }

    /// Follows poses of the flange as they come, the newest at a time, on any path that stays within the limits however far
    /// they are apart (a servo stream). Ends well when nobody leads any more, and the arm stands. Poses must come at least every
    /// `silence`, the first one too: an arm that hears nothing for so long stops and says so. `timeout` is what beginning and
    /// ending may take each, not the stream itself. An arm that cannot follow says [`DeviceError::Unsupported`], as this
    /// default does.
    ///
    /// # Errors
    /// [`DeviceError::OutOfRange`] for a pose out of reach, [`DeviceError::Timeout`] after silence, [`DeviceError::Fault`] when
    /// the arm stops itself, [`DeviceError::Stopped`] when another motion took its place. The arm has stopped, or stops.
    async fn follow(
        &self,
        goals: Goals,
        limits: Limits,
        silence: Duration,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        let _ = (goals, limits, silence, timeout);
        Err(DeviceError::Unsupported { device: self.info().name, operation: "follow" })
    }

    /// Stops any motion with bounded deceleration. Ends when the arm stands.
    ///
    /// # Errors
    /// [`DeviceError::Timeout`], [`DeviceError::Disconnected`].
    async fn stop(&self, timeout: Duration) -> Result<(), DeviceError>;

    /// Releases a protective stop or a fault that may be released by software; no motion is resumed.
    ///
    /// # Errors
    /// [`DeviceError::Fault`] when a person is needed.
    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError>;
}
