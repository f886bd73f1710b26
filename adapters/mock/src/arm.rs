//! Mock arms: each carries one hand of the shared world.

use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::SettingsError;
use graspd_adapters_core::follow::Goals;
use graspd_adapters_core::{Arm, ArmInfo, ArmState, DeviceError, Leg, Limits, Reach, Reached};
use graspd_sim::world::{HandId, WristForce};
use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use crate::course::Order;
use crate::fault_handle::FaultHandle;
use crate::faults::Faults;
use crate::link::Link;
use crate::motion::Shared;
use crate::shared::{SharedWorld, finite, positive};

/// Acceleration of every arm of a simulated world, metres per second squared.
const ACCELERATION_M_S2: f64 = 2.0;

/// What a mock arm is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmSettings {
    /// Name for logs and errors.
    pub name: String,
    /// Model.
    pub model: String,
    /// Middle of the sphere that it reaches, world frame, metres.
    pub base_m: [f64; 3],
    /// Radius of that sphere, metres.
    pub reach_m: f64,
    /// True when a newer motion replaces the one that runs.
    pub replaces_motion: bool,
    /// Largest speed that it accepts, metres per second.
    pub max_speed_m_s: f64,
    /// Largest angular speed of the flange, radians per second.
    pub turn_rad_s: f64,
    /// Force at the wrist (see [`WristForce`]) at which a motion ends in a protective stop, newtons; none: never.
    pub stop_force_n: Option<f64>,
    /// Time over which that force is smoothed, seconds.
    pub force_filter_s: f64,
}

impl Default for ArmSettings {
    /// A UR5e behind the tray: 0.85 m of reach, stops at 150 N.
    fn default() -> Self {
        Self {
            name: "arm".into(),
            model: "UR5e".into(),
            base_m: [0.0, 0.40, 0.15],
            reach_m: 0.85,
            replaces_motion: true,
            max_speed_m_s: 1.0,
            turn_rad_s: 2.0,
            stop_force_n: Some(150.0),
            force_filter_s: WristForce::FILTER_S,
        }
    }
}

/// An arm in a shared world. Its flange is the root link of the hand that it carries.
///
/// Both kinds of motion are straight lines with even turning, through whatever is in the way: physics decides what
/// comes of that. It accelerates as the world's arms do (2 m/s²), and refuses motions that may only accelerate less.
#[derive(Debug)]
pub struct MockArm {
    pub(crate) link: Link,
    settings: ArmSettings,
    hand: HandId,
    pub(crate) state: Shared,
}

impl MockArm {
    /// An arm that carries a hand of the world.
    ///
    /// # Errors
    /// [`SettingsError`]: a number is impossible.
    pub fn new(
        shared: &SharedWorld,
        hand: HandId,
        settings: ArmSettings,
        faults: Faults,
    ) -> Result<Self, SettingsError> {
        let numbers = [
            ("reach_m", settings.reach_m),
            ("max_speed_m_s", settings.max_speed_m_s),
            ("turn_rad_s", settings.turn_rad_s),
            ("force_filter_s", settings.force_filter_s),
            ("stop_force_n", settings.stop_force_n.unwrap_or(1.0)),
        ];
        for (field, value) in numbers {
            positive(field, value)?;
        }
        for value in settings.base_m {
            finite("base_m", value)?;
        }
        let faults = FaultHandle::new(shared.clock(), faults)?;
        let state = Shared::new(settings.name.clone(), hand, settings.clone(), faults.clone());
        let link = Link { device: settings.name.clone(), shared: shared.clone(), faults };
        Ok(Self { link, settings, hand, state })
    }

    /// Changes the arm's faults at run time.
    pub fn faults(&self) -> FaultHandle {
        self.link.faults.clone()
    }

    /// The hand that it carries.
    pub fn hand(&self) -> HandId {
        self.hand
    }

    async fn travel(
        &self,
        operation: &'static str,
        to: &Isometry3<f64>,
        limits: Limits,
        contact_n: Option<f64>,
        timeout: Duration,
    ) -> Result<Reached, DeviceError> {
        let call = self.link.call(operation, timeout);
        let work = async {
            self.check(to, limits)?;
            self.link.reach(&call, true).await?;
            let (state, world_from_hand, theirs) = (self.state.clone(), *to, call.clone());
            let speed_m_s = limits.speed_m_s;
            let answer = self.link.shared.request(move |stage, reply| {
                state.begin(
                    stage,
                    Order { call: theirs, reply, world_from_hand, speed_m_s, contact_n, led: false },
                );
            });
            let answer = answer.await.map_err(|_| self.link.ended())?;
            self.link.back(&call, answer).await
        };
        self.link.shared.bounded(&call.device, operation, timeout, work).await
    }

    /// What the controller refuses before anything moves.
    pub(crate) fn check(&self, to: &Isometry3<f64>, limits: Limits) -> Result<(), DeviceError> {
        let refuse = |field: &str, found: String, expected: String| {
            let (device, field) = (self.link.device.clone(), field.to_owned());
            Err(DeviceError::OutOfRange { device, field, found, expected })
        };
        let finite = to.translation.vector.iter().chain(to.rotation.coords.iter()).all(|v| v.is_finite());
        if !finite {
            return refuse("world_from_flange", format!("{to}"), "finite numbers".into());
        }
        let distance_m = (Point3::from(to.translation.vector) - Point3::from(self.settings.base_m)).norm();
        if distance_m > self.settings.reach_m {
            let found = format!("{distance_m:.3} m from the base");
            return refuse("world_from_flange", found, format!("at most {} m", self.settings.reach_m));
        }
        let (speed, most) = (limits.speed_m_s, self.settings.max_speed_m_s);
        if !(speed > 0.0 && speed <= most) {
            return refuse("speed_m_s", speed.to_string(), format!("above 0, at most {most}"));
        }
        let acceleration = limits.acceleration_m_s2;
        if !(acceleration >= ACCELERATION_M_S2 && acceleration.is_finite()) {
            let expected = format!("at least {ACCELERATION_M_S2}, with which this arm always accelerates");
            return refuse("acceleration_m_s2", acceleration.to_string(), expected);
        }
        Ok(())
    }
}

#[async_trait]
impl Arm for MockArm {
    fn info(&self) -> ArmInfo {
        ArmInfo {
            name: self.settings.name.clone(),
            model: self.settings.model.clone(),
            reach_m: self.settings.reach_m,
            replaces_motion: self.settings.replaces_motion,
        }
    }

    fn reaches(&self, way: &[Leg]) -> Reach {
        // A sphere is convex: a line between poses in reach is in reach.
        let beyond = |(leg, at): (usize, &Leg)| {
            let error = self.check(&at.world_from_flange, at.limits).err()?;
            Some(Reach::Beyond { leg, why: error.to_string() })
        };
        way.iter().enumerate().find_map(beyond).unwrap_or(Reach::Reaches)
    }

    async fn state(&self, timeout: Duration) -> Result<ArmState, DeviceError> {
        let call = self.link.call("state", timeout);
        let work = async {
            self.link.reach(&call, true).await?;
            let (state, hand) = (self.state.clone(), self.hand);
            let answer = self.link.shared.with(move |world| {
                let mode = state.lock().mode(world);
                world.hand_state(hand).map(|s| (mode, s.world_from_hand))
            });
            let found = answer.await.map_err(|_| self.link.ended())?;
            let (mode, world_from_flange) = found.ok_or_else(|| DeviceError::Disconnected {
                device: self.link.device.clone(),
                detail: "the hand that the arm carries is no longer in the world".into(),
            })?;
            Ok(ArmState { mode, world_from_flange, joints: Vec::new() })
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }

    async fn move_to(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        self.travel("move_to", world_from_flange, limits, None, timeout).await.map(|_| ())
    }

    async fn move_linear(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        timeout: Duration,
    ) -> Result<(), DeviceError> {
        self.travel("move_linear", world_from_flange, limits, None, timeout).await.map(|_| ())
    }

    async fn move_until_contact(
        &self,
        world_from_flange: &Isometry3<f64>,
        limits: Limits,
        force_n: f64,
        timeout: Duration,
    ) -> Result<Reached, DeviceError> {
        if force_n.is_nan() || force_n <= 0.0 {
            let (device, field) = (self.link.device.clone(), "force_n".to_owned());
            let (found, expected) = (force_n.to_string(), "above 0".to_owned());
            return Err(DeviceError::OutOfRange { device, field, found, expected });
        }
        self.travel("move_until_contact", world_from_flange, limits, Some(force_n), timeout).await
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
        let call = self.link.call("stop", timeout);
        let work = async {
            self.link.reach(&call, true).await?;
            let (state, theirs) = (self.state.clone(), call.clone());
            let answer = self.link.shared.request(move |stage, reply| state.stop(stage, theirs, reply));
            let answer = answer.await.map_err(|_| self.link.ended())?;
            self.link.back(&call, answer).await
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }

    async fn clear_fault(&self, timeout: Duration) -> Result<(), DeviceError> {
        let call = self.link.call("clear_fault", timeout);
        let work = async {
            self.link.reach(&call, true).await?;
            let state = self.state.clone();
            let answer = self.link.shared.with(move |world| state.lock().clear(world));
            answer.await.map_err(|_| self.link.ended())?
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }
}
