//! What the motors move.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What a motor is told at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorCommand {
    /// Its address.
    pub id: u8,
    /// False: it gives no torque.
    pub torque: bool,
    /// Where to go, radians on its own scale (pi in the middle of a turn).
    pub goal_rad: f64,
    /// Current that it may use, milliamperes.
    pub current_limit_ma: f64,
    /// Speed that it may use, radians per second.
    pub speed_limit_rad_s: f64,
}

/// What a motor measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorState {
    /// Position, radians on its own scale.
    pub position_rad: f64,
    /// Speed, radians per second.
    pub velocity_rad_s: f64,
    /// Current, signed, milliamperes.
    pub current_ma: f64,
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    /// Supply, volts.
    pub voltage_v: f64,
    /// True when it has pressed too hard for too long.
    pub overloaded: bool,
}

impl Default for MotorState {
    fn default() -> Self {
        Self {
            position_rad: PI,
            velocity_rad_s: 0.0,
            current_ma: 0.0,
            temperature_c: 30.0,
            voltage_v: 5.0,
            overloaded: false,
        }
    }
}

/// What the motors of a bus move. A simulated world implements this to stand behind the bus; it must not keep its
/// caller waiting, who answers on the line.
pub trait Plant: Send + 'static {
    /// Lets `elapsed` pass under these commands; `states[i]` belongs to `commands[i]`. Called whenever the bus is asked
    /// something.
    fn advance(&mut self, elapsed: Duration, commands: &[MotorCommand], states: &mut [MotorState]);
}

impl<P: Plant + ?Sized> Plant for Box<P> {
    fn advance(&mut self, elapsed: Duration, commands: &[MotorCommand], states: &mut [MotorState]) {
        (**self).advance(elapsed, commands, states);
    }
}

/// Fastest speed of an X330 motor without load, radians per second (about 103 rpm).
const FASTEST_RAD_S: f64 = 10.8;
/// Current that a motor uses for each radian that it lacks, milliamperes; a proportional gain of some 450.
const STIFFNESS_MA_RAD: f64 = 3500.0;
/// Current above which pressing counts as hard, milliamperes.
const HARD_MA: f64 = 1000.0;
/// Kelvin per second and square ampere, and cooling per second: a stalled motor at 0.35 A stays cool.
const HEATING: f64 = 0.4;
const COOLING: f64 = 0.01;
const AMBIENT_C: f64 = 30.0;

#[derive(Debug, Default)]
struct Met {
    /// Positions that a motor does not pass, upwards.
    stops: BTreeMap<u8, f64>,
    temperatures: BTreeMap<u8, f64>,
    hard_s: Option<f64>,
}

/// What stands in the way of motors, and what befalls them; clones are handles to the same.
#[derive(Debug, Clone, Default)]
pub struct Obstacles(Arc<Mutex<Met>>);

impl Obstacles {
    fn lock(&self) -> MutexGuard<'_, Met> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A motor does not get above a position, radians on its own scale; `None`: its way is free.
    pub fn stop_above(&self, id: u8, position_rad: Option<f64>) {
        let mut met = self.lock();
        match position_rad {
            Some(position) => met.stops.insert(id, position),
            None => met.stops.remove(&id),
        };
    }

    /// Sets a motor's temperature, degrees Celsius.
    pub fn heat(&self, id: u8, temperature_c: f64) {
        self.lock().temperatures.insert(id, temperature_c);
    }

    /// Motors that press with more than 1 A for so long report overload; `None`: they never tire.
    pub fn tire_after(&self, seconds: Option<f64>) {
        self.lock().hard_s = seconds;
    }
}

/// Motors that go to their goals at their speed, and press on what is in their way.
#[derive(Debug, Default)]
pub struct KinematicPlant {
    obstacles: Obstacles,
    pressed_s: Vec<f64>,
}

impl KinematicPlant {
    /// With nothing in the way yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What stands in the way.
    pub fn obstacles(&self) -> Obstacles {
        self.obstacles.clone()
    }
}

impl Plant for KinematicPlant {
    fn advance(&mut self, elapsed: Duration, commands: &[MotorCommand], states: &mut [MotorState]) {
        let dt = elapsed.as_secs_f64();
        if dt <= 0.0 {
            return;
        }
        self.pressed_s.resize(commands.len(), 0.0);
        let mut met = self.obstacles.lock();
        for ((command, state), pressed_s) in commands.iter().zip(states).zip(&mut self.pressed_s) {
            let amperes = state.current_ma / 1000.0;
            state.temperature_c +=
                dt * (HEATING * amperes * amperes - COOLING * (state.temperature_c - AMBIENT_C));
            if let Some(temperature) = met.temperatures.remove(&command.id) {
                state.temperature_c = temperature;
            }
            if !command.torque {
                (state.velocity_rad_s, state.current_ma, *pressed_s, state.overloaded) =
                    (0.0, 0.0, 0.0, false);
                continue;
            }
            let most = FASTEST_RAD_S.min(command.speed_limit_rad_s) * dt;
            let from = state.position_rad;
            let mut to = from + (command.goal_rad - from).clamp(-most, most);
            if let Some(stop) = met.stops.get(&command.id) {
                // What already stands beyond is not thrown back.
                to = to.min(stop.max(from));
            }
            state.position_rad = to;
            state.velocity_rad_s = (to - from) / dt;
            let limit = command.current_limit_ma.abs();
            state.current_ma = (STIFFNESS_MA_RAD * (command.goal_rad - to)).clamp(-limit, limit);
            let hard = state.current_ma.abs() > HARD_MA && (to - from).abs() < 1e-4;
            *pressed_s = if hard { *pressed_s + dt } else { 0.0 };
            state.overloaded = met.hard_s.is_some_and(|most| *pressed_s > most);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(goal_rad: f64) -> MotorCommand {
        MotorCommand { id: 3, torque: true, goal_rad, current_limit_ma: 300.0, speed_limit_rad_s: 1.0 }
    }

    #[test]
    fn a_motor_goes_at_its_speed_and_presses_on_what_it_meets() {
        let mut plant = KinematicPlant::new();
        plant.obstacles().stop_above(3, Some(PI + 0.5));
        let mut states = [MotorState::default()];
        plant.advance(Duration::from_millis(250), &[command(PI + 1.0)], &mut states);
        assert!(
            (states[0].position_rad - PI - 0.25).abs() < 1e-12
                && (states[0].velocity_rad_s - 1.0).abs() < 1e-9
        );
        for _ in 0..4 {
            plant.advance(Duration::from_millis(250), &[command(PI + 1.0)], &mut states);
        }
        assert!((states[0].position_rad - PI - 0.5).abs() < 1e-12);
        assert_eq!(
            (states[0].velocity_rad_s, states[0].current_ma, states[0].overloaded),
            (0.0, 300.0, false)
        );
        plant.advance(Duration::from_secs(1), &[command(PI)], &mut states);
        assert!((states[0].position_rad - PI).abs() < 1e-12);
    }

    #[test]
    fn hard_pressing_tires_a_motor() {
        let mut plant = KinematicPlant::new();
        plant.obstacles().stop_above(3, Some(PI));
        plant.obstacles().tire_after(Some(1.0));
        let command = MotorCommand { current_limit_ma: 1500.0, ..command(PI + 1.0) };
        let mut states = [MotorState::default()];
        plant.advance(Duration::from_millis(900), &[command], &mut states);
        assert!(!states[0].overloaded);
        plant.advance(Duration::from_millis(900), &[command], &mut states);
        assert!(states[0].overloaded && states[0].temperature_c > AMBIENT_C);
    }
}
