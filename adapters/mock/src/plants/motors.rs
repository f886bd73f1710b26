//! The joints of a hand of the world behind an emulated bus of motors.

use std::f64::consts::PI;
use std::time::Duration;

use graspd_adapters_core::check::{SettingsError, require};
use graspd_adapters_emulators::dynamixel::{MotorCommand, MotorState, Plant};
use graspd_sim::world::HandId;

use super::fingers::{Fingers, Told};
use crate::shared::SharedWorld;

/// What healthy motors report.
const TEMPERATURE_C: f64 = 35.0;
const VOLTAGE_V: f64 = 5.0;
/// Fastest speed of an X330 motor without load, radians per second.
const FASTEST_RAD_S: f64 = 10.8;

/// A body for an emulated bus: joints of a hand of the world, one for each motor; straight joints stand in the middle
/// of a turn.
#[derive(Debug)]
pub struct MotorPlant {
    fingers: Fingers,
    /// Address of the motor of each actuator.
    ids: Vec<u8>,
    /// Current that makes the full effort of the hand's description.
    full_ma: f64,
}

impl MotorPlant {
    /// For a hand of the world. `ids`: the address of each actuator's motor, in the order of its actuators; `full_ma`: the
    /// current at which a motor gives the full effort of the hand's description.
    ///
    /// # Errors
    /// [`SettingsError`] for a world that runs on demand, a hand that is not there, lists of the wrong length.
    pub async fn new(
        shared: &SharedWorld,
        hand: HandId,
        ids: Vec<u8>,
        full_ma: f64,
    ) -> Result<Self, SettingsError> {
        let fingers = Fingers::new(shared, hand).await?;
        let count = fingers.actuators.len();
        require("ids", format!("{} addresses", ids.len()), ids.len() == count, count.to_string())?;
        require("full_ma", full_ma, full_ma.is_finite() && full_ma > 0.0, "a number above 0")?;
        Ok(Self { fingers, ids, full_ma })
    }
}

impl Plant for MotorPlant {
    fn advance(&mut self, _: Duration, commands: &[MotorCommand], states: &mut [MotorState]) {
        let of = |id: &u8| commands.iter().position(|c| c.id == *id);
        let places: Vec<Option<usize>> = self.ids.iter().map(of).collect();
        let count = self.ids.len();
        let speeds = vec![FASTEST_RAD_S; count];
        let mut told = Told { targets: vec![None; count], speeds, forces: vec![0.0; count] };
        for (i, command) in places.iter().enumerate().filter_map(|(i, at)| Some((i, &commands[(*at)?]))) {
            if command.torque {
                told.targets[i] = Some(command.goal_rad - PI);
                told.speeds[i] = command.speed_limit_rad_s.min(FASTEST_RAD_S);
                told.forces[i] = (command.current_limit_ma.abs() / self.full_ma).min(1.0);
            }
        }
        self.fingers.tell(told);
        let (seen, _) = self.fingers.seen();
        for (at, seen) in places.iter().zip(seen) {
            let Some(state) = at.and_then(|at| states.get_mut(at)) else { continue };
            let torque = at.is_some_and(|at| commands[at].torque);
            state.position_rad = PI + seen.position;
            state.velocity_rad_s = seen.velocity;
            state.current_ma = if torque { seen.load * self.full_ma } else { 0.0 };
            (state.temperature_c, state.voltage_v) = (TEMPERATURE_C, VOLTAGE_V);
        }
    }
}
