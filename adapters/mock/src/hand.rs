//! Mock hands: the fingers of a hand of the shared world.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use graspd_adapters_core::check::SettingsError;
use graspd_adapters_core::{CloseCommand, DeviceError, GripCommand, Hand, HandInfo, HandState};
use graspd_hands::{Coordinate, CoordinateKind};
use graspd_sim::world::HandId;
use serde::{Deserialize, Serialize};

use crate::fault_handle::FaultHandle;
use crate::faults::Faults;
use crate::grip::{Order, Shared};
use crate::link::Link;
use crate::shared::{SharedWorld, positive};

/// What a mock hand says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandSettings {
    /// Name for logs and errors.
    pub name: String,
    /// False for a hand that does not say when something holds its motors.
    pub feels_contact: bool,
    /// How far from its target an actuator at rest counts as held, share of its range. One that presses with a fifth of
    /// what it was allowed counts, too.
    pub held_share: f64,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self { name: "hand".into(), feels_contact: true, held_share: 0.02 }
    }
}

/// The fingers of a hand in a shared world. A second grip while one runs is refused as busy.
#[derive(Debug)]
pub struct MockHand {
    link: Link,
    info: HandInfo,
    actuators: Vec<Coordinate>,
    hand: HandId,
    state: Shared,
}

impl MockHand {
    /// The fingers of a hand of the world; it may be carried by a [`crate::MockArm`].
    ///
    /// # Errors
    /// [`SettingsError`]: a number is impossible, or the hand is not in the world.
    pub async fn new(
        shared: &SharedWorld,
        hand: HandId,
        settings: HandSettings,
        faults: Faults,
    ) -> Result<Self, SettingsError> {
        positive("held_share", settings.held_share)?;
        let faults = FaultHandle::new(shared.clock(), faults)?;
        let described: Option<Arc<graspd_hands::Hand>> =
            shared.with(move |world| world.hand(hand).cloned()).await.ok().flatten();
        let described = described.ok_or_else(|| SettingsError {
            field: "hand".into(),
            found: format!("{hand:?}"),
            expected: "a hand that is in the world".into(),
        })?;
        let coordinates = described.actuation.coordinates.iter();
        let actuators: Vec<Coordinate> =
            coordinates.filter(|c| c.kind == CoordinateKind::Actuator).cloned().collect();
        let info = HandInfo {
            name: settings.name.clone(),
            hand_id: described.id.clone(),
            actuators: actuators.iter().map(|c| c.name.clone()).collect(),
            feels_contact: settings.feels_contact,
        };
        let ranges = actuators.iter().map(|c| c.upper - c.lower).collect();
        let held_share = settings.feels_contact.then_some(settings.held_share);
        let state = Shared::new(settings.name.clone(), hand, faults.clone(), ranges, held_share);
        let link = Link { device: settings.name, shared: shared.clone(), faults };
        Ok(Self { link, info, actuators, hand, state })
    }

    /// Changes the hand's faults at run time.
    pub fn faults(&self) -> FaultHandle {
        self.link.faults.clone()
    }

    /// Which hand of the world it is.
    pub fn hand(&self) -> HandId {
        self.hand
    }

    /// What the controller refuses before anything moves.
    fn check(&self, command: &GripCommand) -> Result<(), DeviceError> {
        let found = command.actuators.len();
        let expected = self.actuators.len();
        if found != expected {
            return self.refuse("actuators".into(), format!("{found} values"), format!("{expected}"));
        }
        self.check_range("actuators", &command.actuators)?;
        for (field, share) in [("speed", command.speed), ("force", command.force)] {
            if !(0.0..=1.0).contains(&share) {
                return self.refuse(field.into(), share.to_string(), "a share from 0 to 1".into());
            }
        }
        Ok(())
    }

    fn check_range(&self, list: &str, targets: &[f64]) -> Result<(), DeviceError> {
        for (target, c) in targets.iter().zip(&self.actuators) {
            // A planner's answer may lie on a limit, give or take a rounding.
            if !(*target >= c.lower - 1e-6 && *target <= c.upper + 1e-6) {
                let field = format!("{list}.{}", c.name);
                return self.refuse(field, target.to_string(), format!("{} to {}", c.lower, c.upper));
            }
        }
        Ok(())
    }

    fn refuse(&self, field: String, found: String, expected: String) -> Result<(), DeviceError> {
        Err(DeviceError::OutOfRange { device: self.link.device.clone(), field, found, expected })
    }
}

#[async_trait]
impl Hand for MockHand {
    fn info(&self) -> HandInfo {
        self.info.clone()
    }

    async fn state(&self, timeout: Duration) -> Result<HandState, DeviceError> {
        let call = self.link.call("state", timeout);
        let work = async {
            self.link.reach(&call, true).await?;
            let state = self.state.clone();
            let answer = self.link.shared.with(move |world| state.lock().state(world));
            answer.await.map_err(|_| self.link.ended())?
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }

    async fn grip(&self, command: &GripCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        let call = self.link.call("grip", timeout);
        let work = async {
            self.check(command)?;
            self.link.reach(&call, true).await?;
            let (state, theirs, command) = (self.state.clone(), call.clone(), command.clone());
            let answer = self.link.shared.request(move |stage, reply| {
                state.begin(stage, theirs, reply, Order::Grip(command));
            });
            let answer = answer.await.map_err(|_| self.link.ended())?;
            self.link.back(&call, answer).await
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }

    /// Its controller brings the fingers to contact together from step to step, as in trials of the simulation
    /// ([`graspd_sim::execute`]).
    async fn close(&self, command: &CloseCommand, timeout: Duration) -> Result<HandState, DeviceError> {
        let call = self.link.call("close", timeout);
        let work = async {
            command.check(&self.info)?;
            for (list, targets) in [
                ("contact", &command.contact),
                ("squeezed", &command.squeezed),
                ("farthest", &command.farthest),
            ] {
                self.check_range(list, targets)?;
            }
            self.link.reach(&call, true).await?;
            let (state, theirs, command) = (self.state.clone(), call.clone(), command.clone());
            let answer = self.link.shared.request(move |stage, reply| {
                state.begin(stage, theirs, reply, Order::Close(command));
            });
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
            let answer = self.link.shared.with(move |_| state.lock().clear());
            answer.await.map_err(|_| self.link.ended())
        };
        self.link.shared.bounded(&call.device, call.operation, timeout, work).await
    }
}
